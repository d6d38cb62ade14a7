// What a program in TypeScript may rely on; `tsc` reads it against the types that are packed.
import { attachment, device, number, runs, sleep, verb, word, type Obeying } from "../dist/types/device/index.js";
import { Commander, Course, drive as driven, type Command, type CommandEnd } from "../dist/types/drive/index.js";
import { Key, MomError, Time, connect, isObeyed, type Event, type LinkState, type StopState } from "../dist/types/index.js";

export async function drive(pem: string): Promise<number> {
  await using client = await connect("mom://127.0.0.1", { user: "arm", key: await Key.fromPem(pem), onState: (state: LinkState) => console.log(state.state) });
  const arm = await client.channel("/robot/arm", { rate: "5/s", device: true });
  await using guard = await (await client.token("/robot/token")).grab({ wait: "unlimited" });
  const { delivered } = await arm.sendAcknowledged("command", { joints: [1, 2n, 0.5], at: new Date(), raw: Uint8Array.of(1), nothing: undefined }, { fence: guard.fence, to: ["arm"] });
  for await (const event of arm.events()) show(event);
  return delivered;
}

export async function commands(user: string, list: Command[]): Promise<CommandEnd | undefined> {
  const client = await connect("mom://127.0.0.1", { user });
  await using arm = await driven(client, "/robot/arm", { wait: 30_000, onPlace: (place) => console.log(place) });
  for (const command of list) {
    const end = await arm.carryOut(command, { told: (progress) => console.log(progress.kind === "again" ? progress.why : progress.statement) });
    if (end.how.kind === "lost") console.log(end.how.lost.by, end.how.ended);
    if (!end.finished) return end;
  }
  const guard = await (await client.token("/camera/pan-token")).accept();
  const pan = new Commander(client, await client.channel("/camera/pan"), guard.fence);
  const course = new Course(client.name, { place: "/camera/pan" }, guard.fence);
  course.begin({ text: "turn 5 0", basedOn: "newest" });
  for (let step = course.poll(); step; step = course.poll()) if (step.step === "send") course.refused(new Error() as MomError);
  course.refused({ code: "held", text: "alice drives" });
  await pan.end(() => guard.release());
  return pan.lost({ reason: "expired" });
}

export async function stop(user: string): Promise<Obeying> {
  const client = await connect("mom://127.0.0.1", { user });
  const { channels, others, denied } = await client.stop("/", { reason: "smoke", within: 500 });
  const state: StopState = await client.stops("/robot/arm");
  await client.unstop("/robot", Object.fromEntries(channels.filter(isObeyed).map(({ path, number }) => [path, number])), { within: 0 });
  await client.unstop("/robot/arm", state.number);
  console.log(others, denied.length, state.since?.toDate(), channels[0]?.devices[0]?.word === "lost");
  return runs(await client.obey("/robot/arm", cart(0)));
}

/** What a function gets follows from its declaration. */
function cart(x: number): ReturnType<typeof device> {
  return device("cart", {
    does: "A cart on a rail",
    stopsWithin: 500,
    verbs: {
      go: verb("Drives to a place", { x: number({ unit: "mm", min: -1000, max: 1000 }), ms: number({ default: 100 }) }, async (to, signal) => {
        await sleep(to.ms, signal);
        x = to.x;
      }),
      grip: verb.instant("Opens or closes", { how: word({ choices: ["open", "close"] }) }, ({ how }) => {
        const is: "open" | "close" = how;
        // @ts-expect-error it is one of its choices
        const wrong: "shut" = how;
        console.log(is, wrong);
      }),
      play: verb.instant("Plays a sound", { sound: attachment() }, ({ sound }) => console.log(sound.byteLength)),
      // @ts-expect-error it has no such argument
      turn: verb.relative("Turns", { way: number() }, ({ angle }) => console.log(angle)),
    },
    halt: () => console.log("halt"),
    position: () => ({ x }),
  });
}

function show(event: Event): void {
  if (event.type === "message") console.log(event.sender, event.content, event.parcel.received instanceof Time);
  else if (event.type === "grabbed") console.log(event.owner, event.fence + 1, event.lease ?? Infinity);
  else if (event.type === "stops") console.log(event.state.by, event.unstoppedBy);
  else if (event.type === "refused") console.log(event.error instanceof MomError && event.error.retryAfter);
}

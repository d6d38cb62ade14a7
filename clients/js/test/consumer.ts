// What a program in TypeScript may rely on; `tsc` reads it against the types that are packed.
import { Key, MomError, Time, connect, type Event, type LinkState } from "../dist/types/index.js";

export async function drive(pem: string): Promise<number> {
  await using client = await connect("mom://127.0.0.1", { user: "arm", key: await Key.fromPem(pem), onState: (state: LinkState) => console.log(state.state) });
  const arm = await client.channel("/robot/arm", { rate: "5/s", device: true });
  await using guard = await (await client.token("/robot/token")).grab({ wait: "unlimited" });
  const { delivered } = await arm.sendAcknowledged("command", { joints: [1, 2n, 0.5], at: new Date(), raw: Uint8Array.of(1), nothing: undefined }, { fence: guard.fence, to: ["arm"] });
  for await (const event of arm.events()) show(event);
  return delivered;
}

function show(event: Event): void {
  if (event.type === "message") console.log(event.sender, event.content, event.parcel.received instanceof Time);
  else if (event.type === "grabbed") console.log(event.owner, event.fence + 1, event.lease ?? Infinity);
  else if (event.type === "refused") console.log(event.error instanceof MomError && event.error.retryAfter);
}

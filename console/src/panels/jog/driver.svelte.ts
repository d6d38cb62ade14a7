// Live driving: what is held, looked at twenty times a second, and told to the worker, which tells it to the arm.
import { DeviceState } from "../../hub/device.svelte.js";
import { failureOf } from "../../hub/failure.js";
import { fields, list } from "../../hub/fields.js";
import type { Hub } from "../../hub/hub.svelte.js";
import { selectionOf } from "../../hub/selection.svelte.js";
import { pictures } from "../../hub/pictures.svelte.js";
import { texts } from "../../texts/index.js";
import type { Failure, Message } from "../../worker/protocol.js";
import { type Direction, type Drive, type Forward, NOTHING, REST, TABLE, type Vector, WAYS, directionOf, forwardOf, isNothing, step, sum, velocity } from "./machine.js";
import { NOT_PUSHED, type Pushed, readPad } from "./pad.js";
import { Settings } from "./settings.svelte.js";

/** ms between two looks; the worker rests by itself after 250. */
const EVERY = 50;
/** A camera that shows nothing new is asked for a picture, at most so often, in ms. */
const ASK = 250;

/** Where a letter is typed, or an arrow moves something else. */
function takesKeys(event: KeyboardEvent): boolean {
  const target = event.composedPath()[0];
  if (!(target instanceof HTMLElement)) return false;
  return target.isContentEditable || target.matches("input:not([type=checkbox], [type=button]), textarea, select, [role=slider], [role=listbox], [role=tab]");
}

export class Driver {
  drive = $state.raw<Drive>(REST);
  /** What is told to the arm. */
  velocity = $state.raw<Vector>(NOTHING);
  /** Directions that are held, for showing. */
  shown = $state.raw<ReadonlySet<Direction>>(new Set());
  pads = $state.raw<readonly { index: number; id: string }[]>([]);
  pushed = $state.raw<Pushed>(NOT_PUSHED);
  /** Forward as the selected camera sees it. */
  seen = $state.raw<Forward | undefined>(undefined);
  camera = $state<string | undefined>(undefined);
  /** Whether a person has said that it sees the device, and not the page that it may. */
  isChosen = $state(false);
  readonly settings = new Settings();
  readonly device: DeviceState;
  readonly #keys = new Map<string, Direction>();
  readonly #buttons = new Map<string, Direction>();
  readonly #sticks = new Map<string, Vector>();
  #refused: { at: number; text: string } | undefined;
  #padGone = false;
  #asked = 0;
  #focused = true;

  constructor(
    readonly hub: Hub,
    readonly path: string,
  ) {
    this.device = new DeviceState(hub, path);
  }

  get owned(): { fence: number } | undefined {
    return this.device.token === undefined ? undefined : this.hub.owned.get(this.device.token);
  }

  /** Whether pictures of a camera show the device. */
  sees(camera: string): boolean {
    const shown = pictures.newest(this.hub, camera);
    return (this.isChosen && camera === this.camera) || selectionOf(this.hub).sees(camera, this.path, shown?.posed ?? false);
  }

  /** The picture by which is driven: that of the selected camera, or else the newest of those that see the device. */
  get picture(): { camera: string; born: number; error: number | undefined } | undefined {
    const shown = pictures.cameras(this.hub).filter((camera) => this.sees(camera));
    const camera = this.camera !== undefined && shown.includes(this.camera) ? this.camera : shown[0];
    const picture = camera === undefined ? undefined : pictures.newest(this.hub, camera);
    return picture && { camera: camera!, born: picture.born ?? picture.arrived, error: picture.error };
  }

  /** A camera that names a state of this device as what it shows sees it. */
  #prove(): void {
    for (const camera of pictures.cameras(this.hub)) {
      const time = pictures.newest(this.hub, camera)?.poseTime;
      if (time !== undefined && this.device.hasTold(time)) selectionOf(this.hub).proves(camera, this.path);
    }
  }

  get forward(): Forward {
    return this.settings.frame === "camera" ? (this.seen ?? TABLE) : TABLE;
  }

  /** Looks and drives until the function that it gives is called. */
  start(): () => void {
    const ends = [this.device.start(), this.hub.onJogEnd((path, failure) => path === this.path && this.#refuse(failure)), this.hub.onStop(() => this.look())];
    const timer = setInterval(() => this.look(), EVERY);
    const listen = <Name extends keyof WindowEventMap>(name: Name, hears: (event: WindowEventMap[Name]) => void, capture = false): void => {
      window.addEventListener(name, hears, capture);
      ends.push(() => window.removeEventListener(name, hears, capture));
    };
    const hidden = (): void => {
      if (document.visibilityState !== "visible") this.#letGo();
    };
    document.addEventListener("visibilitychange", hidden);
    listen("keydown", (event) => this.#down(event));
    listen("keyup", (event) => this.#up(event), true);
    listen("blur", () => {
      this.#focused = false;
      this.#letGo();
    });
    listen("focus", () => (this.#focused = true));
    listen("pagehide", () => this.#letGo());
    // A user who begins to type does not drive.
    listen("focusin", () => this.#keys.size && this.#typing() && this.#freeKeys());
    listen("gamepadconnected", () => this.#findPads());
    listen("gamepaddisconnected", () => this.#findPads());
    this.#focused = document.hasFocus();
    this.#findPads();
    return () => {
      clearInterval(timer);
      document.removeEventListener("visibilitychange", hidden);
      this.#letGo();
      for (const end of ends) end();
    };
  }

  /** Follows a camera's matrix until the function that it gives is called. */
  follow(camera: string): () => void {
    this.seen = undefined;
    return this.hub.watch(
      { path: camera, kind: "channel", names: ["image"], rate: "2/s" },
      {
        events: (events) => {
          const message = events.filter((event): event is Message => event.type === "message").at(-1);
          if (message) this.seen = forwardOf(list(fields(message.content), "matrix").map(Number)) ?? this.seen;
        },
      },
    );
  }

  #typing(): boolean {
    let at = document.activeElement;
    while (at?.shadowRoot?.activeElement) at = at.shadowRoot.activeElement;
    return at?.matches("input:not([type=checkbox], [type=button]), textarea, select") ?? false;
  }

  #down(event: KeyboardEvent): void {
    if (event.key === "Meta" || event.key === "Control" || event.key === "Alt") return this.#freeKeys();
    if (!this.settings.armed || event.ctrlKey || event.metaKey || event.altKey || event.isComposing || takesKeys(event)) return;
    const direction = directionOf(event.key, event.code);
    if (!direction) return;
    event.preventDefault();
    if (event.repeat) return;
    this.#keys.set(event.code, direction);
    this.look();
  }

  #up(event: KeyboardEvent): void {
    if (this.#keys.delete(event.code)) this.look();
  }

  #freeKeys(): void {
    this.#keys.clear();
    this.look();
  }

  /** Nothing is held any more; first it is said why. */
  #letGo(): void {
    this.look();
    this.#keys.clear();
    this.#buttons.clear();
    this.#sticks.clear();
    this.look();
  }

  arm(armed: boolean): void {
    this.settings.armed = armed;
    this.#freeKeys();
  }

  /** A button is held, or let go. */
  hold(button: string, direction: Direction | null): void {
    if (direction) this.#buttons.set(button, direction);
    else this.#buttons.delete(button);
    this.look();
  }

  /** A stick is pushed, or let go. */
  push(stick: string, wish: Vector | null): void {
    if (wish) this.#sticks.set(stick, wish);
    else this.#sticks.delete(stick);
    if (!wish || this.drive.phase !== "drive") this.look();
  }

  #refuse(failure: Failure): void {
    this.#note(failure);
    this.look();
  }

  #note(failure: Failure): void {
    this.#refused = { at: Date.now(), text: failure.text };
    this.hub.noteOnce("error", texts.notices.trouble(this.path, undefined, failure.text), failure);
  }

  #findPads(): void {
    const found = [...(navigator.getGamepads?.() ?? [])].filter((pad) => pad?.connected === true);
    this.pads = found.map((pad) => ({ index: pad!.index, id: pad!.id }));
  }

  #readPad(): boolean {
    const { settings } = this;
    const before = this.pushed;
    const first = this.pads[0];
    const pad = first === undefined ? undefined : navigator.getGamepads()[first.index];
    const gone = first === undefined || !pad?.connected;
    if (first !== undefined && gone) this.#findPads();
    this.pushed = pad?.connected ? readPad(pad, settings.mapping, settings.zone, settings.scale) : NOT_PUSHED;
    return gone && !isNothing(before.wish);
  }

  /** Looks at everything, and says what follows. */
  look(): void {
    const { hub, device, settings } = this;
    const now = Date.now();
    this.#padGone = this.#readPad();
    const { wish, deadMan } = this.pushed;
    const pushed = !isNothing(wish);
    this.#prove();
    const picture = this.picture;
    const age = picture && now - picture.born;
    this.#hear();
    const before = this.drive;
    this.drive = step(before, {
      now,
      held: this.#keys.size + this.#buttons.size + this.#sticks.size > 0 || pushed,
      owns: this.owned !== undefined,
      stopAt: hub.stopOrderedAt(this.path),
      stopped: device.stopped,
      unknownSince: device.unknownSince,
      linked: hub.link.state === "connected",
      visible: document.visibilityState === "visible",
      focused: this.#focused,
      age,
      limit: Math.max(1, settings.limit),
      unseen: settings.unseen,
      pad: { pushed, deadMan, gone: this.#padGone },
      refused: this.#refused,
    });
    const directions = new Set([...this.#keys.values(), ...this.#buttons.values()]);
    if (directions.size !== this.shown.size || [...directions].some((direction) => !this.shown.has(direction))) this.shown = directions;
    this.#tell(before, now);
    this.#freshen(picture?.camera, age, now);
  }

  /** The arm's word to what is told to it: while it is driven, nothing else is. */
  #hear(): void {
    const { drive, device } = this;
    if (drive.phase !== "drive") return;
    const refusal = device.refused;
    if (refusal && refusal.arrived >= drive.since) this.#note(refusal.error ?? { kind: "refused", code: "error", text: "", content: {} });
  }

  #said = 0;

  #tell(before: Drive, now: number): void {
    const { hub, owned, settings } = this;
    if (this.drive.phase !== "drive" || !owned) {
      if (before.phase === "drive") void hub.call("jog", null).catch(() => undefined);
      if (!isNothing(this.velocity)) this.velocity = NOTHING;
      return;
    }
    if (before.phase === "drive" && now - this.#said < EVERY - 10) return;
    this.#said = now;
    const wish = sum(...[...this.#keys.values(), ...this.#buttons.values()].map((direction) => WAYS[direction]), ...this.#sticks.values(), this.pushed.wish);
    this.velocity = velocity(wish, settings.speed, settings.turn, this.forward);
    hub.call("jog", { path: this.path, velocity: [...this.velocity], fence: owned.fence }).catch((error: unknown) => this.#refuse(failureOf(error)));
  }

  /** Cameras show what changes: one that has nothing to show is asked, so that the picture is of now. */
  #freshen(camera: string | undefined, age: number | undefined, now: number): void {
    const { hub, settings } = this;
    if (camera === undefined || !this.owned || hub.link.state !== "connected" || document.visibilityState !== "visible" || settings.unseen) return;
    if (age === undefined || !pictures.newest(hub, camera) || age < settings.limit / 2 || now - this.#asked < Math.max(ASK, settings.limit / 3)) return;
    this.#asked = now;
    void hub.call("send", camera, "request", {}, { echo: false }).catch(() => undefined);
  }
}

// A camera as one picture shows it: its newest image, how old that was when it was shown, and what it says of itself.
import { cursorOf } from "../../hub/cursor.svelte.js";
import { failureOf } from "../../hub/failure.js";
import { refusalOf } from "../../hub/device.svelte.js";
import { fields, list, number, text } from "../../hub/fields.js";
import type { Hub } from "../../hub/hub.svelte.js";
import { pictures } from "../../hub/pictures.svelte.js";
import type { Failure, HubEvent, Message, Picture, PlainFields } from "../../worker/protocol.js";
import { type Beside, besideOf, blockOf } from "./overlay.js";

/** A picture that is shown. */
export interface Frame {
  beside: Beside;
  /** Bytes of the file. */
  size: number;
  /** Pixels that were decoded. */
  width: number;
  height: number;
  /** When it was taken, ms since 1970 by this machine's clock, and the error of that. */
  born: number | undefined;
  error: number | undefined;
  arrived: number;
  /** The watch whose worker has its file. */
  watch: number;
}

export interface Settings {
  width: number | undefined;
  height: number | undefined;
  quality: number | undefined;
  format: string | undefined;
  overlay: boolean | undefined;
}

const NAMES = ["image", "camera-error", "camera-recovered", "request-refused", "settings-in-use", "settings-changed", "settings-refused", "calibration-changed"];
/** Good news is told for so long, ms. */
const NEWS = 6000;
/** The rate of pictures is that of the last so many ms. */
const SPAN = 3000;

/** Calls back once what was drawn is on its way to the glass; not at all as long as nobody sees the page. */
function painted(then: () => void): void {
  requestAnimationFrame(() => {
    const channel = new MessageChannel();
    channel.port1.onmessage = () => {
      channel.port1.close();
      then();
    };
    channel.port2.postMessage(null);
  });
}

export class CameraView {
  frame = $state.raw<Frame | null>(null);
  /** How old the picture was when it was shown, ms, and the error of that. */
  glass = $state.raw<{ ms: number; error: number | undefined } | null>(null);
  /** Images since the beginning that were not shown because newer ones came. */
  skipped = $state(0);
  unshown = $state.raw<{ size: number; why: "too-large" | "not-readable" } | null>(null);
  /** What the camera says is wrong with it. */
  fault = $state<string | null>(null);
  recovered = $state<string | null>(null);
  failure = $state.raw<Failure | null>(null);
  refusal = $state.raw<{ what: string; failure: Failure } | null>(null);
  settings = $state.raw<Settings | null>(null);
  changedBy = $state<string | undefined>(undefined);
  /** The token that guards its commands, if it turns. */
  turns = $state<string | undefined>(undefined);
  joined = $state(false);
  readonly #times: number[] = [];
  #hidden = false;

  constructor(
    readonly hub: Hub,
    readonly path: string,
    readonly show: (bitmap: ImageBitmap) => void,
  ) {}

  /** Watches it until the function that it gives is called; pictures come at most so many pixels wide, and so often if that is said (`1/s`). */
  start(pixels: number, rate?: string): () => void {
    const { hub, path } = this;
    return hub.watch(
      { path, kind: "channel", newest: true, rate, names: NAMES, pictures: pixels },
      {
        joined: (info) => {
          const guard = fields(info["guard"]);
          this.turns = list(guard, "names").includes("command") ? text(guard, "token") : undefined;
          [this.failure, this.joined] = [null, true];
          // A camera shows what has moved; nothing may move for long.
          void this.request(true);
        },
        events: (events) => events.forEach((event) => this.#heard(event)),
        picture: (picture) => this.#picture(picture),
        unshown: (size, why) => (this.unshown = { size, why }),
        failed: (failure) => (this.failure = failure),
      },
    );
  }

  /** It is not shown any more, nor is a picture that is still on its way. */
  hide(): void {
    this.#hidden = true;
    pictures.hides(this.hub, this.path);
  }

  /** Pictures each second. */
  rate(now: number): number {
    const recent = this.#times.filter((time) => time > now - SPAN);
    if (recent.length < 2) return recent.length ? 1000 / SPAN : 0;
    return recent.length / (SPAN / 1000);
  }

  #picture(picture: Picture): void {
    const { bitmap, content, size, arrived, skipped, watch } = picture;
    const { width, height } = bitmap;
    const beside = besideOf(content, width, height);
    const frame: Frame = { beside, size, width, height, ...this.#birth(picture, beside), arrived, watch };
    this.show(bitmap);
    this.frame = frame;
    [this.unshown, this.fault, this.failure] = [null, null, null];
    if (skipped) this.skipped += skipped;
    this.#times.push(Date.now());
    if (this.#times.length > 200) this.#times.shift();
    if (beside.blocks.length) cursorOf(this.hub).sees(beside.blocks.map(blockOf).filter((block) => block !== undefined));
    painted(() => {
      if (this.frame !== frame || this.#hidden) return;
      const { born, error } = frame;
      pictures.shows(this.hub, this.path, { born, error, arrived, posed: beside.pose !== undefined, poseTime: beside.poseTime });
      this.glass = born === undefined ? null : { ms: Math.max(0, Date.now() - born), error };
    });
  }

  /** When it was taken as its camera says by the hub's clock, or else when its message was made. */
  #birth(picture: Picture, { taken }: Beside): { born: number | undefined; error: number | undefined } {
    const { offset, offsetError } = this.hub.link;
    const { born, error } = picture;
    if (taken === undefined || offset === undefined) return { born, error };
    const here = taken - offset;
    const slack = (offsetError ?? 0) + (error ?? 0) + 1;
    // A camera whose clock is wrong would show pictures of the future.
    if (here > (born ?? picture.arrived) + slack) return { born, error };
    // The error is that of the offset used: the message's own may be by a better exchange, of which the page has not heard yet. The time is told to the ms.
    return { born: here, error: (offsetError ?? 0) + 1 };
  }

  #heard(event: HubEvent): void {
    if (event.type === "refused") {
      const failure = (event as { failure?: Failure }).failure;
      if (failure) this.refusal = { what: "", failure };
    }
    if (event.type !== "message") return;
    const { name, content, history } = event as Message;
    const said = fields(content);
    switch (name) {
      case "camera-error":
        this.recovered = null;
        this.fault = text(said, "text") ?? "";
        break;
      case "camera-recovered":
        this.fault = null;
        if (!history) this.#recover(text(said, "text") ?? "");
        break;
      case "settings-in-use":
      case "settings-changed":
        // A repeated state must not replace what the user types.
        if (JSON.stringify(settingsOf(said)) !== JSON.stringify(this.settings)) this.settings = settingsOf(said);
        if (name === "settings-changed") this.changedBy = text(said, "by");
        break;
      case "settings-refused":
      case "request-refused":
        if (history) break;
        this.refusal = { what: name === "request-refused" ? "request" : "settings", failure: refusalOf(said) ?? { kind: "refused", code: name, text: text(said, "text") ?? name, content: said } };
        break;
    }
  }

  #recover(text: string): void {
    this.recovered = text;
    setTimeout(() => (this.recovered = null), NEWS);
  }

  /** Asks for a new picture whenever the newest is older than this, ms, until the function that it gives is called. */
  keepFresh(ms: number): () => void {
    const timer = setInterval(() => {
      const { frame, hub } = this;
      if (!hub.isUp || !this.joined || document.hidden) return;
      if (Date.now() - (frame?.born ?? frame?.arrived ?? 0) > ms) void this.request(true);
    }, ms);
    return () => clearInterval(timer);
  }

  /** Asks for a picture. */
  async request(quietly = false): Promise<void> {
    try {
      await this.hub.call("send", this.path, "request", {}, { echo: false });
    } catch (error) {
      if (!quietly) this.refusal = { what: "request", failure: failureOf(error) };
    }
  }

  /** Asks for the settings, or changes some. */
  async set(change: PlainFields = {}): Promise<void> {
    this.refusal = null;
    try {
      await this.hub.call("send", this.path, "settings", change, { echo: false });
    } catch (error) {
      this.refusal = { what: "settings", failure: failureOf(error) };
    }
  }

  /** The file of the picture that is shown. */
  async file(): Promise<{ bytes: Uint8Array; type: string } | null> {
    return this.frame ? await this.hub.call("pictureFile", this.frame.watch) : null;
  }
}

function settingsOf(said: PlainFields): Settings {
  return { width: number(said, "width"), height: number(said, "height"), quality: number(said, "quality"), format: text(said, "format"), overlay: typeof said["overlay"] === "boolean" ? said["overlay"] : undefined };
}

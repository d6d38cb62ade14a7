// A channel that the user looks at: what is said there, thinned out where nobody could read it.
import { fields, number, text } from "../../hub/fields.js";
import type { Hub } from "../../hub/hub.svelte.js";
import { Bounded, Meter, type Said, lineOf, sizeOf } from "../../hub/said.js";
import { texts } from "../../texts/index.js";
import type { Failure, Happening, HubEvent, Message, Picture, PlainFields } from "../../worker/protocol.js";

/** Messages that are kept. */
export const MOST = 500;
/** Of each sender and name. */
const RATE = "20/s";
/** Messages a second of all senders and names, where the hub may not thin them out. */
const MOST_A_SECOND = 100;
/** Pictures that are kept, each so many pixels wide at most. */
const PICTURES = 12;
const WIDTH = 320;
/** ms between two changes of what is seen. */
const SHOW = 100;

/** To two digits: nobody counts what is left out. */
function about(rate: number): number {
  const unit = 10 ** Math.max(0, Math.floor(Math.log10(Math.max(rate, 1))) - 1);
  return Math.round(rate / unit) * unit;
}

export class Watched {
  /** What is seen. */
  shown = $state.raw<readonly Said[]>([]);
  /** What came while it is paused. */
  waiting = $state(0);
  paused = $state(false);
  /** Per second: what is shown, and what is said. */
  shownRate = $state(0);
  saidRate = $state(0);
  info = $state.raw<PlainFields>({});
  failure = $state.raw<Failure | null>(null);
  joined = $state(false);
  readonly bitmaps = new Map<number, ImageBitmap>();
  readonly #all = new Bounded<Said>(MOST);
  readonly #shown = new Meter();
  readonly #left = new Meter();
  #new: Said[] = [];
  #key = 0;
  #timer: ReturnType<typeof setTimeout> | undefined;

  constructor(
    readonly hub: Hub,
    readonly path: string,
  ) {}

  /** Watches it until the function that it gives is called. */
  start(): () => void {
    const end = this.hub.watch(
      { path: this.path, kind: "channel", rate: RATE, pictures: WIDTH, most: MOST_A_SECOND },
      {
        joined: (info) => [this.info, this.failure, this.joined] = [info, null, true],
        failed: (failure) => (this.failure = failure),
        events: (events, skipped) => this.#heard(events, skipped),
        picture: (picture) => this.#pictured(picture),
        unshown: (size, why, sender) => this.#add({ ...this.#blank("unshown", "image", sender), line: texts.watch.unshown(why, size), size }),
      },
    );
    const rates = setInterval(() => this.#measure(), 1000);
    return () => {
      end();
      clearInterval(rates);
      clearTimeout(this.#timer);
      for (const bitmap of this.bitmaps.values()) bitmap.close();
      this.bitmaps.clear();
    };
  }

  clear(): void {
    this.#all.items = [];
    [this.#new, this.shown, this.waiting] = [[], [], 0];
  }

  pause(): void {
    this.paused = true;
  }

  follow(): void {
    this.paused = false;
    this.#show();
  }

  #measure(): void {
    const now = Date.now();
    const shown = this.#shown.rate(now);
    [this.shownRate, this.saidRate] = [Math.round(shown), about(shown + this.#left.rate(now))];
  }

  #blank(sort: Said["sort"], name: string, sender: string): Said {
    return { key: ++this.#key, sort, name, sender, line: "", content: undefined, cut: false, size: 0, history: false, born: undefined, error: undefined, arrived: Date.now() };
  }

  #heard(events: readonly HubEvent[], skipped: number): void {
    if (skipped) this.#left.add(Date.now(), skipped);
    for (const event of events) {
      if (event.type === "message") this.#said(event as Message);
      else this.#happened(event as Happening);
    }
  }

  #said(message: Message): void {
    const { name, sender, content, cut, size, history, born, error, arrived, id, reference, fence } = message;
    const line = content === undefined && !size ? texts.watch.noContent : lineOf(content);
    this.#add({ ...this.#blank("message", name, sender), line, content, cut, size: size + sizeOf(content), history, born, error, arrived, id, reference, fence });
  }

  #pictured(picture: Picture): void {
    const { bitmap, content, sender, size, born, error, arrived, skipped } = picture;
    const line = texts.watch.picture(number(content, "width"), number(content, "height"), size);
    const said = { ...this.#blank("picture", "image", sender), line, content, size, born, error, arrived };
    this.bitmaps.set(said.key, bitmap);
    const oldest = this.bitmaps.keys().next().value!;
    if (this.bitmaps.size > PICTURES) {
      this.bitmaps.get(oldest)?.close();
      this.bitmaps.delete(oldest);
    }
    if (skipped) this.#left.add(Date.now(), skipped);
    this.#add(said);
  }

  #happened(happening: Happening): void {
    const { type, what, arrived } = happening;
    if (type === "dropped") {
      const reason = text(what, "reason") ?? "";
      const count = number(what, "count") ?? 1;
      const receiver = text(what, "receiver");
      // Of what this page did not get.
      if ((reason === "rate" || reason === "replaced") && (receiver === undefined || receiver === this.hub.me?.peer) && number(what, "receivers") === undefined) return this.#left.add(arrived, count);
      return this.#add({ ...this.#blank("event", type, ""), line: texts.watch.dropped(count, reason), arrived });
    }
    if (type === "lagged") {
      this.#left.add(arrived, number(what, "count") ?? 0);
      return;
    }
    const say = Object.hasOwn(texts.watch.event, type) ? texts.watch.event[type] : undefined;
    if (!say) return;
    const who = text(fields(what["member"]), "peer") ?? text(what, "owner") ?? "";
    this.#add({ ...this.#blank("event", type, ""), line: say(who), arrived });
  }

  #add(said: Said): void {
    if (said.sort !== "event" && !said.history) this.#shown.add(Date.now(), 1);
    this.#new.push(said);
    if (this.#new.length > MOST) this.#new.shift();
    this.#timer ??= setTimeout(() => {
      this.#timer = undefined;
      this.#show();
    }, SHOW);
  }

  #show(): void {
    this.#all.add(this.#new);
    if (this.paused) this.waiting += this.#new.length;
    else [this.shown, this.waiting] = [this.#all.items, 0];
    this.#new = [];
  }
}

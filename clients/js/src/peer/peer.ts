// One peer: what it wants and knows, over one connection after another.
import { shown } from "../address.js";
import { HubClock } from "../clock.js";
import { type Connected, Connector } from "../connector.js";
import { MomError, disconnected } from "../error.js";
import { type Event, type Events, type MessageEvent, Subscribers, eventOf } from "../events.js";
import { Guards, type Hold } from "../guards.js";
import { installed } from "../installation.js";
import { Ledger, saidOf } from "../ledger.js";
import { type Link, type Resumed, type Welcome, check } from "../login.js";
import type { ConnectOptions, LinkState } from "../options.js";
import { type Entry, Outbox } from "../outbox.js";
import { type Parcel, dropped, errorOf } from "../parcel.js";
import { Pending } from "../pending.js";
import { type Place, Places, guardOf, wayTo } from "../places.js";
import { Mover } from "./move.js";
import { MOST_PRIORITY, STOP } from "../precedence.js";
import { Queue } from "../queue.js";
import { stopStateOf } from "../stops.js";
import { type Fields, Time, fieldsOf, int, wallMicros } from "../value.js";
import type { Wire } from "../wire.js";

/** Sent messages whose refusal is still told by the channel that they were sent to. */
const REMEMBERED = 1024;
const LAST_WORDS = 1000;

/** A question of the hub to a peer that manages a context. */
export type ConsultListener = (parcel: Parcel) => void;

export class Peer {
  state: LinkState = { state: "trying", attempt: 0 };
  me: Welcome | null = null;
  readonly clock = new HubClock();
  readonly places = new Places();
  readonly guards = new Guards((hold) => this.#renew(hold));
  readonly pending = new Pending();
  readonly subscribers: Subscribers;
  readonly consults = new Set<ConsultListener>();
  /** Hear of each state of the link: nothing must move without one. */
  readonly devices = new Set<{ link(state: LinkState): void }>();
  readonly onQueued = new Map<string, (place: number, expected: number | undefined) => void>();
  readonly outbox = new Outbox((entry, reason) => this.#dropped(entry, reason));
  readonly connector: Connector;
  readonly #mover = new Mover(this);
  readonly #states = new Set<Queue<LinkState>>();
  /** What resumes the link. */
  link: Link | null = null;
  ledger = new Ledger();
  wire: Wire | null = null;
  /** The hub's reason for closing. */
  #closing: MomError | null = null;
  isEnding = false;
  #lastId = 0;
  /** Of messages that a receiver answers: begun anywhere, so that no status of another connection of this name, and none that a channel has kept, is the answer to one. */
  #lastAnswered = 2 ** 52 + Math.floor(Math.random() * 2 ** 51);
  #heard = 0;
  #pinged = 0;
  /** When the hub was last told that this peer is there. */
  #spoke = 0;
  #asked = -1; // How much was sent when the hub was asked what it has read.
  #sentTo = new Map<number, string>();
  #graceOver: ReturnType<typeof setTimeout> | undefined;
  /** When the hub gives this peer up. */
  #graceEnd = 0;
  /** Serves the connection to which the link has moved. */
  #moved: (() => Promise<string>) | null = null;
  endServing: (why: string) => void = () => undefined;
  #noteClosed: () => void = () => undefined;
  /** Fulfilled when it is closed for good. */
  readonly closed = new Promise<void>((resolve) => (this.#noteClosed = resolve));

  constructor(address: string, readonly options: ConnectOptions) {
    check(options);
    this.places.installation = installed(options.installation);
    this.subscribers = new Subscribers(options.eventBuffer ?? 4096, (event) => this.#isOver(event));
    this.connector = new Connector(address, options, () => ++this.#lastId);
    this.outbox.wrote = (entry) => this.link && this.ledger.wrote(entry);
    this.outbox.permits = (entry) => entry.lane === STOP || (!this.#mover.holding && this.#permits(entry));
  }

  // The life of the link.

  /** Connects for the first time; then goes on until it is closed. */
  async start(): Promise<void> {
    this.#state({ state: "trying", attempt: 0 });
    this.options.signal?.addEventListener("abort", () => void this.end(), { once: true });
    const first = await this.#connect(this.options.connectWithin ?? 60_000).catch((error: unknown) => {
      this.#close(error as MomError);
      throw error;
    });
    void this.#live(first);
  }

  async #live(first: () => Promise<string>): Promise<void> {
    for (let serve = first; ; ) {
      const why = await serve();
      if (this.#moved) {
        [serve, this.#moved] = [this.#moved, null];
        continue;
      }
      const closing = this.#closing;
      this.wire = null;
      this.outbox.lose();
      if (this.isEnding || (closing && !closing.mayReconnect)) return this.#close(this.isEnding ? null : closing);
      const lost = closing ?? disconnected(why);
      if (closing || !this.link) this.#lose(lost);
      else this.#waitForGrace(this.link.grace, lost);
      if (this.options.reconnect === false) return this.#close(lost);
      try {
        serve = await this.#connect(this.options.giveUpAfter ?? Infinity, lost);
      } catch (error) {
        return this.#close(this.isEnding ? null : (error as MomError));
      }
    }
  }

  /** After that time the hub has given this peer up. */
  #waitForGrace(grace: number, lost: MomError): void {
    clearTimeout(this.#graceOver);
    this.#graceEnd = performance.now() + grace;
    this.#graceOver = setTimeout(() => this.#lose(lost), Math.min(grace, 2 ** 31 - 1));
  }

  /** Tries until there is a connection; gives what serves it to its end. */
  async #connect(within: number, lost?: MomError): Promise<() => Promise<string>> {
    const attempts = this.connector.attempts(within);
    let error = lost;
    for (let attempt = 0; ; attempt++) {
      if (attempt > 0 || lost) {
        const state = this.link ? "resuming" : "trying";
        this.#state(error ? { state, attempt, error } : { state, attempt });
        await attempts.wait(error, this.link?.grace, this.link ? this.#graceEnd - performance.now() : 0);
      }
      try {
        const link = this.link;
        const { wire, resumed, welcome } = await this.connector.connect(link, this.ledger.said, () => this.#lose(lost ?? disconnected("the link was not resumed")));
        // Its time may be over meanwhile.
        if (resumed && link !== this.link) wire.drop();
        else if (resumed) return this.#resumed(wire, resumed);
        else if (welcome) return this.#welcomed(wire, welcome, lost !== undefined);
      } catch (thrown) {
        // What gives tokens has failed. Where it has worked before it may do so again.
        if (!(thrown instanceof MomError) && !lost) throw thrown;
        const failed = thrown instanceof MomError ? thrown : disconnected(String(thrown));
        error = failed;
        const badCount = failed.code === "bad-count" && this.link !== null;
        if (failed.kind === "refused" && failed.number >= 300 && this.link) this.#lose(failed);
        // A new login counts anew.
        if (!badCount) attempts.failed(failed);
      }
    }
  }

  /** The link goes on where it was. */
  #resumed(wire: Wire, { said, content }: Resumed): () => Promise<string> {
    clearTimeout(this.#graceOver);
    const unread = this.ledger.resumed(said);
    if (!unread) {
      wire.drop();
      throw new MomError("refused", "bad-count", `the hub has read ${said.read} parcels, which are not the first ones sent`, 408);
    }
    this.outbox.back(unread, { family: "time", name: "resent" });
    const count = int(content, "dropped") ?? 0;
    if (count) this.subscribers.deliver([], { type: "dropped", path: "/", reason: "disconnected", count });
    return this.#up(wire, true);
  }

  /** A new login: all that is wanted is joined again before anything else is sent. */
  #welcomed(wire: Wire, welcome: Welcome, again: boolean): () => Promise<string> {
    [this.me, this.link, this.ledger] = [welcome, welcome.link, new Ledger()];
    [this.outbox.most, this.outbox.parcelLimit, this.places.takesCards] = [welcome.limits.outbox, welcome.limits.parcel, welcome.takesCards];
    this.outbox.back([]);
    const places = this.places.all();
    if (again && !places.length) this.subscribers.deliver([], { type: "rejoined" });
    const serve = this.#up(wire, false);
    for (const place of again ? places : []) {
      place.joined = this.#join(place);
      place.joined.then(
        () => this.subscribers.deliver([place.path], { type: "rejoined" }),
        (error: MomError) => {
          if (error.kind !== "refused") return;
          this.subscribers.deliver([place.path], { type: "refused", path: place.path, error, id: undefined });
          this.#forget(place.path);
        },
      );
    }
    return serve;
  }

  /** The link goes on over another connection than the one that is served. */
  moveTo({ wire, resumed }: Connected): void {
    this.outbox.lose(true);
    this.#moved = this.#resumed(wire, resumed!);
    this.endServing("moved");
  }

  #up(wire: Wire, resumed: boolean): () => Promise<string> {
    this.wire = wire;
    this.#closing = null;
    this.#heard = performance.now();
    this.#asked = -1;
    wire.frames.most = this.me!.limits.parcel;
    wire.beforePong = () => {
      this.#spoke = performance.now();
      this.#tell();
    };
    if (!resumed) this.clock.forget();
    this.#state({ state: "connected", door: shown(wire.pipe.door), resumed });
    return () => this.#serve(wire);
  }

  /** Serves a connection to its end; gives why it ended. */
  #serve(wire: Wire): Promise<string> {
    const { heartbeat, gone } = this.me!.limits;
    return new Promise((resolve) => {
      const keeper = setInterval(() => this.#keep(heartbeat, gone), heartbeat / 4);
      const stopSeeking = this.connector.isSecondBest(wire.pipe.door) ? this.#mover.seek(wire, this.options.seekWebSocket) : () => undefined;
      this.endServing = (why) => {
        clearInterval(keeper);
        stopSeeking();
        wire.drop();
        resolve(why);
      };
      this.ping();
      this.take(wire);
      this.pump();
    });
  }

  take(wire: Wire): void {
    wire.take({
      parcel: (parcel, size) => this.#receive(parcel, size),
      drained: () => this.pump(),
      ended: (why) => this.endServing(why),
    });
  }

  #keep(heartbeat: number, gone: number): void {
    const now = performance.now();
    const silent = now - this.#heard;
    // The hub has given the link up, too, where it has not heard of this side for so long.
    if (silent > gone || now - this.#spoke > gone) return this.endServing("the hub has been silent for too long");
    if (silent > 1.5 * heartbeat && this.state.state === "connected") this.#state({ state: "stale" });
    if (now - this.#pinged >= heartbeat) this.ping();
  }

  ping(): number {
    this.#pinged = this.#spoke = performance.now();
    this.#tell();
    const id = ++this.#lastId;
    const sent = wallMicros();
    this.clock.asks(id, sent);
    this.wire?.post({ family: "time", name: "ping", id, content: { sent: new Time(BigInt(Math.round(sent))) } });
    return id;
  }

  /** Says how much was read. */
  #tell(): void {
    const said = this.link ? this.ledger.tell() : null;
    if (said) this.wire?.post({ family: "time", name: "ack", content: { ...said } });
  }

  /** Everything that belonged to the old link is lost. */
  #lose(error: MomError): void {
    clearTimeout(this.#graceOver);
    const left = this.ledger.kept;
    [this.link, this.ledger] = [null, new Ledger()];
    this.connector.numbers.clear();
    this.guards.loseWithin("/", { reason: "disconnected" });
    for (const entry of this.outbox.take(() => true)) this.#dropped(entry, "lost", error);
    for (const entry of left) this.#dropped(entry, "unknown", error);
    // What the hub has read may still be without its answer.
    this.pending.failAll((parcel) => dropped(parcel, "unknown", error));
    this.subscribers.deliverAll({ type: "link-down" });
    if (this.state.state === "resuming") this.#state({ ...this.state, state: "trying" });
  }

  #close(error: MomError | null): void {
    clearTimeout(this.#graceOver);
    this.isEnding = true;
    const closed = new MomError("closed", error?.code ?? "disconnected", error ? `closed: ${error.text}` : "this client is closed", error?.number ?? 305, error?.content);
    this.link = null;
    this.outbox.take(() => true);
    this.guards.loseWithin("/", { reason: "disconnected" });
    this.pending.failAll(() => closed);
    this.subscribers.closeAll();
    this.#state(error ? { state: "closed", error } : { state: "closed" });
    for (const queue of this.#states) queue.close();
    this.#noteClosed();
  }

  /** Logs out after everything that was sent before. */
  async end(): Promise<void> {
    if (this.isEnding) return this.closed;
    this.isEnding = true;
    this.#mover.holding = false;
    this.connector.end();
    if (!this.wire) return this.closed;
    const id = ++this.#lastId;
    const answered = this.pending.wait({ family: "login", name: "logout" }, id, LAST_WORDS).catch(() => undefined);
    this.outbox.put({ family: "login", name: "logout", id }, { awaited: true });
    this.pump();
    await answered;
    this.endServing("logged out");
    return this.closed;
  }

  #state(state: LinkState): void {
    this.state = state;
    for (const device of this.devices) device.link(state);
    for (const queue of this.#states) queue.push(state);
    this.options.onState?.(state);
  }

  /** The states from now on, the present one first. */
  states(): Queue<LinkState> {
    const queue = new Queue<LinkState>(1024, () => this.state, () => this.#states.delete(queue));
    queue.push(this.state);
    if (this.state.state === "closed") queue.close();
    else this.#states.add(queue);
    return queue;
  }

  // What comes.

  #receive(parcel: Parcel | null, size: number): void {
    const now = performance.now();
    // What lies there after a halt of the whole program was said before, and the hub has given the link up: a device must not move by it.
    if (now - Math.min(this.#heard, this.#spoke) > this.me!.limits.gone) return this.endServing("this program was suspended for longer than a connection lasts");
    this.#heard = now;
    if (this.state.state === "stale") this.#state({ state: "connected", door: shown(this.wire!.pipe.door), resumed: false });
    if (parcel?.family === "time") return this.#time(parcel);
    if (this.link && this.ledger.heard(size, parcel)) this.#tell();
    if (!parcel?.name) return;
    parcel.size = size;
    if (parcel.family === "reply" || parcel.family === "error") this.#answer(parcel);
    else if (parcel.family === "manager") for (const listener of this.consults) listener(parcel);
    else this.#event(parcel);
  }

  #time(parcel: Parcel): void {
    const fields = fieldsOf(parcel.content);
    if (parcel.name === "pong") {
      this.pending.answer(parcel);
      this.clock.answered(parcel.reference, fields["received"], fields["sent"]);
    } else if (parcel.name === "ack" && this.link) {
      if (!this.ledger.acknowledged(saidOf(fields))) {
        this.link = null;
        return this.endServing("the hub acknowledges parcels that were not sent");
      }
      this.pump();
    }
  }

  #answer(parcel: Parcel): void {
    if (parcel.family === "error") this.guards.ended(parcel.reference);
    if (this.pending.answer(parcel) || parcel.family === "reply") return;
    const error = errorOf(parcel);
    if (error.number >= 300 && error.number < 500) {
      this.#closing = error;
      return;
    }
    const path = this.#sentTo.get(parcel.reference ?? -1);
    this.subscribers.deliver(path === undefined ? [] : [path], { type: "refused", path, error, id: parcel.reference });
  }

  #event(parcel: Parcel): void {
    const event = eventOf(parcel);
    const path = parcel.context ?? "/";
    const place = this.places.get(path);
    place?.latch.observe(event);
    this.guards.offers.heard(path, event, parcel);
    switch (event.type) {
      case "message":
        if (event.name === "status") this.#status(event);
        // Another token guards the channel from now on, or none.
        if (place && event.name === "halt" && event.sender === "hub") place.guard = guardOf(event.content, place.guard);
        break;
      case "grabbed":
      case "released":
      case "inhibited":
      case "uninhibited":
        return this.#tokenEvent(event);
      case "queued":
        this.onQueued.get(path)?.(event.place, event.expected);
        break;
      case "deleted":
        this.subscribers.deliver([...new Set([path, event.path])], event);
        return this.#forget(event.path);
      case "expelled":
        this.subscribers.deliver([path], event);
        if (event.peer === this.me?.peer) this.#forget(path);
        return;
    }
    this.subscribers.deliver([path], event);
  }

  /** How a device says that a command of this peer goes. */
  #status({ content, history }: MessageEvent): void {
    if (history) return;
    const fields = fieldsOf(content);
    const ended = fields["state"] === "finished" || fields["state"] === "error";
    if (ended && fields["peer"] === this.me?.peer) this.guards.ended(int(fields, "id"));
  }

  #tokenEvent(event: Event & { path: string }): void {
    const channels = this.places.guardedBy(event.path);
    if (event.type === "grabbed") {
      for (const { guard } of channels) if (guard && event.fence > guard.fence) [guard.fence, guard.owner] = [event.fence, event.owner];
    } else if (event.type === "released") {
      for (const { guard } of channels) if (guard && event.fence >= guard.fence) delete guard.owner;
      if (event.owner === this.me?.peer) this.guards.released(event.path, event.fence, { reason: event.reason, ...(event.by === undefined ? {} : { by: event.by }) });
    } else if (event.type === "uninhibited" && event.peer === this.me?.peer) {
      this.guards.unshared(event.path, { reason: event.reason ?? "released" });
    }
    this.subscribers.deliver([event.path, ...channels.map((place) => place.path)], event);
  }

  /** This peer is not there any more. */
  #forget(path: string): void {
    this.places.removeWithin(path);
    this.guards.loseWithin(path, { reason: "left" });
    this.subscribers.closeWithin(path);
  }

  #isOver(event: Event): boolean {
    const over = event.type === "message" && this.clock.isExpired(event.parcel);
    if (over) this.clock.expired += 1;
    return over;
  }

  // What goes.

  /** What is not known to be read is kept, and has the same bound as at the hub; only messages wait for that. */
  #permits({ lane, frame }: Entry): boolean {
    const { bytes, sent } = this.ledger;
    if (lane > MOST_PRIORITY || !bytes || bytes + frame.length <= this.outbox.most) return true;
    // By itself the hub says at once what it has read of much only; before a pong it says all.
    if (this.#asked !== sent) this.ping();
    this.#asked = sent;
    return false;
  }

  pump(): void {
    if (this.wire) this.outbox.pump(this.wire.pipe);
  }

  /** That something can be sent now or, while a link is resumed, later. */
  #check(): void {
    if (this.isEnding) throw new MomError("closed", "disconnected", "this client is closed");
    if (!this.wire && !this.link) throw disconnected("there is no connection to the hub at present");
  }

  /** Queues a parcel up at once, also in a full outbox: what is said later must not get in before it. */
  #put(parcel: Parcel, awaited: boolean): void {
    const { context, name } = parcel;
    const token = parcel.family === "message" ? this.places.tokenOf(context, name) : undefined;
    if (token !== undefined && name === "command" && parcel.id !== undefined) this.guards.owned(token)?.said(parcel.id);
    this.outbox.put(parcel, { delivery: parcel.delivery ?? this.places.get(context ?? "")?.delivery ?? "reliable", token, awaited });
    this.pump();
  }

  #idOf({ family, name, receipt }: Parcel): number {
    return family === "message" && (name === "command" || receipt) ? ++this.#lastAnswered : ++this.#lastId;
  }

  /** Sends a request and waits for its answer. */
  async request(parcel: Parcel, timeout = this.options.requestTimeout ?? 40_000, late?: (reply: Parcel) => void): Promise<Parcel> {
    this.#check();
    const id = parcel.id ?? this.#idOf(parcel);
    const sent: Parcel = { ...parcel, id, timestamp: parcel.timestamp ?? Time.now() };
    if (parcel.family === "token" && parcel.name === "release") {
      // By its fence it can be said again after a loss: it gives up this ownership, and no later one.
      const fence = parcel.fence ?? this.guards.owned(parcel.context ?? "")?.fence;
      if (fence !== undefined) sent.fence = fence;
    }
    const answer = this.pending.wait(sent, id, timeout, late);
    // It may fail while the message still waits.
    answer.catch(() => undefined);
    try {
      this.#put(sent, true);
    } catch (error) {
      this.pending.fail(id, error as MomError);
    }
    return answer;
  }

  /** Sends a parcel without waiting for an answer; where the outbox is full, waits until it is not, but for what stops and frees devices. */
  async post(parcel: Parcel): Promise<void> {
    this.#check();
    const id = parcel.id ?? this.#idOf(parcel);
    this.#put({ ...parcel, id, timestamp: parcel.timestamp ?? Time.now() }, false);
    if (parcel.context !== undefined) this.#sentTo.set(id, parcel.context);
    for (const old of this.#sentTo.keys()) {
      if (this.#sentTo.size <= REMEMBERED) break;
      this.#sentTo.delete(old);
    }
    if (this.outbox.bytes < this.outbox.most || parcel.name === "stop" || parcel.name === "unstop") return;
    await this.outbox.room();
    if (this.state.state === "closed") this.#check();
  }

  /** A parcel will not be sent, or nobody can say whether it was read: its sender is told. */
  #dropped({ parcel, awaited }: Entry, reason: string, cause?: MomError): void {
    const { id, context: path = "/", delivery } = parcel;
    this.guards.ended(id);
    if (awaited) this.pending.fail(id ?? -1, dropped(parcel, reason, cause));
    else this.subscribers.deliver([path], { type: "dropped", path, reason, count: 1, parcel, ...(delivery ? { delivery } : {}) });
  }

  // Contexts.

  async #join(place: Place): Promise<Fields> {
    const parcel: Parcel = { family: "context", name: "join", context: place.path };
    if (place.terms) parcel.content = this.places.said(place.terms, place);
    // From here on, since what comes right behind the answer is its first subscriber's.
    this.subscribers.keepEarly(place.path);
    const reply = fieldsOf((await this.request(parcel)).content);
    this.places.joined(place, reply);
    if (place.terms?.["device"] === true || reply["stop"] !== undefined) {
      const stops: Event = { type: "stops", path: place.path, state: stopStateOf(reply["stop"]) };
      place.latch.observe(stops);
      this.subscribers.deliver([place.path], stops);
    }
    return reply;
  }

  /** Joins a context, parents first. */
  async enter(path: string, kind?: string, terms?: Fields): Promise<void> {
    if (!/^\/([^/]+(\/[^/]+)*)?$/.test(path)) throw new MomError("local", "bad-path", `${JSON.stringify(path)} is not a path: write / or /a/b`, 221);
    const entered: Place[] = [];
    for (const each of wayTo(path)) {
      let place = this.places.get(each);
      const wanted = each === path ? terms : undefined;
      if (!place || wanted) {
        place ??= this.places.add(each, wanted);
        place.terms = wanted ?? place.terms;
        void this.#begin(place);
      }
      entered.push(place);
    }
    for (const place of entered) await place.joined;
    const found = entered.at(-1)?.kind ?? "session";
    if (kind !== undefined && found !== kind) throw new MomError("local", "wrong-kind", `${path} is a ${found}, not a ${kind}`, 215);
  }

  /** Begins to join a context, which is none of this peer's if that fails. */
  #begin(place: Place): Promise<unknown> {
    const joined = (place.joined = this.#join(place));
    joined.catch(() => place.joined === joined && this.places.remove(place));
    return joined;
  }

  #askToLeave(context: string): Promise<unknown> {
    return this.request({ family: "context", name: "leave", context });
  }

  /** Leaves a context and all below it. */
  async leave(path: string): Promise<void> {
    this.places.removeWithin(path);
    try {
      await this.#askToLeave(path);
    } finally {
      this.#forget(path);
    }
  }

  /** Leaves a context and joins it again, in one go. */
  async refresh(path: string): Promise<void> {
    const place = this.places.get(path);
    await (place ? Promise.all([this.#askToLeave(path), this.#begin(place)]) : this.enter(path));
  }

  events(path: string): Events {
    return this.subscribers.subscribe(path);
  }

  #renew(hold: Hold): void {
    this.request({ family: "token", name: "renew", context: hold.path }).then(
      (reply) => hold.terms(fieldsOf(reply.content)),
      (error: MomError) => {
        if (error.kind === "refused" && !error.mayRetry) this.guards.released(hold.path, hold.fence, { reason: error.code });
        else if (!hold.is) hold.terms({ lease: hold.lease ?? undefined, deadman: hold.deadman ?? undefined });
      },
    );
  }

  /** Takes the answer to a login on a live connection. */
  renewed(welcome: Welcome): void {
    if (this.me && welcome.user !== this.me.user) {
      // Another user is another peer, and nothing of the old one belongs to it: the hub has read what was said before this login.
      this.ledger = new Ledger();
      this.#lose(disconnected("logged in as another user"));
      this.places.removeWithin("/");
    }
    this.me = welcome;
  }
}

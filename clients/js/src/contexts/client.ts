import { Channel } from "./channel.js";
import type { LinkCredential } from "../end.js";
import type { HubClock } from "../clock.js";
import { Consult } from "./consult.js";
import { asyncDispose } from "../disposal.js";
import { type ContextInfo, type Events, type Member, contextOf, memberOf } from "../events.js";
import { welcome } from "../login.js";
import type { Obeys } from "./obey.js";
import type { ConnectOptions, LinkState, Proof } from "../options.js";
import { Peer } from "../peer/peer.js";
import type { Parcel } from "../parcel.js";
import { Queue } from "../queue.js";
import { Session } from "./session.js";
import { type StopOptions, type StopReport, type StopState, reportOf, stopStateOf } from "../stops.js";
import { Token } from "./token.js";
import { type Fields, fieldsOf, list } from "../value.js";

/** What a new context is to be: `kind`, `manager`, and the other keys of docs/PROTOCOL.md (Create). */
export type ContextSpec = { kind: "session" | "channel" | "token" } & Fields;

/** How much a member wants of a channel. */
export interface Thinning {
  /** Only the newest waiting message of each sender and name. */
  newest?: boolean;
  /** At most so many of each sender and name: `"5/s"`, `"12/min"`, or a number per second. */
  rate?: string | number;
}

/**
 * Connects to a hub and logs in; tries until it succeeds, the hub refuses, or {@link ConnectOptions.connectWithin} is over.
 *
 * `address` is `mom://HOST` for all doors that a browser has, each tried 250 ms after the one before; or one door: `wss://` and `ws://` for
 * a WebSocket, `https://` and `http://` for the HTTP tunnel; or several, with blanks between them, tried in this order. A password or token is
 * said over TLS or to loopback only.
 *
 * ```ts
 * const client = await connect("mom://lab.example.org", { user: "alice", password: "secret" });
 * const chat = await client.channel("/chat");
 * await chat.send("chat", "good morning");
 * for await (const event of chat.events()) {
 *   if (event.type === "message") console.log(event.sender, event.content);
 * }
 * ```
 *
 * @throws MomError `refused` with `bad-login` and other refusals of the hub, `local` with `insecure` for a secret that others could read,
 * `connection` for a hub that cannot be reached.
 */
export async function connect(address: string, options: ConnectOptions): Promise<Client> {
  const peer = new Peer(address, options);
  await peer.start();
  if (globalThis.document && options.logoutOnHide !== false) {
    const hide = (): void => void peer.end();
    globalThis.addEventListener("pagehide", hide);
    void peer.closed.then(() => globalThis.removeEventListener("pagehide", hide));
  }
  return new Client(peer);
}

/** A peer that is logged in at a hub. */
export class Client {
  /** @internal */
  readonly peer: Peer;

  /** @internal */
  constructor(peer: Peer) {
    this.peer = peer;
  }

  /** The peer's name at the hub. It may be another one after a new login. */
  get name(): string {
    return this.peer.me!.peer;
  }

  /** The user. */
  get user(): string {
    return this.peer.me!.user;
  }

  /** The user's level; higher goes first. */
  get level(): number {
    return this.peer.me!.level;
  }

  /** The hub's reply to the login. */
  get welcome(): Fields {
    return this.peer.me!.content;
  }

  /** The hub's clock, as measured over this link. */
  get clock(): HubClock {
    return this.peer.clock;
  }

  /** What ends this peer from elsewhere ({@link endPeer}), if its login asked for a link. It is a secret. */
  get credential(): LinkCredential | null {
    const { id, secret } = this.peer.link ?? {};
    return id !== undefined && secret ? { id, secret } : null;
  }

  /** The state of the link. */
  get state(): LinkState {
    return this.peer.state;
  }

  /** The states of the link, the present one first; ends when it is closed. */
  states(): AsyncIterableIterator<LinkState> {
    return this.peer.states();
  }

  /** Joins a session, parents first. */
  async session(path: string): Promise<Session> {
    await this.peer.enter(path, "session");
    return new Session(this, path);
  }

  /**
   * Joins a channel, parents first; with thinning, the hub sends fewer messages of others. As a `device` this peer halts at each `stop`
   * there, stays halted until `unstop`, and says so by a message `state` whose content has `stopped`.
   */
  async channel(path: string, terms?: Thinning & { device?: boolean }): Promise<Channel> {
    await this.peer.enter(path, "channel", terms && { ...terms });
    return new Channel(this, path);
  }

  /** Joins a channel as a device, which `device` of `mom-client/device` declares; gives what it is there, such as its `report` and `leave`. */
  async obey<Obeying>(path: string, device: Obeys<Obeying>): Promise<Obeying> {
    device.check();
    this.peer.places.cards.set(path, device.card());
    // From here on, since the answer to the join says how it stands.
    const events = this.peer.events(path);
    try {
      return device.start(await this.channel(path, { device: true }), events);
    } catch (error) {
      void events.return();
      this.peer.places.cards.delete(path);
      throw error;
    }
  }

  /**
   * Stops all devices of a channel, or of all channels below a session in which this peer has the right `stop`. It joins nothing, goes before
   * everything else, and is answered when each device has said that it obeys and, if it says anything of its rest, that it rests, or after a second.
   */
  async stop(path: string, options: StopOptions = {}): Promise<StopReport> {
    return this.#stopping("stop", path, options);
  }

  /**
   * Lifts the stops of a channel up to this number, or of channels by their paths up to theirs. They are the newest that its user has seen, those of
   * {@link StopState}, and never taken from a refusal. A newer one holds on, and is named in the report.
   */
  async unstop(path: string, stops: number | { [path: string]: number }, options: Omit<StopOptions, "reason"> = {}): Promise<StopReport> {
    return this.#stopping("unstop", path, { ...options, [typeof stops === "number" ? "stop" : "stops"]: stops });
  }

  /** How the devices of a channel stand by the hub's books. */
  async stops(channel: string): Promise<StopState> {
    return stopStateOf((await this.info(channel))["stop"]);
  }

  async #stopping(name: "stop" | "unstop", path: string, content: object): Promise<StopReport> {
    return reportOf(await this.ask("context", name, path, content as Fields));
  }

  /**
   * Leaves a channel and joins it again, so that what it keeps, and what its devices tell who joins, is heard anew: for who has heard that
   * something was dropped, or has come back after a loss. Subscriptions go on; what is said between the two is not heard.
   */
  refresh(path: string): Promise<void> {
    return this.peer.refresh(path);
  }

  /** Joins a token, parents first; this gives its events, not ownership. */
  async token(path: string): Promise<Token> {
    await this.peer.enter(path, "token");
    return new Token(this, path);
  }

  /** Looks up a path. */
  async lookup(path: string): Promise<ContextInfo> {
    return contextOf(await this.ask("context", "lookup", path));
  }

  /** The contexts in a session, as far as this peer may look them up. */
  async list(path: string): Promise<ContextInfo[]> {
    return (await this.#pages("list", path, "children")).map(contextOf);
  }

  /** The members of a context. */
  async members(path: string): Promise<Member[]> {
    return (await this.#pages("members", path, "members")).map(memberOf);
  }

  /** Details of one context, by the keys of docs/PROTOCOL.md. */
  info(path: string): Promise<Fields> {
    return this.ask("context", "info", path);
  }

  /** What the device of a channel says that it can do; undefined where no device there has a card. Nothing that protects may rely on it. */
  async card(path: string): Promise<Fields | undefined> {
    return (await this.ask("context", "info", path, { card: true }))["card"] as Fields | undefined;
  }

  /** The statistics of a channel or of the channels of a session, by the keys of docs/PROTOCOL.md. */
  stats(path: string): Promise<Fields> {
    return this.ask("context", "stats", path);
  }

  /** Creates a context; joins its parent. */
  async create(path: string, spec: ContextSpec): Promise<ContextInfo> {
    await this.peer.enter(path.slice(0, path.lastIndexOf("/")) || "/");
    return contextOf(await this.ask("context", "create", path, spec));
  }

  /** Deletes a context with all below it. */
  async delete(path: string): Promise<void> {
    await this.ask("context", "delete", path);
  }

  /** Invites a peer to a context, subject to its manager; joins the context. */
  async invite(path: string, peer: string): Promise<void> {
    await this.peer.enter(path);
    await this.ask("context", "invite", path, { peer });
  }

  /** Expels a peer from a context and all below it, and keeps it out for so many ms (60 000). Expelled from `/`, it is disconnected. */
  async expel(path: string, peer: string, options: { text?: string; for?: number } = {}): Promise<void> {
    await this.ask("context", "expel", path, { peer, ...options });
  }

  /** The hub's questions to this peer about contexts that it manages, from now on. */
  consults(): AsyncIterableIterator<Consult> {
    const listener = (parcel: Parcel): void => queue.push(new Consult(this, parcel));
    const queue = new Queue<Consult>(1024, () => new Consult(this, { family: "manager", name: "consult" }), () => this.peer.consults.delete(listener));
    this.peer.consults.add(listener);
    return queue;
  }

  /** Events that no other subscription takes, from now on. */
  unaddressed(): Events {
    return this.peer.subscribers.subscribeRest();
  }

  /** Authenticates again, for example before a token expires. The proof is used for later logins, too. */
  async authenticateAgain(proof: Proof): Promise<void> {
    const options = this.peer.connector.changed(proof);
    let reply = await this.peer.request({ family: "login", name: "login", context: "/", content: await options.login() });
    if (reply.name === "challenge") reply = await this.peer.request({ family: "login", name: "answer", context: "/", content: await options.answer(reply) });
    this.peer.renewed(welcome(fieldsOf(reply.content)));
    options.keep();
  }

  /** Sends a request, with a new id and a timestamp unless it has them, and gives its answer. A message is answered only if it asks for a receipt. */
  request(parcel: Parcel): Promise<Parcel> {
    return this.peer.request(parcel);
  }

  /** Sends a parcel as it is, with a new id and a timestamp unless it has them; waits only for capacity in this client's own queue. */
  sendParcel(parcel: Parcel): Promise<void> {
    return this.peer.post(parcel);
  }

  /** Logs out after everything that was sent before. */
  close(): Promise<void> {
    return this.peer.end();
  }

  /** The same, for `await using`. */
  [asyncDispose](): Promise<void> {
    return this.close();
  }

  /** @internal */
  async ask(family: "context" | "token", name: string, path: string, content?: Fields): Promise<Fields> {
    const reply = await this.peer.request({ family, name, context: path, ...(content && Object.keys(content).length ? { content } : {}) });
    return fieldsOf(reply.content);
  }

  /** All pages of a list. */
  async #pages(name: string, path: string, key: string): Promise<Fields[]> {
    const all: Fields[] = [];
    for (let content: Fields | undefined; ; ) {
      const page = await this.ask("context", name, path, content);
      all.push(...list(page, key).map(fieldsOf));
      if (page["more"] !== true || page["next"] === undefined) return all;
      content = { after: page["next"] };
    }
  }
}

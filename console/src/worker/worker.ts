// The worker: the hub's client, away from the page's thread.
import { type Client, type Parcel, MomError, type TokenGuard, fieldsOf, report } from "mom-client";
import { Asking } from "./asking.js";
import { Feeds, birth } from "./feeds.js";
import { Jogging } from "./jogging.js";
import { OrderedStops, isWithin } from "./ordered.js";
import { answerFields, failure, plainFields } from "./plain.js";
import type { Say } from "./port.js";
import { type CallName, type Calls, type Owned, type Question, firstId } from "./protocol.js";
import { unreachedSince } from "./rest.js";
import { Session } from "./session.js";
import { Standing } from "./standing.js";
import { Stopping } from "./stopping.js";
import { Troubles } from "./troubles.js";

/** What answers each call; the answer may take its time. */
type Answers = { [Name in CallName]: (...args: Parameters<Calls[Name]>) => ReturnType<Calls[Name]> | Promise<ReturnType<Calls[Name]>> };

/** The minor version of the protocol from which hubs have cards of devices. */
const WITH_CARDS = 4;

/** By how much the clock of a message's sender is ahead of this machine's, ms; 0 where that is not known. */
function ahead(client: Client, parcel: Parcel): number {
  const said = parcel.timestamp?.toDate().getTime();
  const { born } = birth(client, parcel);
  return said === undefined || born === undefined ? 0 : said - born;
}

/** Serves one page over a port. */
export function serve(port: { postMessage: (word: unknown, transfer: Transferable[]) => void; onmessage: ((event: MessageEvent) => void) | null }): void {
  const say: Say = (word, transfer = []) => port.postMessage(word, transfer);
  let nextId = firstId();
  const session = new Session(say, (client) => {
    feeds.reset(client);
    asking.reset(client);
    stopping.reset(client);
  }, () => feeds.ask());
  const standing = new Standing(say, () => session.isUp);
  const stopping: Stopping = new Stopping(say, () => session.login, () => session.isUp, standing);
  const asking = new Asking(say);
  const feeds: Feeds = new Feeds(say, (path, event, client) => {
    standing.heard(path, event);
    asking.heard(path, event, client);
    troubles.heard(path, event, client.name);
    if (event.type !== "message" || event.name !== "state" || event.history) return;
    const said = fieldsOf(event.content);
    if (typeof said["stopped"] === "boolean") stopping.heard(path, event.sender, said, unreachedSince(said, ahead(client, event.parcel)));
  });
  const troubles = new Troubles(say);
  const jogging = new Jogging(() => session.client, say);
  const ordered = new OrderedStops();

  /** A stop ends what is under way for its place; what is said later is meant anew. */
  function stops(top: string): void {
    ordered.add(top);
    if (jogging.path !== undefined && isWithin(jogging.path, top)) jogging.set(null);
  }

  async function obtain(path: string, how: (token: Awaited<ReturnType<Client["token"]>>) => Promise<TokenGuard>): Promise<Owned> {
    const token = await session.client.token(path);
    asking.follow(path);
    return session.own(await how(token));
  }

  const answers: Answers = {
    connect: (login) => session.connect(login),
    close: () => {
      stopping.end();
      return session.close();
    },
    watch: (id, watch) => feeds.watch(id, watch),
    unwatch: (id) => feeds.unwatch(id),
    shown: (id) => feeds.shown(id),
    pictureFile: (id) => feeds.pictureFile(id),
    send: async (path, name, content, options = {}) => {
      const { to, basedOn, stop, id = (nextId += 2), ...slots } = options;
      if (name === "unstop" && stop === undefined) throw new MomError("local", "bad-slot", "unstop requires the newest stop that you have seen, and there is none here");
      const before = ordered.count(path);
      await session.client.channel(path);
      if (name === "command" && ordered.count(path) !== before) throw new MomError("local", "stopped", "STOP was pressed before it was sent");
      const parcel: Parcel = { family: "message", name, context: path, id, receipt: true, ...slots };
      if (content !== undefined) parcel.content = content;
      if (to) parcel.address = to;
      if (basedOn !== undefined) parcel.extra = { "based-on": basedOn };
      if (stop !== undefined) parcel.extra = { ...parcel.extra, stop };
      const receipt = plainFields((await session.client.request(parcel)).content);
      const dropped = receipt["dropped"];
      return { id, delivered: Number(receipt["delivered"] ?? 0), dropped: Array.isArray(dropped) ? dropped.map(String) : [] };
    },
    jog: (jog) => jogging.set(jog),
    stop: (order, top, terms) => {
      if (order === "stop") stops(top);
      return stopping.order(order, top, terms);
    },
    stopOne: (order, path, terms) => {
      if (order === "stop") stops(path);
      return stopping.one(order, path, terms);
    },
    stopsOf: (paths) => standing.ask(paths),
    ask: async (family, name, path, content) => {
      const parcel: Parcel = { family, name, context: path, ...(content ? { content } : {}) };
      return answerFields((await session.client.request(parcel)).content);
    },
    card: async (path) => {
      const { client } = session;
      // An earlier hub refuses what it does not know.
      if (Number(fieldsOf(client.welcome["protocol"])["minor"] ?? 0) < WITH_CARDS) return null;
      const card = await client.card(path);
      return card === undefined ? null : answerFields(card);
    },
    create: async (path, spec) => void (await session.client.create(path, spec as Parameters<Client["create"]>[1])),
    list: (path) => session.client.list(path),
    members: (path) => session.client.members(path),
    grab: (path, wait) => obtain(path, (token) => token.grab(wait === undefined ? {} : { wait })),
    withdraw: async (path) => void (await session.client.request({ family: "token", name: "release", context: path })),
    request: (path, text) => obtain(path, (token) => token.request(text === undefined ? {} : { text })),
    accept: (path) => obtain(path, (token) => token.accept()),
    decline: async (path) => (await session.client.token(path)).decline(),
    acceptRequest: async (path, peer) => (await session.client.token(path)).acceptRequest(peer),
    declineRequest: async (path, peer, text) => (await session.client.token(path)).declineRequest(peer, text),
    give: async (path, to, options) => {
      const given = await session.owned(path).give(to, options);
      if (options.for !== undefined || options.commands !== undefined) void given.returned().then((guard) => guard && session.own(guard));
    },
    release: (path) => session.owned(path).release(),
    breakHold: async (path) => (await session.client.token(path)).breakHold(),
    report: (address, what) => report(address, what),
  };

  port.onmessage = ({ data }: MessageEvent<Question>) => {
    const { id, call, args } = data;
    const answer = answers[call] as ((...args: unknown[]) => unknown) | undefined;
    void (async () => {
      if (!answer) throw new MomError("local", "unknown-verb", `there is no call ${String(call)}`);
      return answer(...args);
    })().then(
      (value) => say({ word: "answer", id, value: value ?? null }),
      (error: unknown) => say({ word: "failure", id, failure: failure(error) }),
    );
  };
}

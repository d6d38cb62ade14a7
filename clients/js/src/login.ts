// From a connection to a peer.
import { utf8 } from "./bytes.js";
import { MomError, local } from "./error.js";
import { CAN_INFLATE } from "./inflater.js";
import { type Said, saidOf } from "./ledger.js";
import type { ConnectOptions } from "./options.js";
import { type Parcel, errorOf } from "./parcel.js";
import { hmac, join } from "./sha256.js";
import { type Fields, Time, fieldsOf, int, text } from "./value.js";
import type { Wire } from "./wire.js";

const LOGIN = "mom-login-1";
const LINK = "mom-link-1";
const ZERO = Uint8Array.of(0);

/** What resumes a lost connection. */
export interface Link {
  id: string;
  secret: Uint8Array;
  grace: number;
  /** Whether the hub takes a checksum of what was read: those before 1.3 refuse it. */
  checks: boolean;
}

/** What the hub said at login. */
export interface Welcome {
  peer: string;
  user: string;
  level: number;
  link: Link | null;
  limits: { parcel: number; outbox: number; heartbeat: number; gone: number };
  /** Whether the hub takes cards of devices. */
  takesCards: boolean;
  content: Fields;
}

export type NextId = () => number;

/** Sends one parcel of the login and gives its answer. */
async function ask(wire: Wire, nextId: NextId, name: string, content: Fields): Promise<Parcel> {
  const id = nextId();
  wire.post({ family: "login", name, id, context: "/", timestamp: Time.now(), content });
  for (;;) {
    const parcel = await wire.next();
    // What the hub says without being asked is why it closes.
    if (parcel.family === "error" && (parcel.reference === id || parcel.reference === undefined)) throw errorOf(parcel);
    if (parcel.family === "reply" && parcel.reference === id) return parcel;
  }
}

/** Refuses options that no hub takes, before anybody is asked. */
export function check({ heartbeat }: ConnectOptions): void {
  if (heartbeat === undefined || (Number.isInteger(heartbeat) && heartbeat >= 100 && heartbeat <= 10_000)) return;
  throw local("bad-content", `heartbeat must be a whole number of ms from 100 to 10000, not ${heartbeat}`);
}

/** Logs in. A hub that does not know links yet is asked again without. */
export async function logIn(wire: Wire, options: ConnectOptions, nextId: NextId): Promise<Welcome> {
  const plain = await credentials(options);
  const more: Fields = {};
  // Who does not come back leaves at once.
  const { link = options.reconnect !== false } = options;
  if (link) more["link"] = link === true ? true : { grace: link.grace };
  if (options.heartbeat !== undefined) more["heartbeat"] = options.heartbeat;
  if (options.compress && CAN_INFLATE) more["compress"] = ["stream-deflate"];
  try {
    return await once(wire, options, nextId, { ...plain, ...more });
  } catch (error) {
    const unknown = error instanceof MomError && error.code === "bad-content" && Object.keys(more).some((key) => error.slot === `content/${key}`);
    if (!unknown) throw error;
    return once(wire, options, nextId, plain);
  }
}

async function once(wire: Wire, options: ConnectOptions, nextId: NextId, content: Fields): Promise<Welcome> {
  let reply = await ask(wire, nextId, "login", content);
  if (reply.name === "challenge") reply = await ask(wire, nextId, "answer", { signature: await sign(options, reply) });
  return welcome(fieldsOf(reply.content));
}

/** The content of a login. */
export async function credentials(options: ConnectOptions): Promise<Fields> {
  return { ...(await proof(options)), nickname: options.nickname };
}

async function proof(options: ConnectOptions): Promise<Fields> {
  const { password, key, token, guest } = options;
  const given = [password, key, token, guest || undefined].filter((proof) => proof !== undefined).length;
  if (given !== 1) throw local("bad-login", `give one of password, key, token and guest, not ${given}`);
  if (guest) return { guest: true };
  if (token !== undefined) return { token: typeof token === "string" ? token : await token() };
  if (options.user === undefined) throw local("bad-login", "a password or key requires `user`");
  return key ? { name: options.user, key: true } : { name: options.user, password };
}

/** What the hub is to be shown, of its challenge. */
function challenge(reply: Parcel, context: string): { hub: string; nonce: Uint8Array } {
  const fields = fieldsOf(reply.content);
  const [hub, nonce] = [text(fields, "hub"), fields["nonce"]];
  // A proof must be useless for any other purpose.
  if (text(fields, "context") !== context || hub === undefined || !(nonce instanceof Uint8Array) || nonce.length !== 32) {
    throw local("bad-content", `the hub's challenge is not one for ${context}`);
  }
  return { hub, nonce };
}

export async function sign({ key, user = "", hubName }: ConnectOptions, reply: Parcel): Promise<Uint8Array> {
  if (!key) throw local("bad-content", "the hub asks for a signature, and no key was given");
  const { hub, nonce } = challenge(reply, LOGIN);
  if (hubName !== undefined && hubName !== hub) throw local("bad-login", `the hub is "${hub}", not "${hubName}": nothing was signed for it`);
  return key.sign(join(utf8(LOGIN), ZERO, utf8(hub), ZERO, utf8(user), ZERO, nonce));
}

/** What the hub says to a resume. */
export interface Resumed {
  /** What of this side it has read. */
  said: Said;
  content: Fields;
}

async function prove(wire: Wire, link: Link, read: Said | (() => Promise<Said>), nextId: NextId): Promise<Resumed | null> {
  const { hub, nonce } = challenge(await ask(wire, nextId, "resume", { link: link.id }), LINK);
  const proof = hmac(link.secret, join(utf8(LINK), ZERO, utf8(hub), ZERO, utf8(link.id), ZERO, nonce));
  const said = typeof read === "function" ? await read() : read;
  const content = fieldsOf((await ask(wire, nextId, "answer", { proof, ...(link.checks ? said : { read: said.read }) })).content);
  return content["resumed"] === true ? { said: saidOf(content), content } : null;
}

/** Resumes a link of which nobody knows any more what was read, only to end it. */
export async function resumeToEnd(wire: Wire, { id, secret }: Pick<Link, "id" | "secret">, nextId: NextId): Promise<Resumed | null> {
  const link = { id, secret, grace: 0, checks: false };
  const having = (read: number): Promise<Resumed | null> => prove(wire, link, { read }, nextId);
  try {
    return await having(0);
  } catch (error) {
    const acknowledged = error instanceof MomError ? int(error.content, "acknowledged") : undefined;
    if (acknowledged === undefined) throw error;
    return having(acknowledged);
  }
}

/** Resumes a link; null if the hub does not, and a login may follow. How much was read may be asked for when it is to be said. */
export async function resume(wire: Wire, link: Link, read: Said | (() => Promise<Said>), nextId: NextId): Promise<Resumed | null> {
  try {
    return await prove(wire, link, read, nextId);
  } catch (error) {
    // Others than `not-resumed` are those of a hub that knows no links, or not this one: a login says more.
    if (error instanceof MomError && error.kind === "refused" && error.number < 300) return null;
    throw error;
  }
}

export function welcome(content: Fields): Welcome {
  const [peer, user] = [text(content, "peer"), text(content, "user")];
  if (peer === undefined || user === undefined) throw local("bad-content", "the hub's welcome has no peer or user");
  return { peer, user, level: int(content, "level") ?? 0, link: linkOf(content), limits: limitsOf(content), takesCards: minorOf(content) >= 4, content };
}

/** The minor version of the hub's protocol. */
function minorOf(content: Fields): number {
  return int(fieldsOf(content["protocol"]), "minor") ?? 0;
}

function linkOf(content: Fields): Link | null {
  const link = fieldsOf(content["link"]);
  const [id, secret, grace] = [text(link, "id"), link["secret"], int(link, "grace")];
  const checks = minorOf(content) >= 3;
  return id !== undefined && secret instanceof Uint8Array && grace !== undefined ? { id, secret, grace, checks } : null;
}

function limitsOf(content: Fields): Welcome["limits"] {
  const limits = fieldsOf(content["limits"]);
  const limit = (key: string, usual: number): number => (limits[key] === "unlimited" ? Infinity : int(limits, key) || usual);
  return { parcel: limit("parcel", 8 << 20), outbox: limit("outbox", 4 << 20), heartbeat: limit("heartbeat", 10_000), gone: limit("gone", 30_000) };
}

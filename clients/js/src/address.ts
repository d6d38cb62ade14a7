import { local } from "./error.js";

/** One way to a hub. */
export interface Door {
  kind: "websocket" | "tunnel";
  tls: boolean;
  /** As it stands in a URL. */
  host: string;
  port: number;
  /** Each request of the tunnel is answered as a whole. */
  polled: boolean;
}

const ADDRESS = /^([a-z]+):\/\/(\[[0-9a-fA-F:.]+\]|[\p{L}\p{N}._-]+)(?::(\d{1,5}))?\/?(?:\?(.*))?$/u;
const PORT = 7666;

/** How an address is written. */
export function shown(door: Door): string {
  const scheme = `${door.kind === "tunnel" ? "http" : "ws"}${door.tls ? "s" : ""}`;
  return `${scheme}://${door.host}:${door.port}`;
}

/** Whether nobody between could read what is said; of names only `localhost` is loopback. */
export function isPrivate(door: Door): boolean {
  return door.tls || /^(localhost|127(\.\d{1,3}){3}|\[::1\])$/i.test(door.host);
}

/** The doors of all addresses, in their order; those that cannot be used are left out as long as another one can. */
export function doorsOf(addresses: string, secret: boolean, secureOnly: boolean): Door[] {
  const doors: Door[] = [];
  let failure: unknown;
  for (const address of addresses.trim().split(/\s+/)) {
    try {
      doors.push(...doorsOfOne(address, secret, secureOnly));
    } catch (error) {
      failure ??= error;
    }
  }
  if (!doors.length) throw failure;
  return doors;
}

/**
 * The doors of an address, the best first: one for `ws://`, `wss://`, `http://` and `https://`; for `mom://` all that a browser has.
 * Those that are `insecure` are left out where a secret is to be said, and those that no page from `https://` may open.
 */
function doorsOfOne(address: string, secret: boolean, secureOnly: boolean): Door[] {
  const [, scheme = "", host = "", port, query = ""] = ADDRESS.exec(address) ?? [];
  const polled = query === "poll=1";
  if (!host || (query && !polled)) throw local("bad-path", `${JSON.stringify(address)} is not the address of a hub: write mom://HOST, wss://HOST or https://HOST`);
  const named = port === undefined ? undefined : Number(port);
  if (named !== undefined && (named < 1 || named > 65535)) throw local("bad-path", `${address}: a port must be a number from 1 to 65535`);
  const door = (kind: Door["kind"], tls: boolean, usual: number): Door => ({ kind, tls, host, port: named ?? usual, polled });
  let doors: Door[];
  switch (scheme) {
    case "ws": doors = [door("websocket", false, 80)]; break;
    case "wss": doors = [door("websocket", true, 443)]; break;
    case "http": doors = [door("tunnel", false, 80)]; break;
    case "https": doors = [door("tunnel", true, 443)]; break;
    case "mom": case "moms": doors = all(door, named, scheme === "moms"); break;
    default: throw local("bad-path", `a browser cannot speak ${scheme}://: write mom://, ws://, wss://, http:// or https://`);
  }
  const first = doors[0]!;
  if (secret) doors = doors.filter(isPrivate);
  if (!doors.length) {
    const safe = shown({ ...first, tls: true });
    throw local("insecure", `a password or token is sent over TLS or loopback only, and others could read it on its way to ${address}: write ${safe}, or use a key; nothing was sent`);
  }
  // Browsers take loopback for safe, whatever the page.
  if (secureOnly) doors = doors.filter(isPrivate);
  if (!doors.length) throw local("insecure", `a page from https:// may not connect to ${address}: write ${shown({ ...first, tls: true })}`);
  return doors;
}

/** A tunnel without TLS is taken from loopback only, since anyone who sees its id could take it over. */
function all(door: (kind: Door["kind"], tls: boolean, usual: number) => Door, port: number | undefined, tls: boolean): Door[] {
  const doors = [door("websocket", true, PORT), door("websocket", false, PORT), door("tunnel", true, PORT), door("tunnel", false, PORT)];
  if (port === undefined) doors.push(door("websocket", true, 443), door("tunnel", true, 443));
  return doors.filter((door) => (door.kind === "tunnel" ? isPrivate(door) : true)).filter((door) => door.tls || !tls);
}

import type { Key } from "./key.js";
import type { WebSocketClass } from "./pipe.js";
import type { MomError } from "./error.js";

/** How a peer proves who it is; exactly one of them. */
export interface Proof {
  /** The user's password. It is sent over TLS or loopback only. */
  password?: string;
  /** A key of the user's, for devices. It is taken from anywhere, since no secret travels. */
  key?: Key;
  /**
   * A token (JWT) of an issuer that the hub trusts, or what gives one, which is asked at each login. It is sent where a password is. What that throws at
   * first `connect` throws, too; at a later login the attempt has failed, which the state tells, and is made again.
   */
  token?: string | (() => string | Promise<string>);
  /** Log in as a guest, where the hub lets them in. */
  guest?: boolean;
}

/** How to connect. */
export interface ConnectOptions extends Proof {
  /** The user, with `password` or `key`. */
  user?: string;
  /**
   * Which installed program a device is: the same after each start, and no other's, 64 bytes at most. Where a channel has one device, a
   * program that is started later takes the place of its own earlier start. Without it each client is another device.
   */
  installation?: string;
  /** The requested name at the hub instead of the user's. */
  nickname?: string;
  /** The hub for which the key may sign, by the name in the hub's configuration; otherwise it signs for any. */
  hubName?: string;
  /** What makes WebSockets, where there is no global one (Node before 22): `WebSocket` of the package `ws`. */
  webSocket?: WebSocketClass;
  /** Whether a lost connection is resumed without losing anything (`true`), and for how many ms the hub keeps this peer meanwhile. */
  link?: boolean | { grace: number };
  /** ms between signs of life, from 100 to 10 000; the hub's own, mostly 10 s, unless another is asked for. */
  heartbeat?: number;
  /**
   * Has the hub compress all that it says (zlib), which brings texts to about a tenth of their bytes and pictures to what they were, where the
   * platform can open it. What this peer says stays as it is: browsers compress no stream that has to arrive at once. Not by default.
   */
  compress?: boolean;
  /** ms for a reply; 40 s, because a manager may have to ask a peer. */
  requestTimeout?: number;
  /** ms for one attempt to connect and log in; 10 s. */
  connectTimeout?: number;
  /** ms after which the next door is tried as well; 250. */
  stagger?: number;
  /** On the tunnel: ms until a WebSocket is tried again, then twice as long each time, 5 min at most; 5 s, and 0 for never. */
  seekWebSocket?: number;
  /** ms after which the first connection is given up if no attempt succeeds; 60 s. */
  connectWithin?: number;
  /** ms after which a lost connection is given up; never unless said. */
  giveUpAfter?: number;
  /** `false`: a lost connection closes the client. */
  reconnect?: boolean;
  /** The most events that wait for one subscriber; 4096, which is more than one read of the network brings. */
  eventBuffer?: number;
  /**
   * Reports to the hub, once, without a login and maybe in the clear, why the first attempt to connect fails, if the connection is at fault; under this
   * name and version of a program. Off unless it is given. {@link report} reports other errors.
   */
  report?: { program: string; version?: string };
  /** Called with each state of the link, also before the first connection. */
  onState?: (state: LinkState) => void;
  /** Gives up connecting, or closes the client. */
  signal?: AbortSignal;
  /** Log out when the page is left (`true`), so that the hub does not wait for it. */
  logoutOnHide?: boolean;
}

/**
 * The state of the link: `trying` to connect, `connected`, `stale` while nothing has been heard for 1.5 heartbeats, `resuming` after a
 * loss that may yet lose nothing, `closed` for good.
 */
export type LinkState =
  | { state: "trying"; attempt: number; error?: MomError }
  | { state: "connected"; door: string; resumed: boolean }
  | { state: "stale" }
  | { state: "resuming"; attempt: number; error?: MomError }
  | { state: "closed"; error?: MomError };

// Reports of errors to a hub, by HTTP and without a login: they get through where nothing else does (M56).
import { doorsOf } from "./address.js";
import { utf8 } from "./bytes.js";
import { MomError } from "./error.js";

/** The bytes of a report that a hub takes, and the letters of what is not text in it. */
const MOST = 4096;
const WORD = 64;
/** So many reports in a minute; a hub takes 10 from one address. */
const PER_MINUTE = 5;
const MINUTE = 60_000;
/** ms for the hub's answer. */
const PATIENCE = 5000;

/** What a program reports of an error of its own. It may go over the network in the clear. */
export interface Report {
  /** What happened, for people. What is longer than a hub takes is cut. */
  text: string;
  level?: "error" | "warn" | "info";
  /** A word for it, such as the `code` of a {@link MomError}. */
  code?: string;
  /** Who reports. */
  program?: string;
  /** Its version. */
  version?: string;
}

/** What was reported in the last minute, and when. */
const lately = new Map<string, number>();
/** The hub takes no more before. */
let notBefore = 0;

/**
 * Reports an error to the hub at an address, where its operators read it by `mom logs`; gives whether the hub has taken it, and never fails. It is sent
 * with TLS if the address has it and it works; else in the clear, but not by pages from `https://`. At most 5 reports leave in a minute, and each text once.
 */
export async function report(address: string, what: Report): Promise<boolean> {
  try {
    const body = bodyOf(what);
    if (body === null || !isTimely(what.text)) return false;
    for (const url of urlsOf(address)) {
      const answer = await post(url, body);
      if (!answer) continue;
      if (answer.status === 429) notBefore = performance.now() + 1000 * (Number(answer.headers.get("retry-after")) || PATIENCE / 1000);
      return answer.ok;
    }
  } catch {
    // Reporting an error must not raise another one.
  }
  return false;
}

/** Reports why a first attempt to connect failed, if that is an error of the connection: what a hub refuses it knows. */
export function reportFailure(address: string, error: unknown, by: { program: string; version?: string }): void {
  if (error instanceof MomError && (error.kind === "connection" || error.kind === "timed-out")) void report(address, { text: error.text, code: error.code, ...by });
}

/** Null if there is nothing to say. */
function bodyOf({ text, level, code, program, version }: Report): string | null {
  if (!text.trim()) return null;
  const words = Object.entries({ code, program, version }).flatMap(([key, word]) => (word === undefined ? [] : [[key, lettersOf(word, WORD).join("")]]));
  const letters = lettersOf(text, MOST);
  for (;;) {
    const body = JSON.stringify({ text: letters.join(""), level: level ?? "error", ...(Object.fromEntries(words) as object) });
    const over = utf8(body).length - MOST;
    if (over <= 0) return body;
    // No letter is written in more than 12 bytes.
    letters.splice(-Math.ceil(over / 12));
  }
}

/** Halves of letters are none. */
function lettersOf(text: string, most: number): string[] {
  return [...text].slice(0, most).map((letter) => (/^\p{Surrogate}$/u.test(letter) ? "\ufffd" : letter));
}

/** Counts a report, unless it is one too many. */
function isTimely(text: string): boolean {
  const now = performance.now();
  for (const [said, at] of lately) if (now - at >= MINUTE) lately.delete(said);
  if (now < notBefore || lately.size >= PER_MINUTE || lately.has(text)) return false;
  lately.set(text, now);
  return true;
}

/** Where the hub may take HTTP, TLS first; programs also try the port of the web, as others may be closed. */
function urlsOf(address: string): string[] {
  const secureOnly = globalThis.location?.protocol === "https:";
  const urls = new Set<string>();
  const doors = doorsOf(address, false, secureOnly);
  for (const { tls, host, port } of doors) if (tls) urls.add(`https://${host}:${port}/log`);
  for (const { tls, host, port } of doors) if (!tls || !secureOnly) urls.add(`http://${host}:${port}/log`);
  if (!globalThis.location) for (const { host } of doors) urls.add(`http://${host}:80/log`);
  return [...urls];
}

/** Undefined where nobody answers. A body of text needs no leave of the hub beforehand, if the page is another's. */
function post(url: string, body: string): Promise<Response | undefined> {
  const how: RequestInit = { method: "POST", body, cache: "no-store", credentials: "omit", redirect: "error", referrerPolicy: "no-referrer", signal: AbortSignal.timeout(PATIENCE) };
  return fetch(url, how).catch(() => undefined);
}

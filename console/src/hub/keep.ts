// What survives a reload of the page: how it has logged in, and the link of the peer that it leaves behind.
import type { Login, Previous } from "../worker/protocol.js";

const DATABASE = "mom";
const STORE = "keys";
const SEAL = "seal";

/** What is written, sealed. The key does not leave the browser, and what it seals ends with the tab. */
interface Kept {
  user?: string | undefined;
  password?: string | undefined;
  guest?: boolean | undefined;
  /** The user's key is the one in this browser. */
  keyed?: boolean | undefined;
  link?: { id: string; secret: number[] } | undefined;
}

function store(): Promise<IDBObjectStore> {
  return new Promise((resolve, reject) => {
    const opening = indexedDB.open(DATABASE, 1);
    opening.onupgradeneeded = () => opening.result.createObjectStore(STORE);
    opening.onerror = () => reject(opening.error ?? new Error("no storage"));
    opening.onsuccess = () => resolve(opening.result.transaction(STORE, "readwrite").objectStore(STORE));
  });
}

async function done<T>(asked: IDBRequest<T>): Promise<T> {
  return new Promise((resolve, reject) => {
    asked.onsuccess = () => resolve(asked.result);
    asked.onerror = () => reject(asked.error ?? new Error("no storage"));
  });
}

async function seal(): Promise<CryptoKey> {
  const found = await done((await store()).get(SEAL) as IDBRequest<CryptoKey | undefined>);
  if (found) return found;
  const made = await crypto.subtle.generateKey({ name: "AES-GCM", length: 256 }, false, ["encrypt", "decrypt"]);
  await done((await store()).put(made, SEAL));
  return made;
}

/** Of one connection of the page. */
const place = (address: string, name: string): string => (name ? `mom ${name} ${address}` : `mom ${address}`);

/** Writes what is to survive; nothing where the browser has no Web Crypto or no storage. */
async function write(address: string, name: string, kept: Kept): Promise<void> {
  const iv = crypto.getRandomValues(new Uint8Array(12));
  const plain = new TextEncoder().encode(JSON.stringify(kept));
  const sealed = new Uint8Array(await crypto.subtle.encrypt({ name: "AES-GCM", iv }, await seal(), plain));
  sessionStorage.setItem(place(address, name), JSON.stringify([[...iv], [...sealed]]));
}

async function read(address: string, name: string): Promise<Kept | null> {
  const found = sessionStorage.getItem(place(address, name));
  if (!found) return null;
  const [iv, sealed] = JSON.parse(found) as [number[], number[]];
  const plain = await crypto.subtle.decrypt({ name: "AES-GCM", iv: Uint8Array.from(iv) }, await seal(), Uint8Array.from(sealed));
  return JSON.parse(new TextDecoder().decode(plain)) as Kept;
}

/** Whether another page lives that has this link: a tab that was copied has the same storage. */
async function isAlive(link: string): Promise<boolean> {
  if (!("locks" in navigator)) return true;
  return navigator.locks.request(`mom ${link}`, { ifAvailable: true }, (lock) => Promise.resolve(lock === null));
}

/** By connection. */
const alive = new Map<string, AbortController>();

/** Says to copies of this tab that this page has the link, as long as it lives. */
function live(name: string, link: string): void {
  alive.get(name)?.abort();
  const mine = new AbortController();
  alive.set(name, mine);
  if (!("locks" in navigator)) return;
  void navigator.locks.request(`mom ${link}`, { ifAvailable: true }, () => new Promise<void>((resolve) => mine.signal.addEventListener("abort", () => resolve())));
}

/** Keeps a login until the tab is closed or the user logs out. */
export async function keep(address: string, login: Login, link: Previous | null, name = ""): Promise<void> {
  if (link) live(name, link.id);
  const { user, password, guest, key } = login;
  await write(address, name, { user, password, guest, keyed: key !== undefined, link: link ? { id: link.id, secret: [...link.secret] } : undefined }).catch(() => undefined);
}

/** The login that was kept, and the link of the page that was here before. */
export async function kept(address: string, name = ""): Promise<Login | null> {
  const found = await read(address, name).catch(() => null);
  if (!found) return null;
  const { user, password, guest, link } = found;
  const key = found.keyed && user !== undefined ? await storedKey(user) : undefined;
  if (found.keyed && !key) return null;
  const previous = link && !(await isAlive(link.id)) ? { id: link.id, secret: Uint8Array.from(link.secret) } : undefined;
  return { address, user, password, guest, key, previous };
}

export function forget(address: string, name = ""): void {
  alive.get(name)?.abort();
  try {
    sessionStorage.removeItem(place(address, name));
  } catch {
    // A browser without storage has kept nothing.
  }
}

/** Keeps a user's key in this browser; it cannot be read out of it. */
export async function storeKey(user: string, key: CryptoKey): Promise<void> {
  await done((await store()).put(key, `user ${user}`));
}

export async function storedKey(user: string): Promise<CryptoKey | undefined> {
  try {
    return await done((await store()).get(`user ${user}`) as IDBRequest<CryptoKey | undefined>);
  } catch {
    return undefined;
  }
}

/** The users whose keys are in this browser. */
export async function storedUsers(): Promise<string[]> {
  try {
    const keys = await done((await store()).getAllKeys());
    return keys.map(String).filter((key) => key.startsWith("user ")).map((key) => key.slice(5));
  } catch {
    return [];
  }
}

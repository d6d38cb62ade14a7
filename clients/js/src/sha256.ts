// SHA-256 and HMAC of it, for the proof of a link. Web Crypto has both, but not in a page that came over plain HTTP from another
// machine, as in many labs; so there is one way for all.

const PRIMES = (count: number): number[] => {
  const found: number[] = [];
  for (let number = 2; found.length < count; number++) if (found.every((prime) => number % prime)) found.push(number);
  return found;
};
const fraction = (number: number): number => Math.floor((number - Math.floor(number)) * 2 ** 32);
const START = PRIMES(8).map((prime) => fraction(Math.sqrt(prime)));
const ROUNDS = PRIMES(64).map((prime) => fraction(Math.cbrt(prime)));

const rotate = (word: number, by: number): number => (word >>> by) | (word << (32 - by));

function block(state: number[], view: DataView, at: number): void {
  const words = Array.from({ length: 16 }, (_, place) => view.getInt32(at + 4 * place));
  for (let place = 16; place < 64; place++) {
    const [near, far] = [words[place - 2]!, words[place - 15]!];
    const low = rotate(far, 7) ^ rotate(far, 18) ^ (far >>> 3);
    const high = rotate(near, 17) ^ rotate(near, 19) ^ (near >>> 10);
    words.push((words[place - 16]! + low + words[place - 7]! + high) | 0);
  }
  let [a, b, c, d, e, f, g, h] = state as [number, number, number, number, number, number, number, number];
  for (let place = 0; place < 64; place++) {
    const choice = (e & f) ^ (~e & g);
    const first = (h + (rotate(e, 6) ^ rotate(e, 11) ^ rotate(e, 25)) + choice + ROUNDS[place]! + words[place]!) | 0;
    const majority = (a & b) ^ (a & c) ^ (b & c);
    const second = ((rotate(a, 2) ^ rotate(a, 13) ^ rotate(a, 22)) + majority) | 0;
    [h, g, f, e, d, c, b, a] = [g, f, e, (d + first) | 0, c, b, a, (first + second) | 0];
  }
  [a, b, c, d, e, f, g, h].forEach((word, place) => (state[place] = (state[place]! + word) | 0));
}

/** SHA-256. */
export function sha256(bytes: Uint8Array): Uint8Array {
  const padded = new Uint8Array(Math.ceil((bytes.length + 9) / 64) * 64);
  padded.set(bytes);
  padded[bytes.length] = 0x80;
  const view = new DataView(padded.buffer);
  view.setBigUint64(padded.length - 8, BigInt(bytes.length) * 8n);
  const state = [...START];
  for (let at = 0; at < padded.length; at += 64) block(state, view, at);
  const digest = new Uint8Array(32);
  state.forEach((word, place) => new DataView(digest.buffer).setInt32(4 * place, word));
  return digest;
}

/** HMAC-SHA-256 of what `parts` make one after the other. */
export function hmac(secret: Uint8Array, ...parts: Uint8Array[]): Uint8Array {
  const key = new Uint8Array(64);
  key.set(secret.length > 64 ? sha256(secret) : secret);
  const inner = sha256(join(key.map((byte) => byte ^ 0x36), ...parts));
  return sha256(join(key.map((byte) => byte ^ 0x5c), inner));
}

/** All of these one after the other. */
export function join(...parts: Uint8Array[]): Uint8Array {
  const all = new Uint8Array(parts.reduce((length, part) => length + part.length, 0));
  parts.reduce((at, part) => (all.set(part, at), at + part.length), 0);
  return all;
}

// The JSON form of parcels, exactly: `JSON.parse` makes one number of 1 and 1.0, and orders keys anew.

const KINDS = {
  id: "number", reference: "number", priority: "number", expires: "number", fence: "number", age: "number", "age-error": "number",
  timestamp: "time", received: "time",
};
const KNOWN = ["family", "name", "id", "reference", "sender", "address", "timestamp", "priority", "context", "expires", "delivery", "fence", "received", "age", "age-error", "echo", "receipt"];
const property = (slot) => (slot === "age-error" ? "ageError" : slot);

/** Reads and writes it with the values of one build of the client. */
export function jsonForm({ Double, Time }) {
  class Parser {
    at = 0;

    constructor(text) {
      this.text = text;
    }

    #skip() {
      while (" \t\r\n".includes(this.text[this.at] ?? "x")) this.at++;
    }

    #take(pattern) {
      this.#skip();
      pattern.lastIndex = this.at;
      const found = pattern.exec(this.text)?.[0];
      if (found !== undefined) this.at += found.length;
      return found;
    }

    value() {
      if (this.#take(/\{/y)) return untag(this.#map());
      if (this.#take(/\[/y)) return this.#list();
      const string = this.#take(/"(?:[^"\\]|\\.)*"/y);
      if (string !== undefined) return JSON.parse(string);
      const number = this.#take(/-?\d+(\.\d+)?([eE][+-]?\d+)?/y);
      if (number !== undefined) return /[.eE]/.test(number) ? new Double(Number(number)) : whole(number);
      const word = this.#take(/true|false|null/y);
      if (word === undefined) throw new Error(`no JSON at ${this.at} of ${this.text}`);
      return JSON.parse(word);
    }

    /** The members of an object, before tags are read. */
    #map() {
      const map = new Map();
      if (this.#take(/\}/y)) return map;
      do {
        const key = JSON.parse(this.#take(/"(?:[^"\\]|\\.)*"/y));
        this.#take(/:/y);
        map.set(key, key === "$map" && !map.size ? this.slots() : this.value());
      } while (this.#take(/,/y));
      this.#take(/\}/y);
      return map;
    }

    #list() {
      const list = [];
      if (this.#take(/\]/y)) return list;
      do list.push(this.value());
      while (this.#take(/,/y));
      this.#take(/\]/y);
      return list;
    }

    /** An object in which no key is a tag. */
    slots() {
      this.#take(/\{/y);
      return this.#map();
    }
  }

  const whole = (text) => (Number.isSafeInteger(Number(text)) ? Number(text) : BigInt(text));

  function untag(map) {
    const [entry] = map;
    const [tag, value] = entry ?? [""];
    if (!tag.startsWith("$")) return map;
    if (tag === "$int") return whole(String(value));
    if (tag === "$double") return value instanceof Double ? value : new Double(Number(value));
    if (tag === "$time") return Time.of(value);
    if (tag === "$binary") return new Uint8Array(Buffer.from(value, "base64"));
    if (tag === "$map") return value;
    throw new Error(`${tag} is not a tag`);
  }

  /** A parcel of a line. */
  function read(line) {
    const parcel = {};
    const extra = new Map();
    for (const [slot, value] of new Parser(line).slots()) {
      if (slot === "content") parcel.content = value;
      else if (!KNOWN.includes(slot)) extra.set(slot, value);
      else parcel[property(slot)] = KINDS[slot] === "time" && typeof value === "string" ? Time.of(value) : value;
    }
    if (extra.size) parcel.extra = extra;
    return parcel;
  }

  /** The line of a parcel. */
  function write(parcel) {
    const slots = [];
    for (const slot of KNOWN) {
      const value = parcel[property(slot)];
      if (value !== undefined) slots.push([slot, KINDS[slot] === "time" ? JSON.stringify(value.toString()) : json(value)]);
    }
    for (const [slot, value] of parcel.extra ?? []) slots.push([slot, json(value)]);
    if (parcel.content !== undefined) slots.push(["content", json(parcel.content)]);
    return `{${slots.map(([slot, value]) => `${JSON.stringify(slot)}:${value}`).join(",")}}`;
  }

  function json(value) {
    if (value === null || typeof value === "boolean" || typeof value === "string" || typeof value === "number") return JSON.stringify(value);
    if (typeof value === "bigint") return `{"$int":"${value}"}`;
    if (value instanceof Double) return Number.isInteger(value.number) && Math.abs(value.number) < 1e21 ? `${Object.is(value.number, -0) ? "-0" : value.number}.0` : String(value.number);
    if (value instanceof Time) return `{"$time":"${value}"}`;
    if (value instanceof Uint8Array) return `{"$binary":"${Buffer.from(value).toString("base64")}"}`;
    if (Array.isArray(value)) return `[${value.map(json).join(",")}]`;
    const members = `{${[...value].map(([key, member]) => `${JSON.stringify(key)}:${json(member)}`).join(",")}}`;
    return [...value.keys()][0]?.startsWith("$") ? `{"$map":${members}}` : members;
  }

  return { read, write };
}

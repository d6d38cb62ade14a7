// The objects of a model: all of them at first, then what differs (lab/model).
import { fields, flag, list, number, text, time } from "../../hub/fields.js";
import type { Plain, PlainFields } from "../../worker/protocol.js";

export interface Thing {
  name: string;
  x: number;
  y: number;
  z: number;
  yaw: number;
  size: number | undefined;
  /** mm. */
  error: number | undefined;
  colour: string | undefined;
  held: boolean;
  writtenBy: string | undefined;
  /** Since when its place is known, ms since 1970 by the hub's clock. */
  since: number | undefined;
  cameras: string[];
}

export interface Model {
  seq: number | undefined;
  /** As the model tells them. */
  told: ReadonlyMap<string, PlainFields>;
  /** Something was missed: ask for all. */
  gap: boolean;
}

export const EMPTY: Model = { seq: undefined, told: new Map(), gap: false };

/** More than a table of people would show. */
const MOST = 500;

/** With the content of a message `objects`: all there are. */
export function snapshot(content: Plain | undefined): Model {
  const all = fields(content);
  const told = new Map<string, PlainFields>();
  for (const each of list(all, "objects").slice(0, MOST)) {
    const name = text(fields(each), "name");
    if (name !== undefined) told.set(name, fields(each));
  }
  return { seq: number(all, "seq"), told, gap: false };
}

/** With that of a message `objects-changed`: what differs, null where something was removed. */
export function changed(model: Model, content: Plain | undefined): Model {
  const all = fields(content);
  const seq = number(all, "seq");
  // Said again for who came later, or before all were told.
  if (seq !== undefined && model.seq !== undefined && seq <= model.seq) return model;
  const told = new Map(model.told);
  for (const each of list(all, "objects")) {
    const change = fields(each);
    const name = text(change, "name");
    if (name === undefined || (!told.has(name) && told.size >= MOST)) continue;
    const after = { ...told.get(name), ...change };
    for (const [key, value] of Object.entries(after)) if (value === null) delete after[key];
    told.set(name, after);
  }
  for (const name of list(all, "gone")) told.delete(String(name));
  return { seq, told, gap: model.gap || model.seq === undefined || seq !== model.seq + 1 };
}

/** Those with a name and a place, by their names. */
export function thingsOf(model: Model): Thing[] {
  const things = [...model.told].flatMap(([name, told]): Thing[] => {
    const [x, y, z] = [number(told, "x"), number(told, "y"), number(told, "z")];
    if (x === undefined || y === undefined || z === undefined) return [];
    const colour = list(told, "colour").map(Number);
    const since = [time(told, "seen"), time(told, "written")].filter((at) => at !== undefined);
    return [
      {
        name,
        x,
        y,
        z,
        yaw: number(told, "yaw") ?? 0,
        size: number(told, "size"),
        error: number(told, "error"),
        colour: colour.length === 3 && colour.every((part) => part >= 0 && part <= 255) ? `rgb(${colour.map(Math.round).join(" ")})` : undefined,
        held: flag(told, "held"),
        writtenBy: text(told, "written-by"),
        since: since.length ? Math.max(...since) : undefined,
        cameras: list(told, "cameras").map(String),
      },
    ];
  });
  return things.sort((one, other) => (one.name < other.name ? -1 : 1));
}

/** What a shell takes as one word. */
export function word(name: string): string {
  return /^[A-Za-z0-9_./:-]+$/.test(name) ? name : `'${name.replaceAll("'", "'\\''")}'`;
}

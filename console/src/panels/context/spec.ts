// What the hub is told of a context that is to be made.
import { texts } from "../../texts/index.js";
import type { Plain, PlainFields } from "../../worker/protocol.js";

export type Kind = "session" | "channel" | "token";

/** What the form says; empty is: as the hub says. */
export interface Form {
  name: string;
  kind: Kind;
  manager: string;
  presence: string;
  transient: boolean;
  delivery: string;
  overflow: string;
  latest: boolean;
  parcels: number | null;
  bytes: number | null;
  /** s. */
  age: number | null;
  guard: string;
  names: string;
  /** s. */
  lease: number | null;
  /** ms. */
  deadman: number | null;
  expiry: string;
  safeOnGive: boolean;
  more: string;
}

export function emptyForm(): Form {
  return { name: "", kind: "channel", manager: "", presence: "", transient: false, delivery: "", overflow: "", latest: false, parcels: null, bytes: null, age: null, guard: "", names: "command", lease: null, deadman: null, expiry: "", safeOnGive: true, more: "" };
}

export function pathOf(parent: string, name: string): string {
  return `${parent === "/" ? "" : parent}/${name}`;
}

/** The content of `create`, or what is wrong with the form. */
export function specOf(form: Form): PlainFields | string {
  const t = texts.context.form;
  if (!form.name || /[\s/]/.test(form.name)) return t.noName;
  const spec: PlainFields = { kind: form.kind };
  const set = (key: string, value: Plain | undefined): void => {
    if (value !== undefined && value !== null && value !== "") spec[key] = value;
  };
  set("manager", form.manager.trim());
  set("presence", form.presence);
  if (form.transient) spec["transient"] = true;
  if (form.kind === "channel") {
    set("delivery", form.delivery);
    set("overflow", form.overflow);
    const keep: PlainFields = {};
    if (form.latest) keep["latest"] = true;
    if (form.parcels) keep["parcels"] = Math.round(form.parcels);
    if (form.bytes) keep["bytes"] = Math.round(form.bytes);
    if (form.age) keep["age"] = Math.round(form.age * 1000);
    if (Object.keys(keep).length) spec["keep"] = keep;
    if (form.guard.trim()) spec["guard"] = { token: form.guard.trim(), names: form.names.split(/\s+/).filter(Boolean) };
  }
  if (form.kind === "token") {
    if (form.lease) spec["lease"] = Math.round(form.lease * 1000);
    if (form.deadman) spec["deadman"] = Math.round(form.deadman);
    set("expiry", form.expiry);
    if (!form.safeOnGive) spec["safe-on-give"] = false;
  }
  if (!form.more.trim()) return spec;
  let more: unknown;
  try {
    more = JSON.parse(form.more);
  } catch (error) {
    return t.notJson(error instanceof Error ? error.message : "");
  }
  if (typeof more !== "object" || more === null || Array.isArray(more)) return t.notMap;
  for (const [key, value] of Object.entries(more)) {
    if (key in spec) return t.twice(key);
    spec[key] = value as Plain;
  }
  return spec;
}

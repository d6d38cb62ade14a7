// What clicks and keys select in a list of robots.

export interface Selected {
  units: ReadonlySet<number>;
  /** The one that keys begin from. */
  active: number | null;
  /** The other end of a range. */
  anchor: number | null;
}

export const NOTHING: Selected = { units: new Set(), active: null, anchor: null };

export const only = (unit: number): Selected => ({ units: new Set([unit]), active: unit, anchor: unit });

export function toggled({ units }: Selected, unit: number): Selected {
  const next = new Set(units);
  if (!next.delete(unit)) next.add(unit);
  return { units: next, active: unit, anchor: unit };
}

/** From the anchor to here, in the order of the list; added to what there is, or instead of it. */
export function extended(before: Selected, unit: number, order: readonly number[], adding = false): Selected {
  const anchor = before.anchor !== null && order.includes(before.anchor) ? before.anchor : unit;
  const [from, to] = [order.indexOf(anchor), order.indexOf(unit)].sort((one, other) => one - other) as [number, number];
  return { units: new Set([...(adding ? before.units : []), ...order.slice(from, to + 1)]), active: unit, anchor };
}

/** What a key does in the list; undefined if it means nothing there. `page` is so many rows. */
export function keyed(before: Selected, order: readonly number[], key: string, { shift, control }: { shift: boolean; control: boolean }, page: number): Selected | undefined {
  if (!order.length) return undefined;
  const at = before.active === null ? -1 : order.indexOf(before.active);
  if (control && key.toLowerCase() === "a") return { ...before, units: new Set(order) };
  if (key === "Enter") return at < 0 ? undefined : toggled(before, order[at]!);
  const steps: { [key: string]: number } = { ArrowDown: at + 1, ArrowUp: at < 0 ? order.length - 1 : at - 1, PageDown: at + page, PageUp: at - page, Home: 0, End: order.length - 1 };
  const to = steps[key];
  if (to === undefined) return undefined;
  const unit = order[Math.min(order.length - 1, Math.max(0, to))]!;
  if (shift) return extended(before, unit, order);
  return control ? { ...before, active: unit } : only(unit);
}

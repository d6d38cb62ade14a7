// A tree of contexts as rows, and what keys do in it (the pattern "tree" of ARIA).
import type { ContextInfo, ContextKind } from "mom-client";
import type { Failure, PlainFields } from "../worker/protocol.js";

export interface Node {
  path: string;
  name: string;
  kind: ContextKind;
  depth: number;
  parent: Node | null;
  members: number | undefined;
  /** Not asked for yet: null. */
  children: Node[] | null;
  open: boolean;
  /** Why its children are not known. */
  failure: Failure | null;
  /** What `info` says of it, where it was asked. */
  info: PlainFields | null;
}

export interface Row {
  node: Node;
  /** Its place among its siblings that are shown, from 1, and how many those are. */
  place: number;
  of: number;
}

export function nodeOf(info: ContextInfo, parent: Node | null): Node {
  const name = info.name ?? (info.path === "/" ? "/" : info.path.slice(info.path.lastIndexOf("/") + 1));
  return { path: info.path, name, kind: info.kind, depth: parent ? parent.depth + 1 : 0, parent, members: info.members, children: null, open: false, failure: null, info: null };
}

/** Takes the children that there are now; those that are known stay the same nodes. Gives those that are gone. */
export function graft(node: Node, infos: readonly ContextInfo[]): Node[] {
  const before = new Map((node.children ?? []).map((child) => [child.path, child]));
  node.children = infos.map((info) => {
    const known = before.get(info.path);
    // Something else may have been made at the same path.
    if (known?.kind !== info.kind) return nodeOf(info, node);
    before.delete(info.path);
    if (info.members !== undefined) known.members = info.members;
    return known;
  });
  return [...before.values()];
}

export function find(node: Node, path: string): Node | undefined {
  if (node.path === path) return node;
  const within = node.path === "/" || path.startsWith(`${node.path}/`);
  if (!within) return undefined;
  for (const child of node.children ?? []) {
    const found = find(child, path);
    if (found) return found;
  }
  return undefined;
}

/** `/`, and each part of a path down to its parent. */
export function ancestors(path: string): string[] {
  const parts = path.split("/").filter(Boolean).slice(0, -1);
  return ["/", ...parts.map((_, index) => `/${parts.slice(0, index + 1).join("/")}`)].slice(0, path === "/" ? 0 : undefined);
}

export function parentOf(path: string): string {
  return path.slice(0, path.lastIndexOf("/")) || "/";
}

/** All nodes that are known. */
export function* walk(node: Node): Generator<Node> {
  yield node;
  for (const child of node.children ?? []) yield* walk(child);
}

/** The rows that are seen: what is open, or with a filter what it finds, and what leads there. */
export function rows(top: Node | null, filter = ""): Row[] {
  if (!top) return [];
  const wanted = filter.trim().toLowerCase();
  let shown: Set<Node> | undefined;
  if (wanted) {
    shown = new Set();
    for (const node of walk(top)) {
      if (!node.path.toLowerCase().includes(wanted) && node.kind !== wanted) continue;
      for (let at: Node | null = node; at && !shown.has(at); at = at.parent) shown.add(at);
    }
  }
  const found: Row[] = [];
  const add = (nodes: readonly Node[]): void => {
    const seen = shown ? nodes.filter((node) => shown.has(node)) : nodes;
    seen.forEach((node, index) => {
      found.push({ node, place: index + 1, of: seen.length });
      if (node.children && (shown || node.open)) add(node.children);
    });
  };
  add([top]);
  return found;
}

export type Step = { to: string } | { open: string } | { close: string } | { choose: string } | null;

/** What a key does, from the row where one is. Printable keys go to the next name that begins with them. */
export function step(all: readonly Row[], at: string | null, key: string): Step {
  const index = Math.max(0, all.findIndex(({ node }) => node.path === at));
  const here = all[index]?.node;
  if (!here) return null;
  const to = (row: Row | undefined): Step => (row ? { to: row.node.path } : null);
  switch (key) {
    case "ArrowDown":
      return to(all[index + 1]);
    case "ArrowUp":
      return to(all[index - 1]);
    case "Home":
      return to(all[0]);
    case "End":
      return to(all.at(-1));
    case "PageDown":
      return to(all[Math.min(all.length - 1, index + 10)]);
    case "PageUp":
      return to(all[Math.max(0, index - 10)]);
    case "ArrowRight":
      if (here.kind !== "session") return null;
      if (!here.open) return { open: here.path };
      return here.children?.length && all[index + 1]?.node.parent === here ? to(all[index + 1]) : null;
    case "ArrowLeft":
      if (here.kind === "session" && here.open) return { close: here.path };
      return here.parent ? { to: here.parent.path } : null;
    case "Enter":
      return { choose: here.path };
  }
  if ([...key].length !== 1 || key === " ") return null;
  const letter = key.toLowerCase();
  const after = [...all.slice(index + 1), ...all.slice(0, index)];
  return to(after.find(({ node }) => node.name.toLowerCase().startsWith(letter)));
}

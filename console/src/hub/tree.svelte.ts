// The tree of contexts as it is now: children are asked for when they are looked at, and what changes there is told by the sessions that this page has joined.
import type { ContextInfo, ContextKind } from "mom-client";
import type { Happening, HubEvent, PlainFields } from "../worker/protocol.js";
import { failureOf } from "./failure.js";
import { fields, number, text } from "./fields.js";
import { type Node, type Row, ancestors, find, graft, nodeOf, rows, walk } from "./forest.js";
import type { Hub } from "./hub.svelte.js";
import { whileVisible } from "./visible.js";

/** ms between two looks at sessions that are open, for what no event tells. */
const LOOK = 5000;
/** ms between two looks at tokens that are seen. */
const TOKENS = 2000;
/** A session with so few children is opened at once. */
const FEW = 24;
/** So many sessions are looked into for a filter. */
const MOST_LOOKS = 300;

export class Tree {
  top: Node | null = null;
  filter = $state("");
  /** Counts changes: nodes themselves are no state. */
  #version = $state(0);
  readonly #watches = new Map<string, () => void>();
  #seen: readonly Row[] = [];
  #looked = 0;
  #searched = false;

  constructor(
    readonly hub: Hub,
    readonly path = "/",
  ) {}

  readonly rows = $derived.by(() => {
    void this.#version;
    return rows(this.top, this.filter);
  });

  /** How many contexts are known. */
  get count(): number {
    void this.#version;
    return this.top ? [...walk(this.top)].length : 0;
  }

  node(path: string): Node | undefined {
    void this.#version;
    return this.top ? find(this.top, path) : undefined;
  }

  /** Follows the tree until the function that it gives is called. */
  start(): () => void {
    let tokens = 0;
    // It may be another user's turn, or another connection.
    [this.#looked, this.#searched] = [0, false];
    for (const node of this.top ? walk(this.top) : []) if (node.open) this.#watch(node.path);
    const end = whileVisible(500, async () => {
      if (!this.hub.isUp) return;
      if (!this.top) await this.#begin();
      const now = Date.now();
      if (now - this.#looked > LOOK) {
        this.#looked = now;
        await Promise.all([...(this.top ? walk(this.top) : [])].filter(({ open }) => open).map((node) => this.#list(node)));
      }
      if (now - tokens > TOKENS) {
        tokens = now;
        await this.#infos(this.#seen.map(({ node }) => node).filter(({ kind }) => kind === "token"));
      }
    });
    return () => {
      end();
      for (const unwatch of this.#watches.values()) unwatch();
      this.#watches.clear();
    };
  }

  async #begin(): Promise<void> {
    const { path } = this;
    const answer: PlainFields = path === "/" ? { kind: "session", number: 0 } : await this.hub.call("ask", "context", "lookup", path).catch(() => ({}));
    const kind = text(answer, "kind");
    if (kind === undefined) return;
    this.top = nodeOf({ path, kind: kind as ContextKind, number: number(answer, "number") ?? 0, name: path }, null);
    await this.open(path);
    const sessions = (this.top.children ?? []).filter(({ kind }) => kind === "session");
    if ((this.top.children ?? []).length <= FEW) await Promise.all(sessions.map(({ path }) => this.open(path)));
  }

  async open(path: string): Promise<void> {
    const node = this.node(path);
    if (node?.kind !== "session" || node.open) return;
    node.open = true;
    this.#version += 1;
    this.#watch(path);
    await this.#list(node);
  }

  close(path: string): void {
    const node = this.node(path);
    if (!node?.open) return;
    node.open = false;
    this.#unwatch(path);
    this.#version += 1;
  }

  /** Opens all that leads to a context; false if it is not there. */
  async reveal(path: string): Promise<boolean> {
    for (const above of ancestors(path)) if (above.startsWith(this.path)) await this.open(above);
    return this.node(path) !== undefined;
  }

  /** Says which rows are seen: what is not known of them is asked for. */
  look(seen: readonly Row[]): void {
    this.#seen = seen;
    void this.#infos(seen.map(({ node }) => node).filter(({ info, kind }) => info === null && kind !== "session"));
  }

  /** Looks into all sessions, so that a filter finds what is in them. */
  async search(): Promise<void> {
    if (this.#searched || !this.top) return;
    this.#searched = true;
    let looks = 0;
    const waiting: Node[] = [this.top];
    for (let node = waiting.shift(); node && looks < MOST_LOOKS; node = waiting.shift()) {
      if (node.kind === "session" && node.children === null) {
        looks += 1;
        await this.#list(node);
      }
      waiting.push(...(node.children ?? []));
    }
  }

  /** Asks for the children of a context again. */
  async refresh(path: string): Promise<void> {
    const node = this.node(path);
    if (node?.kind === "session") await this.#list(node);
    else if (node) await this.#infos([node]);
  }

  #watch(path: string): void {
    if (this.#watches.has(path)) return;
    this.#watches.set(path, this.hub.watch({ path, kind: "session" }, { events: (events) => this.#heard(path, events), joined: () => void this.refresh(path) }));
  }

  #unwatch(path: string): void {
    for (const [watched, unwatch] of [...this.#watches]) {
      if (watched !== path && !watched.startsWith(path === "/" ? "/" : `${path}/`)) continue;
      unwatch();
      this.#watches.delete(watched);
      const node = this.node(watched);
      if (node) node.open = false;
    }
  }

  async #list(node: Node): Promise<void> {
    try {
      const children = await this.hub.call("list", node.path);
      this.#take(node, children);
      node.failure = null;
    } catch (error) {
      node.failure = failureOf(error);
      node.children ??= [];
    }
    this.#version += 1;
  }

  #take(node: Node, children: readonly ContextInfo[]): void {
    for (const gone of graft(node, children)) this.#unwatch(gone.path);
  }

  async #infos(nodes: readonly Node[]): Promise<void> {
    if (!nodes.length || !this.hub.isUp) return;
    // Asked for once, also where the answer is no.
    for (const node of nodes) node.info ??= {};
    await Promise.all(
      nodes.map(async (node) => {
        const info = await this.hub.call("ask", "context", "info", node.path).catch(() => null);
        if (!info) return;
        node.info = info;
        node.members = number(info, "members") ?? node.members;
      }),
    );
    this.#version += 1;
  }

  #heard(path: string, events: readonly HubEvent[]): void {
    const node = this.node(path);
    if (!node) return;
    let again = false;
    for (const event of events) {
      if (event.type === "message") continue;
      const { type, what, path: where } = event as Happening;
      switch (type) {
        case "created":
        case "deleted":
        case "rejoined":
          again = true;
          break;
        case "joined":
        case "left":
          if (where === path) node.members = node.members === undefined ? undefined : Math.max(0, node.members + (type === "joined" ? 1 : -1));
          break;
        case "count":
          node.members = number(fields(what), "count") ?? node.members;
          break;
      }
    }
    if (again) void this.#list(node);
    this.#version += 1;
  }
}

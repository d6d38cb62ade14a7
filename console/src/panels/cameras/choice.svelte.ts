// Which cameras are shown and how, as this browser remembers it.
import { fields, list, text } from "../../hub/fields.js";
import { remember, remembered } from "../../hub/remember.js";
import type { PlainFields } from "../../worker/protocol.js";

export type Layout = "big" | "grid";

const KEY = "mom-cameras";
const FIRST = 4;

export class Choice {
  /** Undefined as long as nobody has chosen. */
  #shown = $state.raw<readonly string[] | undefined>(undefined);
  added = $state.raw<readonly string[]>([]);
  layout = $state<Layout>("big");

  constructor() {
    const kept = fields(remembered(KEY) as PlainFields | null);
    if (Array.isArray(kept["shown"])) this.#shown = list(kept, "shown").map(String);
    this.added = list(kept, "added").map(String);
    if (text(kept, "layout") === "grid") this.layout = "grid";
  }

  shown(known: readonly string[]): readonly string[] {
    const all = this.all(known);
    return this.#shown === undefined ? all.slice(0, FIRST) : all.filter((path) => this.#shown!.includes(path));
  }

  /** Those that are known, and those that were added. */
  all(known: readonly string[]): string[] {
    return [...known, ...this.added.filter((path) => !known.includes(path))];
  }

  toggle(path: string, known: readonly string[]): void {
    const shown = this.shown(known);
    this.#shown = shown.includes(path) ? shown.filter((each) => each !== path) : [...shown, path];
    this.#keep();
  }

  add(path: string, known: readonly string[]): void {
    const shown = this.shown(known);
    if (!known.includes(path) && !this.added.includes(path)) this.added = [...this.added, path];
    if (!shown.includes(path)) this.#shown = [...shown, path];
    this.#keep();
  }

  remove(path: string): void {
    this.added = this.added.filter((each) => each !== path);
    this.#keep();
  }

  lay(layout: Layout): void {
    this.layout = layout;
    this.#keep();
  }

  #keep(): void {
    remember(KEY, { shown: this.#shown ?? null, added: this.added, layout: this.layout });
  }
}

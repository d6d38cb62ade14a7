// Which lines are drawn over pictures: one choice for all of them.
import { fields } from "../../hub/fields.js";
import { remember, remembered } from "../../hub/remember.js";
import type { PlainFields } from "../../worker/protocol.js";

export const LINES = ["pose", "predicted", "path", "poses", "blocks"] as const;
export type Line = (typeof LINES)[number];

const KEY = "mom-lines";

class Lines {
  #shown: { [line in Line]: boolean } = $state({ pose: true, predicted: true, path: true, poses: true, blocks: true });

  constructor() {
    const kept = fields(remembered(KEY) as PlainFields | null);
    for (const line of LINES) if (kept[line] === false) this.#shown[line] = false;
  }

  shows(line: Line): boolean {
    return this.#shown[line];
  }

  set(line: Line, shown: boolean): void {
    this.#shown[line] = shown;
    remember(KEY, this.#shown);
  }
}

export const lines = new Lines();

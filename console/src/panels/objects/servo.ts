// The agent that sees (lab/servo), which puts one block beside another.
import { number } from "../../hub/fields.js";
import { texts } from "../../texts/index.js";
import type { PlainFields } from "../../worker/protocol.js";

/** What it says of the error, the pictures and the commands, in words. */
export function factsOf(report: PlainFields): string[] {
  const t = texts.objects;
  const [mm, pixels, age, delay, commands] = ["mm", "pixels", "image-age", "command-delay", "commands"].map((key) => number(report, key));
  return [
    mm === undefined ? "" : t.off(mm, pixels ?? 0),
    age === undefined ? "" : t.image(age),
    delay === undefined ? "" : t.delay(delay),
    commands === undefined ? "" : t.sent(commands),
  ].filter(Boolean);
}

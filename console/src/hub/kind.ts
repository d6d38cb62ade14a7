// What a device is, by its card, or else by what it tells of itself and what stands beside it: each kind has its own controls.
import type { PlainFields } from "../worker/protocol.js";
import { type Card, takesVelocities, verbNamed } from "./card.js";
import { fields, number } from "./fields.js";

/** `other`: its card says what it can do, and there are no controls of its own for that. */
export type Kind = "arm" | "wheeled" | "mirrored" | "other";

/** Undefined where nothing says it. `channels` are those that are known. */
export function kindOf(path: string, state: PlainFields, channels: readonly string[], card?: Card): Kind | undefined {
  const place = path.slice(0, path.lastIndexOf("/"));
  // Its mirror stands in its session.
  if (place !== "" && channels.includes(`${place}/simulacrum`)) return "mirrored";
  if (takesVelocities(card)) return "arm";
  const pose = fields(state["pose"]);
  if (!card && ["x", "y", "z"].every((axis) => number(pose, axis) !== undefined)) return "arm";
  const heads = [state, pose].some((of) => number(of, "heading") !== undefined && number(of, "z") === undefined);
  // A fleet's robots are told of in one channel above their sessions, and the number of each names its session.
  const unit = /^(.+)\/\d+$/.exec(place)?.[1];
  if ((heads && (!card || verbNamed(card, "goto"))) || (unit !== undefined && channels.includes(`${unit}/status`))) return "wheeled";
  return card && "other";
}

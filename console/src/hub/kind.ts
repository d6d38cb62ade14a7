// What a device is, by what it tells of itself and by what stands beside it: each kind has its own controls.
import type { PlainFields } from "../worker/protocol.js";
import { fields, number } from "./fields.js";

export type Kind = "arm" | "mount" | "wheeled" | "mirrored";

/** Undefined where nothing says it. `channels` are those that are known. */
export function kindOf(path: string, state: PlainFields, channels: readonly string[]): Kind | undefined {
  const place = path.slice(0, path.lastIndexOf("/"));
  // Its mirror stands in its session.
  if (place !== "" && channels.includes(`${place}/simulacrum`)) return "mirrored";
  if (number(state, "pan") !== undefined) return "mount";
  const pose = fields(state["pose"]);
  if (["x", "y", "z"].every((axis) => number(pose, axis) !== undefined)) return "arm";
  const wheeled = [state, pose].some((of) => number(of, "heading") !== undefined && number(of, "z") === undefined);
  // A fleet's robots are told of in one channel above their sessions, and the number of each names its session.
  const unit = /^(.+)\/\d+$/.exec(place)?.[1];
  return wheeled || (unit !== undefined && channels.includes(`${unit}/status`)) ? "wheeled" : undefined;
}

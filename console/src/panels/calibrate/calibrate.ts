// The agent that calibrates cameras (lab/calibrate): how it is asked, and what it tells.
import { number } from "../../hub/fields.js";
import type { PlainFields } from "../../worker/protocol.js";

/** In so many poses it looks at most, and at least. */
export const [FEWEST, MOST] = [6, 500];

/** For how long it is lent the token, ms: a pose takes a second or two. */
export function timeFor(poses: number): number {
  return Math.max(120_000, poses * 5000);
}

/** A camera as the agent names it: what stands behind the cameras' session. */
export function nameOf(path: string, session = "/camera/"): string {
  return path.startsWith(session) ? path.slice(session.length) : path;
}

/** Which pose it is at, of how many; both are whole and within reason. */
export function poseOf(report: PlainFields): { pose: number; of: number } | undefined {
  const [pose, of] = [number(report, "pose"), number(report, "of")];
  return pose !== undefined && of !== undefined && pose > 0 && of >= pose ? { pose: Math.round(pose), of: Math.round(of) } : undefined;
}

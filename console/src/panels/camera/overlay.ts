// What a message says beside its image, as lines in the room.
import { fields, list, number, text, time } from "../../hub/fields.js";
import type { Block } from "../../hub/cursor.svelte.js";
import type { Pose } from "../../hub/device.svelte.js";
import { type Matrix, type Point, matrixOf } from "../../room/matrix.js";
import type { Plain, PlainFields } from "../../worker/protocol.js";

/** What is said beside an image. */
export interface Beside {
  /** Pixels, to which the matrix leads. */
  width: number;
  height: number;
  view: string | undefined;
  matrix: Matrix | undefined;
  /** The root of the mean squared error of a measured matrix, pixels. */
  rms: number | undefined;
  calibratedBy: string | undefined;
  taken: number | undefined;
  poseTime: number | undefined;
  pose: Pose | undefined;
  aim: { pan: number; tilt: number } | undefined;
  /** Lines by name. */
  posed: readonly Point[] | undefined;
  predicted: readonly Point[] | undefined;
  path: readonly Point[] | undefined;
  blocks: readonly { name: string; points: readonly Point[] }[];
}

const MOST_BLOCKS = 200;

function pointOf(value: Plain): Point | undefined {
  if (!Array.isArray(value) || value.length < 3) return undefined;
  const [x, y, z] = value.map((member) => (typeof member === "number" || typeof member === "bigint" ? Number(member) : Number.NaN));
  return Number.isFinite(x) && Number.isFinite(y) && Number.isFinite(z) ? [x!, y!, z!] : undefined;
}

function size(value: number | undefined, otherwise: number): number {
  return value !== undefined && Number.isFinite(value) && value > 0 ? value : otherwise;
}

/** Reads it; `width` and `height` are those of the decoded image. */
export function besideOf(content: PlainFields, width: number, height: number): Beside {
  const calibrated = fields(content["calibrated"]);
  const pose = fields(content["pose"]);
  const numbers = ["x", "y", "z", "spin", "tilt"].map((axis) => number(pose, axis));
  const aim = fields(content["aim"]);
  const [pan, tilt] = [number(aim, "pan"), number(aim, "tilt")];
  const beside: Beside = {
    width: size(number(content, "width"), width),
    height: size(number(content, "height"), height),
    view: text(content, "view"),
    matrix: matrixOf(content["matrix"]),
    rms: number(calibrated, "rms"),
    calibratedBy: text(calibrated, "by"),
    taken: time(content, "taken"),
    poseTime: time(content, "pose-time"),
    pose: numbers.every((value) => value !== undefined && Number.isFinite(value)) ? (numbers as Pose) : undefined,
    aim: pan !== undefined && tilt !== undefined ? { pan, tilt } : undefined,
    posed: undefined,
    predicted: undefined,
    path: undefined,
    blocks: [],
  };
  const blocks: { name: string; points: Point[] }[] = [];
  for (const overlay of list(content, "overlays")) {
    const of = fields(overlay);
    const name = text(of, "name") ?? "";
    const points = list(of, "points").map(pointOf).filter((point) => point !== undefined);
    if (name === "pose") beside.posed = points;
    else if (name === "predicted") beside.predicted = points;
    else if (name === "path") beside.path = points;
    else if (/^block\b/.test(name) && blocks.length < MOST_BLOCKS) blocks.push({ name: name.slice(6), points });
  }
  beside.blocks = blocks;
  return beside;
}

/** A block from the line over its edges. */
export function blockOf({ name, points }: { name: string; points: readonly Point[] }): Block | undefined {
  const corners = [...new Map(points.map((point) => [point.join(), point])).values()];
  if (corners.length < 2) return undefined;
  const mean = (at: 0 | 1 | 2): number => corners.reduce((sum, corner) => sum + corner[at], 0) / corners.length;
  const [one, two] = [points[0]!, points[1]!];
  const turn = (Math.atan2(two[1] - one[1], two[0] - one[0]) * 180) / Math.PI;
  // A quarter turn brings another face to the jaws.
  const yaw = turn - 90 * Math.round(turn / 90);
  return { name, middle: [mean(0), mean(1), mean(2)], top: Math.max(...corners.map((corner) => corner[2])), yaw };
}

/** Where a block's name stands: above its highest corner. */
export function topOf(points: readonly Point[]): Point | undefined {
  if (!points.length) return undefined;
  const high = points.filter(({ 2: z }) => z >= Math.max(...points.map((point) => point[2])) - 1);
  return [0, 1, 2].map((at) => high.reduce((sum, point) => sum + point[at]!, 0) / high.length) as unknown as Point;
}

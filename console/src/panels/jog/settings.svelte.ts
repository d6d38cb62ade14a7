// How the user drives: kept in this browser. What makes driving less safe is not kept.
import { STANDARD, type Mapping, mappingOf } from "./pad.js";

const PLACE = "mom-jog";

interface Kept {
  speed: number;
  turn: number;
  limit: number;
  frame: "table" | "camera";
  zone: number;
  scale: number;
  mapping: Mapping;
}

const DEFAULTS: Kept = { speed: 50, turn: 30, limit: 1000, frame: "table", zone: 0.15, scale: 1, mapping: STANDARD };

function kept(): Partial<Kept> {
  try {
    const found: unknown = JSON.parse(localStorage.getItem(PLACE) ?? "{}");
    return typeof found === "object" && found !== null ? found : {};
  } catch {
    return {};
  }
}

function within(value: unknown, least: number, most: number, otherwise: number): number {
  return typeof value === "number" && value >= least && value <= most ? value : otherwise;
}

export class Settings {
  /** mm/s and degrees/s. */
  speed = $state(DEFAULTS.speed);
  turn = $state(DEFAULTS.turn);
  /** ms: with an older picture nobody drives. */
  limit = $state(DEFAULTS.limit);
  frame = $state<"table" | "camera">("table");
  zone = $state(DEFAULTS.zone);
  scale = $state(DEFAULTS.scale);
  mapping = $state.raw<Mapping>(STANDARD);
  /** Driving by keys is on. */
  armed = $state(false);
  /** The person sees the robot itself, so that pictures may be old. */
  unseen = $state(false);

  constructor() {
    const found = kept();
    this.speed = within(found.speed, 1, 150, DEFAULTS.speed);
    this.turn = within(found.turn, 1, 90, DEFAULTS.turn);
    this.limit = within(found.limit, 50, 5000, DEFAULTS.limit);
    this.zone = within(found.zone, 0, 0.9, DEFAULTS.zone);
    this.scale = within(found.scale, 0.05, 1, DEFAULTS.scale);
    this.frame = found.frame === "camera" ? "camera" : "table";
    this.mapping = mappingOf(found.mapping) ?? STANDARD;
  }

  keep(): void {
    const { speed, turn, limit, frame, zone, scale, mapping } = this;
    try {
      localStorage.setItem(PLACE, JSON.stringify({ speed, turn, limit, frame, zone, scale, mapping } satisfies Kept));
    } catch {
      // For this page only.
    }
  }
}

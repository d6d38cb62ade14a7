// Draws the map: a grid in metres, trails, goals, and each robot as an arrow. What differs by colour differs in shape as well.
import { clip } from "./near.js";
import type { Robot } from "./robots.js";
import type { Trails } from "./trails.js";
import { type Viewport, lengthWords, stepOf, toFloor, toScreen } from "./viewport.js";

/** Colours by what they are for. */
export type Inks = { [name in (typeof INKS)[number]]: string };
export const INKS = ["ground", "line", "muted", "text", "mine", "others", "free", "danger"] as const;

export interface Scene {
  robots: readonly Robot[];
  selected: ReadonlySet<number>;
  me: string | undefined;
  trails: Trails;
  /** From when on trails are drawn, ms since 1970. */
  from: number;
  /** Whose trails are drawn. */
  trailed: (unit: number) => boolean;
  goals: ReadonlyMap<number, readonly [x: number, y: number]>;
  /** px of the floor: an area that is being selected. */
  area: readonly [number, number, number, number] | null;
}

/** Above so many robots in view arrows are small and lines are thin, which is much less work, and only those that are selected have numbers. */
const MANY = 80;
/** Robots that are drawn by one path: a longer one is more work than several. */
const PORTION = 32;
const FONT = "system-ui, sans-serif";

function grid(c: CanvasRenderingContext2D, view: Viewport, inks: Inks): void {
  const step = stepOf(view.scale, 64);
  const [left, top] = toFloor(view, [0, 0]);
  const [right, bottom] = toFloor(view, [view.width, view.height]);
  c.lineWidth = 1;
  c.strokeStyle = inks.line;
  c.fillStyle = inks.muted;
  c.font = `11px ${FONT}`;
  const label = (mm: number): string => String(Number((mm / 1000).toFixed(3)));
  const lines = (from: number, to: number, draw: (at: number) => void): void => {
    for (let at = Math.ceil(from / step) * step; at <= to; at += step) draw(at);
  };
  c.beginPath();
  lines(left, right, (x) => {
    const at = Math.round(toScreen(view, [x, 0])[0]) + 0.5;
    c.moveTo(at, 0);
    c.lineTo(at, view.height);
  });
  lines(bottom, top, (y) => {
    const at = Math.round(toScreen(view, [0, y])[1]) + 0.5;
    c.moveTo(0, at);
    c.lineTo(view.width, at);
  });
  c.globalAlpha = 0.6;
  c.stroke();
  c.globalAlpha = 1;
  // The axes.
  const [ox, oy] = toScreen(view, [0, 0]).map((at) => Math.round(at) + 0.5) as [number, number];
  c.strokeStyle = inks.muted;
  c.beginPath();
  c.moveTo(ox, 0);
  c.lineTo(ox, view.height);
  c.moveTo(0, oy);
  c.lineTo(view.width, oy);
  c.globalAlpha = 0.7;
  c.stroke();
  c.globalAlpha = 1;
  const written = (text: string, x: number, y: number): void => {
    c.strokeStyle = inks.ground;
    c.lineWidth = 3;
    c.strokeText(text, x, y);
    c.fillText(text, x, y);
  };
  c.textBaseline = "bottom";
  c.textAlign = "center";
  lines(left, right, (x) => {
    const at = toScreen(view, [x, 0])[0];
    if (at > 34 && at < view.width - 130) written(label(x), at, view.height - 4);
  });
  c.textAlign = "left";
  c.textBaseline = "middle";
  lines(bottom, top, (y) => {
    const at = toScreen(view, [0, y])[1];
    if (at > 12 && at < view.height - 30) written(label(y), 5, at);
  });
}

function scaleBar(c: CanvasRenderingContext2D, view: Viewport, inks: Inks): void {
  const step = stepOf(view.scale, 50);
  const long = Math.round(step * view.scale);
  const [x, y] = [view.width - 14 - long + 0.5, view.height - 10.5];
  c.beginPath();
  c.moveTo(x, y - 5);
  c.lineTo(x, y);
  c.lineTo(x + long, y);
  c.lineTo(x + long, y - 5);
  c.lineWidth = 4;
  c.strokeStyle = inks.ground;
  c.stroke();
  c.lineWidth = 1.5;
  c.strokeStyle = inks.text;
  c.stroke();
  c.font = `11px ${FONT}`;
  c.textAlign = "center";
  c.textBaseline = "bottom";
  c.lineWidth = 3;
  c.strokeStyle = inks.ground;
  c.strokeText(lengthWords(step), x + long / 2, y - 3);
  c.fillStyle = inks.text;
  c.fillText(lengthWords(step), x + long / 2, y - 3);
}

export const inkOf = ({ state, owner }: Robot, me: string | undefined): keyof Inks => (state === "lost" ? "danger" : owner === undefined ? "free" : owner === me ? "mine" : "others");

/** Puts together what is drawn alike. */
function grouped<Of>(all: readonly Of[], keyOf: (one: Of) => string): Map<string, Of[]> {
  const groups = new Map<string, Of[]>();
  for (const one of all) {
    const key = keyOf(one);
    const group = groups.get(key);
    if (group) group.push(one);
    else groups.set(key, [one]);
  }
  return groups;
}

/** Older parts are fainter, in so many steps. */
function drawTrails(c: CanvasRenderingContext2D, view: Viewport, scene: Scene, inks: Inks): void {
  const { robots, me, trails, from } = scene;
  const trailed = robots.filter(({ unit }) => scene.trailed(unit));
  const many = trailed.length > MANY;
  const steps = many ? 1 : 4;
  c.lineWidth = many ? 1 : 2;
  c.lineJoin = c.lineCap = "round";
  for (const [ink, group] of grouped(trailed, (robot) => inkOf(robot, me))) {
    c.strokeStyle = inks[ink as keyof Inks];
    const spots = group.map(({ unit, born }) => ({ of: trails.of(unit, from), span: Math.max(1, born - from) }));
    for (let step = 0; step < steps; step += 1) {
      c.beginPath();
      for (const { of, span } of spots) {
        const [begin, end] = [from + (span * step) / steps, from + (span * (step + 1)) / steps];
        for (let at = 1; at < of.length; at += 1) {
          const [x, y, until] = of[at]!;
          if (until < begin || (until >= end && step < steps - 1)) continue;
          c.moveTo(...toScreen(view, [of[at - 1]![0], of[at - 1]![1]]));
          c.lineTo(...toScreen(view, [x, y]));
        }
      }
      c.globalAlpha = 0.25 + (0.55 * (step + 1)) / steps;
      c.stroke();
    }
  }
  c.globalAlpha = 1;
}

type At = readonly [x: number, y: number];

/** An arrow's outline, which points to where the robot looks. */
function arrow(c: CanvasRenderingContext2D, [x, y]: At, heading: number, size: number): void {
  const [cos, sin] = [Math.cos((heading * Math.PI) / 180) * size, Math.sin((heading * Math.PI) / 180) * size];
  ARROW.forEach(([ahead, aside], corner) => {
    const to: [number, number] = [x + ahead * cos - aside * sin, y - ahead * sin - aside * cos];
    if (corner) c.lineTo(...to);
    else c.moveTo(...to);
  });
  c.closePath();
}
const ARROW: readonly At[] = [[1, 0], [-0.75, 0.7], [-0.4, 0], [-0.75, -0.7]];

function drawRobots(c: CanvasRenderingContext2D, robots: readonly Robot[], places: ReadonlyMap<number, At>, size: number, { selected, me }: Scene, inks: Inks): void {
  const many = robots.length > MANY;
  const outline = (all: readonly Robot[], shape: (at: At, robot: Robot) => void, paint: () => void): void => {
    for (let from = 0; from < all.length; from += PORTION) {
      c.beginPath();
      for (const robot of all.slice(from, from + PORTION)) shape(places.get(robot.unit)!, robot);
      paint();
    }
  };
  const arrows = (all: readonly Robot[], paint: () => void): void => outline(all, (at, { heading }) => arrow(c, at, heading ?? 0, size), paint);
  const line = (ink: string, width: number): void => {
    [c.strokeStyle, c.lineWidth] = [ink, width];
    c.stroke();
  };
  c.lineJoin = "round";
  const ring = size + (many ? 3 : 6);
  outline(
    robots.filter(({ unit }) => selected.has(unit)),
    ([x, y]) => {
      c.moveTo(x + ring, y);
      c.arc(x, y, ring, 0, 2 * Math.PI);
    },
    () => {
      if (!many) line(inks.ground, 5);
      line(inks.text, many ? 1 : 2);
    },
  );
  c.fillStyle = inks.ground;
  // Whatever lies beneath them is not seen through them.
  if (!many) arrows(robots, () => (line(inks.ground, 4), c.fill()));
  for (const [key, group] of grouped(robots, (robot) => `${inkOf(robot, me)} ${robot.state}`)) {
    const [ink, state] = key.split(" ") as [keyof Inks, Robot["state"]];
    c.fillStyle = inks[ink];
    arrows(group, () => {
      c.globalAlpha = state === "driving" ? 1 : 0.28;
      if (state !== "lost") c.fill();
      c.globalAlpha = 1;
      c.setLineDash(state === "lost" ? [3, 2] : []);
      line(inks[ink], many ? 1 : 1.75);
      c.setLineDash([]);
    });
  }
  const marked = robots.filter(({ state }) => state === "lost" || state === "stopped" || state === "expired");
  outline(
    marked,
    ([x, y], { state }) => {
      const half = size * 0.6;
      if (state === "lost") {
        c.moveTo(x - half, y - half);
        c.lineTo(x + half, y + half);
        c.moveTo(x + half, y - half);
        c.lineTo(x - half, y + half);
      } else c.rect(x - size - 2.5, y - size - 2.5, 2 * size + 5, 2 * size + 5);
    },
    () => line(inks.danger, many ? 1 : 2),
  );
}

export function draw(c: CanvasRenderingContext2D, view: Viewport, scene: Scene, inks: Inks): void {
  const { robots, selected, goals } = scene;
  c.fillStyle = inks.ground;
  c.fillRect(0, 0, view.width, view.height);
  grid(c, view, inks);
  const seen = clip(robots, view, 60);
  drawTrails(c, view, scene, inks);
  const places = new Map(seen.map((robot) => [robot.unit, toScreen(view, [robot.x!, robot.y!])]));
  for (const [unit, goal] of goals) {
    const at = toScreen(view, goal);
    const from = places.get(unit);
    c.strokeStyle = inks.mine;
    c.lineWidth = 1.5;
    c.setLineDash([4, 4]);
    c.beginPath();
    if (from) {
      c.moveTo(...from);
      c.lineTo(...at);
    }
    c.stroke();
    c.setLineDash([]);
    c.beginPath();
    c.arc(at[0], at[1], 6, 0, 2 * Math.PI);
    c.moveTo(at[0] - 9, at[1]);
    c.lineTo(at[0] + 9, at[1]);
    c.moveTo(at[0], at[1] - 9);
    c.lineTo(at[0], at[1] + 9);
    c.stroke();
  }
  const many = seen.length > MANY;
  const size = many ? 6.5 : 10;
  // Those that are selected lie above the others.
  const order = [...seen].sort((one, other) => Number(selected.has(one.unit)) - Number(selected.has(other.unit)));
  drawRobots(c, order, places, size, scene, inks);
  c.font = `600 11px ${FONT}`;
  c.textAlign = "center";
  c.textBaseline = "top";
  c.lineWidth = 3.5;
  c.strokeStyle = inks.ground;
  c.fillStyle = inks.text;
  for (const robot of order) {
    const isSelected = selected.has(robot.unit);
    if (many && !(isSelected && selected.size <= MANY)) continue;
    const [x, y] = places.get(robot.unit)!;
    const below = y + size + (isSelected ? 8 : 5);
    c.strokeText(String(robot.unit), x, below);
    c.fillText(String(robot.unit), x, below);
  }
  if (scene.area) {
    const [x, y, width, height] = scene.area;
    c.fillStyle = c.strokeStyle = inks.mine;
    c.globalAlpha = 0.12;
    c.fillRect(x, y, width, height);
    c.globalAlpha = 1;
    c.lineWidth = 1.5;
    c.strokeRect(x, y, width, height);
  }
  scaleBar(c, view, inks);
}

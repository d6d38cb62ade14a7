// A camera's matrix: from millimetres in the room to pixels of its image, and back along lines.

/** 3×4, row by row. The third row gives the depth in mm, positive in front of the camera. */
export type Matrix = readonly number[];
export type Point = readonly [x: number, y: number, z: number];
export type Pixel = readonly [u: number, v: number];

/** Nothing nearer to the camera than this is drawn, mm. */
export const NEAR = 10;

/** The matrix in a message, scaled so that the third row gives mm; undefined if it is none. */
export function matrixOf(value: unknown): Matrix | undefined {
  if (!Array.isArray(value) || value.length !== 12) return undefined;
  const numbers = value.map((member) => (typeof member === "number" || typeof member === "bigint" ? Number(member) : Number.NaN));
  const scale = Math.hypot(numbers[8]!, numbers[9]!, numbers[10]!);
  if (!numbers.every(Number.isFinite) || !(scale > 0)) return undefined;
  return scale === 1 ? numbers : numbers.map((number) => number / scale);
}

/** The image of a point before it is divided by its depth. */
function image(matrix: Matrix, [x, y, z]: Point, one: number): [number, number, number] {
  const row = (at: number): number => matrix[at]! * x + matrix[at + 1]! * y + matrix[at + 2]! * z + matrix[at + 3]! * one;
  return [row(0), row(4), row(8)];
}

/** How far in front of the camera a point is, mm. */
export function depth(matrix: Matrix, point: Point): number {
  return image(matrix, point, 1)[2];
}

/** Its pixel, which may lie outside the image; undefined if it is behind the camera or nearly in it. */
export function project(matrix: Matrix, point: Point): Pixel | undefined {
  const [u, v, w] = image(matrix, point, 1);
  return w >= NEAR ? [u / w, v / w] : undefined;
}

/** How a point's pixel moves, in pixels for each mm along a direction. */
export function flow(matrix: Matrix, point: Point, way: Point): Pixel {
  const [u, v, w] = image(matrix, point, 1);
  const [du, dv, dw] = image(matrix, way, 0);
  return [(du * w - u * dw) / (w * w), (dv * w - v * dw) / (w * w)];
}

/** How many pixels a mm across the line of sight has at a point: the most that any direction has, nearly. */
export function scaleAt(matrix: Matrix, point: Point): number {
  const flows = ([[1, 0, 0], [0, 1, 0], [0, 0, 1]] as const).map((way) => flow(matrix, point, way));
  // The larger singular value of the 2×3 matrix of the three flows.
  const [a, b, c] = flows.reduce(([a, b, c], [u, v]) => [a + u * u, b + u * v, c + v * v] as const, [0, 0, 0] as readonly [number, number, number]);
  const middle = (a + c) / 2;
  return Math.sqrt(middle + Math.hypot((a - c) / 2, b));
}

/** The part of a line before the camera, as two pixels. */
export function line(matrix: Matrix, from: Point, to: Point): [Pixel, Pixel] | undefined {
  let [a, b] = [image(matrix, from, 1), image(matrix, to, 1)];
  if (a[2] < NEAR && b[2] < NEAR) return undefined;
  if (a[2] < NEAR) a = crossing(a, b);
  else if (b[2] < NEAR) b = crossing(b, a);
  return [[a[0] / a[2], a[1] / a[2]], [b[0] / b[2], b[1] / b[2]]];
}

type Image = [number, number, number];

/** Where the line from a point that is too near to one that is not becomes visible. */
function crossing(near: Image, far: Image): Image {
  const part = (NEAR - near[2]) / (far[2] - near[2]);
  return [near[0] + part * (far[0] - near[0]), near[1] + part * (far[1] - near[1]), NEAR];
}

/** So far outside the image lines are still drawn, in widths of it: beyond that some browsers draw them wrongly. */
const OUTSIDE = 20;

/** The data of an SVG path through these points, as far as it is before the camera. */
export function pathData(matrix: Matrix, points: readonly Point[], size: number): string {
  const parts: string[] = [];
  let pen: Pixel | undefined;
  const most = OUTSIDE * size;
  const put = ([u, v]: Pixel): string => `${u.toFixed(1)} ${v.toFixed(1)}`;
  const inside = ([u, v]: Pixel): boolean => Math.abs(u) < most && Math.abs(v) < most;
  for (let at = 1; at < points.length; at += 1) {
    const seen = line(matrix, points[at - 1]!, points[at]!);
    if (!seen || !seen.every(inside)) {
      pen = undefined;
      continue;
    }
    const [from, to] = seen;
    if (pen?.[0] !== from[0] || pen[1] !== from[1]) parts.push(`M${put(from)}`);
    parts.push(`L${put(to)}`);
    pen = to;
  }
  return parts.join("");
}

/**
 * How far along a line through `point` the place is that is seen nearest to `pixel`, in mm: the pixel is projected on the
 * line's image, whose perspective is then solved for the distance. Undefined where the line is seen end-on.
 */
export function along(matrix: Matrix, point: Point, way: Point, [u, v]: Pixel): number | undefined {
  const [pu, pv, pw] = image(matrix, point, 1);
  const dw = image(matrix, way, 0)[2];
  if (pw < NEAR) return undefined;
  const [fu, fv] = flow(matrix, point, way);
  const speed = Math.hypot(fu, fv);
  if (speed < 1e-9) return undefined;
  // Pixels along the image line; it ends where the line vanishes, or where it passes the camera.
  const wanted = ((u - pu / pw) * fu + (v - pv / pw) * fv) / speed;
  const left = speed * pw - wanted * dw;
  const distance = left === 0 ? Number.POSITIVE_INFINITY : (wanted * pw) / left;
  // Beyond the vanishing point the other half of the line would be seen, behind the camera.
  if (!(left > 0)) return Math.sign(wanted) * FAR;
  // Nor does it come nearer to the camera than what is drawn.
  const nearest = dw === 0 ? Number.POSITIVE_INFINITY : (NEAR - pw) / dw;
  const limited = dw < 0 ? Math.min(distance, nearest) : dw > 0 ? Math.max(distance, nearest) : distance;
  return Math.max(-FAR, Math.min(FAR, limited));
}

/** As far as anything goes, mm. */
export const FAR = 1e6;

/** The place at a height that is seen at this pixel; undefined if the pixel shows no such place before the camera. */
export function onPlane(matrix: Matrix, height: number, [u, v]: Pixel): Point | undefined {
  const [a, b, c] = [0, 4, 8].map((row) => [matrix[row]!, matrix[row + 1]!, matrix[row + 2]! * height + matrix[row + 3]!] as const) as [Row, Row, Row];
  // Two linear equations in x and y: (first row - u · third row) = 0, (second row - v · third row) = 0.
  const [p, q] = [[a[0] - u * c[0], a[1] - u * c[1], a[2] - u * c[2]], [b[0] - v * c[0], b[1] - v * c[1], b[2] - v * c[2]]] as [Row, Row];
  const determinant = p[0] * q[1] - p[1] * q[0];
  if (Math.abs(determinant) < 1e-12) return undefined;
  const x = (p[1] * q[2] - p[2] * q[1]) / determinant;
  const y = (p[2] * q[0] - p[0] * q[2]) / determinant;
  return depth(matrix, [x, y, height]) >= NEAR ? [x, y, height] : undefined;
}

type Row = readonly [number, number, number];

/**
 * Which place of a curve is seen nearest to a pixel, in `low` to `high`, as one would find it who goes along the curve from
 * `from`: of two places that are seen as near as each other it is the one that is less far away.
 */
export function onCurve(seen: (at: number) => Pixel | undefined, [u, v]: Pixel, from: number, low: number, high: number, steps = 180): number {
  const cost = (at: number): number => {
    const pixel = seen(at);
    if (!pixel) return Number.POSITIVE_INFINITY;
    // The way counts for so little that it decides between equals only.
    return Math.hypot(pixel[0] - u, pixel[1] - v) + 1e-3 * Math.abs(at - from);
  };
  const step = (high - low) / steps;
  let [best, least] = [from, cost(from)];
  for (let index = 0; index <= steps; index += 1) {
    const at = low + index * step;
    const costs = cost(at);
    if (costs < least) [best, least] = [at, costs];
  }
  // Golden section between the neighbours.
  const golden = (Math.sqrt(5) - 1) / 2;
  let [left, right] = [Math.max(low, best - step), Math.min(high, best + step)];
  while (right - left > 1e-4) {
    const [one, two] = [right - golden * (right - left), left + golden * (right - left)];
    if (cost(one) < cost(two)) right = two;
    else left = one;
  }
  const found = (left + right) / 2;
  return cost(found) <= least ? found : best;
}

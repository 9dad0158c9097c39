// Regions drawn by hand: shapes in the coordinates of a cloud, mm, and which points they enclose (docs/use/formats.md).

/**
 * @typedef {{shape: "box", min: number[], max: number[]}} Box
 * @typedef {{shape: "slab", origin: number[], direction: number[], from: number, to: number}} Slab
 * @typedef {{shape: "brush", centres: number[][], radius: number}} Brush
 * @typedef {{shape: "outline", eye: number[], right: number[], down: number[], corners: number[][]}} Outline
 * @typedef {Box | Slab | Brush | Outline} Shape
 * @typedef {{keep: Shape[], cut: Shape[]}} Region
 */

/** Something is long whose variance along it is this many times that across it. */
const LONG = 3;

/** @param {number[]} a @param {number[]} b */
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
/** @param {number[]} a @param {number[]} b */
const minus = (a, b) => [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
/** @param {number[]} a @param {number[]} b */
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];

/**
 * A function that says whether a point is inside; the same arithmetic as that of the program.
 * @param {Shape} shape
 * @returns {(p: number[]) => boolean}
 */
function inside(shape) {
  switch (shape.shape) {
    case "box": return (p) => [0, 1, 2].every((k) => shape.min[k] <= p[k] && p[k] <= shape.max[k]);
    case "slab": return (p) => {
      const height = dot(minus(p, shape.origin), shape.direction);
      return shape.from <= height && height <= shape.to;
    };
    case "brush": return (p) => shape.centres.some((centre) => {
      const d = minus(p, centre);
      return dot(d, d) <= shape.radius * shape.radius;
    });
    case "outline": {
      const forward = cross(shape.right, shape.down);
      return (p) => {
        const d = minus(p, shape.eye);
        const z = dot(d, forward);
        return z > 0 && encloses(shape.corners, dot(d, shape.right) / z, dot(d, shape.down) / z);
      };
    }
  }
}

/** By the even-odd rule. @param {number[][]} corners @param {number} x @param {number} y */
function encloses(corners, x, y) {
  let is = false;
  corners.forEach(([ax, ay], k) => {
    const [bx, by] = corners.at(k - 1) ?? [ax, ay];
    if (ay > y !== by > y && x < ax + ((bx - ax) * (y - ay)) / (by - ay)) is = !is;
  });
  return is;
}

/**
 * Whether each point is in the region.
 * @param {Region} region
 * @param {Float64Array} rows
 */
export function within({ keep, cut }, rows) {
  const [keeps, cuts] = [keep.map(inside), cut.map(inside)];
  const out = new Uint8Array(rows.length / 3);
  for (let k = 0; k < out.length; k++) {
    const p = [rows[3 * k], rows[3 * k + 1], rows[3 * k + 2]];
    out[k] = (keeps.length === 0 || keeps.some((is) => is(p))) && !cuts.some((is) => is(p)) ? 1 : 0;
  }
  return out;
}

/** The box around those points that a shape encloses; `null` around none. @param {Shape} shape @param {Float64Array} rows @returns {Box | null} */
export function boxAround(shape, rows) {
  const is = within({ keep: [shape], cut: [] }, rows);
  const min = [Infinity, Infinity, Infinity];
  const max = [-Infinity, -Infinity, -Infinity];
  for (let k = 0; k < rows.length; k++) {
    if (!is[Math.floor(k / 3)]) continue;
    min[k % 3] = Math.min(min[k % 3], rows[k]);
    max[k % 3] = Math.max(max[k % 3], rows[k]);
  }
  return min.every((low, k) => low < max[k]) ? { shape: "box", min, max } : null;
}

/** The middle of the points, the direction of their largest extent, and whether that is much larger than the others. @param {ArrayLike<number>} rows */
export function longAxis(rows) {
  const n = rows.length / 3;
  const origin = [0, 0, 0];
  for (let k = 0; k < rows.length; k++) origin[k % 3] += rows[k] / n;
  const c = [0, 0, 0, 0, 0, 0, 0, 0, 0];
  for (let k = 0; k < rows.length; k += 3) {
    const d = [rows[k] - origin[0], rows[k + 1] - origin[1], rows[k + 2] - origin[2]];
    for (let i = 0; i < 9; i++) c[i] += d[Math.floor(i / 3)] * d[i % 3];
  }
  // By powers of the covariance: a bone's first axis is far longer than its second.
  let direction = [0.48, 0.6, 0.64];
  for (let step = 0; step < 200; step++) {
    const next = [0, 3, 6].map((row) => dot([c[row], c[row + 1], c[row + 2]], direction));
    const length = Math.hypot(...next);
    if (length === 0) break;
    direction = next.map((x) => x / length);
  }
  const along = [0, 3, 6].map((row) => dot([c[row], c[row + 1], c[row + 2]], direction)).reduce((sum, x, k) => sum + x * direction[k], 0);
  return { origin, direction, isLong: along > LONG * (c[0] + c[4] + c[8] - along) };
}

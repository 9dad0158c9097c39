// What is picked: points and planes as values, with what was before; and the rulers on them. Knows no page.

import { cross, dot, minus, norm, plus, unit } from "./surface.js";

/** @typedef {import("./surface.js").Vector} Vector */
/** @typedef {import("./surface.js").Surface} Surface */
/** @typedef {{name: string, position: Vector}} Pick mm, in the coordinates of what it was picked on */
/** @typedef {{name: string, origin: Vector, rotation: number[]}} Plane its own z axis is its normal; a quaternion x, y, z, w */
/** @typedef {"landmarks" | "assessment" | "tip" | "bone" | "scan"} Group */
/**
 * All that is picked. It is never changed, only replaced.
 * @typedef {{landmarks: Pick[], assessment: Pick[], tip: Pick[], bone: Pick[], scan: Pick[], planes: Plane[]}} Picked
 */

/** @type {Picked} */
export const NOTHING = { landmarks: [], assessment: [], tip: [], bone: [], scan: [], planes: [] };
/** Steepest angle of a plane, degrees: beyond, it no longer cuts across the bone. */
export const MAX_DEG = 70;
/** Number of points that a registration needs. */
export const N_NEEDED = 3;
const MAX_STEPS = 500;

/** What is picked now, and what was before. */
export class History {
  constructor() {
    /** @type {Picked} */
    this.now = NOTHING;
    /** @type {Picked[]} */
    this.before = [];
    /** @type {Picked[]} */
    this.after = [];
  }

  /** Whether anything was picked or changed by hand. */
  get isEdited() { return this.before.length > 0 || this.after.length > 0; }

  /** Replaces all without a way back: nothing was picked by hand. @param {Picked} picked */
  reset(picked) {
    this.now = picked;
    this.before = [];
    this.after = [];
  }

  /** @param {Picked} picked */
  set(picked) { this.settle(this.now, picked); }

  /** Ends a drag, whose steps were not kept, that began at `from`. @param {Picked} from @param {Picked} picked */
  settle(from, picked) {
    if (JSON.stringify(from) === JSON.stringify(picked)) {
      this.now = from;
      return;
    }
    this.before.push(from);
    if (this.before.length > MAX_STEPS) this.before.shift();
    this.after = [];
    this.now = picked;
  }

  undo() {
    const last = this.before.pop();
    if (!last) return;
    this.after.push(this.now);
    this.now = last;
  }

  redo() {
    const next = this.after.pop();
    if (!next) return;
    this.before.push(this.now);
    this.now = next;
  }
}

/** The next free name: P1, P2 .. @param {{name: string}[]} all @param {string} letter */
export function nextName(all, letter) {
  for (let n = 1; ; n++) if (!all.some(({ name }) => name === `${letter}${n}`)) return `${letter}${n}`;
}

/**
 * The bone's own directions, and the words for them.
 * @typedef {object} Bearings
 * @property {Vector | null} tip of the malleolus
 * @property {Vector} along the bone, away from the malleolus where that is known
 * @property {[Vector, Vector]} across the bone, perpendicular to each other
 * @property {[string, string]} names of the latter
 * @property {string} says what they were taken from
 */

/**
 * Directions from the plan's anatomy, else from its axes, else from the shape of the bone; the tip as it was picked, else the plan's.
 * @param {{malleolus_tip?: Vector, proximal?: Vector, lateral?: Vector, posterior?: Vector} | null} anatomy
 * @param {number[] | null} axes columns x, y, z
 * @param {Surface} surface
 * @param {Vector | null} picked the tip
 * @returns {Bearings}
 */
export function bearings(anatomy, axes, surface, picked) {
  const tip = picked ?? anatomy?.malleolus_tip ?? null;
  const { centre, along: longest } = surface.longAxis();
  let [along, first, says] = [longest, /** @type {Vector | null} */ (null), "the long axis of the surface"];
  /** @type {[string, string]} */
  let names = ["first", "second"];
  if (anatomy?.proximal) {
    [along, first, says] = [unit(anatomy.proximal), anatomy.lateral ?? null, "the plan's proximal direction"];
    if (anatomy.lateral) names = ["lateral", "posterior"];
  } else if (axes) {
    [along, first, says] = [unit(axes.slice(6, 9)), axes.slice(0, 3), "the z axis of the plan's axes"];
    names = ["x axis", "y axis"];
  }
  // Away from the malleolus.
  if (!anatomy?.proximal && tip && dot(minus(centre, tip), along) < 0) along = along.map((c) => -c);
  first ??= Math.abs(along[0]) < 0.8 ? [1, 0, 0] : [0, 1, 0];
  const e1 = unit(plus(first, along, -dot(first, along)));
  let e2 = cross(along, e1);
  if (anatomy?.posterior && dot(e2, anatomy.posterior) < 0) e2 = e2.map((c) => -c);
  if (!anatomy?.proximal && axes && dot(e2, axes.slice(3, 6)) < 0) e2 = e2.map((c) => -c);
  if (!anatomy?.proximal && !axes) {
    // Named after the axes of the CT that they are nearest to.
    const nearest = (/** @type {Vector} */ e) => [0, 1, 2].reduce((a, b) => (Math.abs(e[b]) > Math.abs(e[a]) ? b : a));
    if (e2[nearest(e2)] < 0) e2 = e2.map((c) => -c);
    names = [`to ${"LPS"[nearest(e1)]}`, `to ${"LPS"[nearest(e2)]}`];
  }
  return { tip, along, across: [e1, e2], names, says };
}

/**
 * How high a point is along the bone: above the tip of the malleolus, else in the coordinates themselves; mm.
 * @param {Bearings} of @param {Vector} point
 */
export const height = ({ tip, along }, point) => dot(tip ? minus(point, tip) : point, along);

/**
 * The sides between points, and how far apart their ends are along the bone; mm.
 * @param {Pick[]} points
 * @param {Vector} along
 * @returns {{from: Pick, to: Pick, mm: number, along: number}[]}
 */
export function sides(points, along) {
  return points.flatMap((to, k) =>
    points.slice(0, k).map((from) => {
      const side = minus(to.position, from.position);
      return { from, to, mm: norm(side), along: dot(side, along) };
    }),
  );
}

/** v turned by a quaternion. @param {number[]} q x, y, z, w @param {Vector} v @returns {Vector} */
export function turn([x, y, z, w], v) {
  const t = cross([x, y, z], v).map((c) => 2 * c);
  return plus(plus(v, t, w), cross([x, y, z], t));
}

/** The product of two quaternions: b, then a. @param {number[]} a @param {number[]} b */
export function product([ax, ay, az, aw], [bx, by, bz, bw]) {
  return [
    aw * bx + ax * bw + ay * bz - az * by,
    aw * by - ax * bz + ay * bw + az * bx,
    aw * bz + ax * by - ay * bx + az * bw,
    aw * bw - ax * bx - ay * by - az * bz,
  ];
}

/** The least rotation that takes one unit vector to another. @param {Vector} from @param {Vector} to */
export function least(from, to) {
  const w = 1 + dot(from, to);
  // Opposite: half a turn about anything across.
  const q = w < 1e-9 ? [...unit(cross(from, Math.abs(from[0]) < 0.8 ? [1, 0, 0] : [0, 1, 0])), 0] : [...cross(from, to), w];
  const length = Math.hypot(...q);
  return q.map((c) => c / length);
}

/** @param {Plane} plane @returns {Vector} */
export const normalOf = ({ rotation }) => turn(rotation, [0, 0, 1]);

/**
 * A plane's place on the bone.
 * @typedef {object} Placing
 * @property {number} mm height of the middle of the cut along the bone, as `height` measures it
 * @property {[number, number]} deg the angles by which its normal leans from along the bone to the directions across
 * @property {Vector} middle of the cut, else the plane's origin
 * @property {boolean} cuts whether it meets the bone
 */

/** @param {Plane} plane @param {Bearings} of @param {Surface} surface @returns {Placing} */
export function placing(plane, of, surface) {
  const normal = normalOf(plane);
  const cut = surface.section(plane.origin, normal);
  const middle = cut?.middle ?? plane.origin;
  // A normal may point either way along the bone.
  const rise = dot(normal, of.along);
  const sign = rise < 0 ? -1 : 1;
  const lean = (/** @type {0 | 1} */ k) => (Math.atan2(sign * dot(normal, of.across[k]), Math.abs(rise)) * 180) / Math.PI;
  return { mm: height(of, middle), deg: [lean(0), lean(1)], middle, cuts: cut !== null };
}

/**
 * The plane with another place on the bone: moved along the bone, and turned about the middle of its cut.
 * @param {Plane} plane
 * @param {{mm?: number, deg?: [number, number]}} to
 * @param {Bearings} of
 * @param {Surface} surface
 * @returns {Plane}
 */
export function placed(plane, to, of, surface) {
  let { origin, rotation } = plane;
  const before = placing(plane, of, surface);
  if (to.deg) {
    const slopes = to.deg.map((deg) => Math.tan((Math.min(Math.max(deg, -MAX_DEG), MAX_DEG) * Math.PI) / 180));
    const sign = dot(normalOf(plane), of.along) < 0 ? -1 : 1;
    const normal = unit(plus(plus(of.along, of.across[0], slopes[0]), of.across[1], slopes[1]));
    const by = least(normalOf(plane), normal.map((c) => sign * c));
    rotation = product(by, rotation);
    origin = plus(before.middle, turn(by, minus(origin, before.middle)));
  }
  if (to.mm !== undefined) {
    // The bone is bent: the middle of the next cut is aimed at until it is met.
    for (let n = 0; n < 8; n++) {
      const off = to.mm - placing({ ...plane, origin, rotation }, of, surface).mm;
      if (Math.abs(off) < 1e-9) break;
      origin = plus(origin, of.along, off);
    }
  }
  return { ...plane, origin, rotation };
}

/** A new plane straight across the bone. @param {string} name @param {number} mm @param {Bearings} of @param {Surface} surface @returns {Plane} */
export function planeAcross(name, mm, of, surface) {
  const { centre } = surface.longAxis();
  const start = plus(centre, of.along, mm - height(of, centre));
  const origin = surface.section(start, of.along)?.middle ?? start;
  return { name, origin, rotation: least([0, 0, 1], of.along) };
}

/** The rows of the 4 x 4 matrix of a motion. @param {Vector} origin @param {number[]} rotation */
export function matrix(origin, rotation) {
  const [x, y, z] = [turn(rotation, [1, 0, 0]), turn(rotation, [0, 1, 0]), turn(rotation, [0, 0, 1])];
  return [...[0, 1, 2].map((k) => [x[k], y[k], z[k], origin[k]]), [0, 0, 0, 1]];
}

/** Whether two plans have the same points and planes, but for the digits that writing and reading round. @param {Picked} a @param {Picked} b */
export function isSamePlan(a, b) {
  const rounded = (/** @type {Picked} */ { landmarks, assessment, planes }) => JSON.stringify(
    [landmarks, assessment, planes.map(({ name, origin, rotation }) => [name, matrix(origin, rotation)])],
    (_, value) => (typeof value === "number" ? Number(value.toFixed(6)) : value),
  );
  return rounded(a) === rounded(b);
}

/**
 * The plan as the file that `plan.file` reads.
 * @param {Picked} picked
 * @param {{axes: {centre: Vector, columns: number[]} | null, phantomMarker: number[] | null, cameraMarker: number[] | null}} seen what of the shown
 *   plan is not picked, as it was sent
 * @param {Vector | null} along where a tip was picked and no anatomy is known
 * @param {Surface | null} surface that it was picked on, to which the plan is bound
 */
export function planJson(picked, seen, along, surface) {
  const points = (/** @type {Pick[]} */ all) => Object.fromEntries(all.map(({ name, position }) => [name, position]));
  const pose = (/** @type {number[]} */ p) => matrix(p.slice(0, 3), p.slice(3, 7));
  /** @type {Record<string, any>} */
  const plan = {
    units: "mm",
    landmarks: points(picked.landmarks),
    assessment: points(picked.assessment),
    planes: picked.planes.map(({ name, origin, rotation }) => ({ name, matrix: matrix(origin, rotation) })),
  };
  if (surface) plan.surface = { points: surface.fingerprint() };
  if (picked.tip.length > 0) plan.malleolus_tip = picked.tip[0].position;
  if (picked.tip.length > 0 && along) plan.proximal = along;
  if (seen.axes) {
    const { centre, columns } = seen.axes;
    plan.pca_axes_columns_xyz = [0, 1, 2].map((row) => [columns[row], columns[3 + row], columns[6 + row]]);
    plan.pca_axes_centre = centre;
  }
  if (seen.phantomMarker) plan.phantom_marker_in_phantom = pose(seen.phantomMarker);
  if (seen.cameraMarker) plan.camera_marker_nominal_C_T_Mc = pose(seen.cameraMarker);
  return plan;
}

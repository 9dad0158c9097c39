// Exact questions to a triangle mesh: where a ray meets it, what of it is nearest, how a plane cuts it. Double precision, in
// the mesh's own coordinates, mm.

import { longAxis } from "./shapes.js";

/** @typedef {number[]} Vector three numbers */

/** @param {Vector} a @param {Vector} b @returns {Vector} */
export const minus = (a, b) => [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
/** a + s b @param {Vector} a @param {Vector} b @param {number} s @returns {Vector} */
export const plus = (a, b, s = 1) => [a[0] + s * b[0], a[1] + s * b[1], a[2] + s * b[2]];
/** @param {Vector} a @param {Vector} b */
export const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
/** @param {Vector} a @param {Vector} b @returns {Vector} */
export const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
/** @param {Vector} a */
export const norm = (a) => Math.hypot(a[0], a[1], a[2]);
/** @param {Vector} a @returns {Vector} */
export const unit = (a) => a.map((c) => c / norm(a));

/** Triangles of one block: neighbours in a file are mostly neighbours on the surface. */
const BLOCK = 64;
/** Number of points that identify a surface. */
const N_FINGERPRINT = 12;
/** Distance from a plane's origin beyond which a cut belongs to another bone, mm. */
const REACH_MM = 60;

/**
 * A point of the surface.
 * @typedef {object} Hit
 * @property {Vector} point
 * @property {number} face
 * @property {number} distance from where was asked, mm
 */

export class Surface {
  /**
   * @param {Float64Array} vertices
   * @param {Uint32Array} faces
   */
  constructor(vertices, faces) {
    this.vertices = vertices;
    this.faces = faces;
    this.n = faces.length / 3;
    /** @type {{centre: Vector, along: Vector} | null} */
    this.axis = null;
    /** Lowest and highest corner of each block. */
    this.boxes = new Float64Array(6 * Math.ceil(this.n / BLOCK));
    for (let block = 0; 6 * block < this.boxes.length; block++) {
      const box = [Infinity, Infinity, Infinity, -Infinity, -Infinity, -Infinity];
      const end = Math.min(3 * BLOCK * (block + 1), faces.length);
      for (let k = 3 * BLOCK * block; k < end; k++) {
        for (let c = 0; c < 3; c++) {
          const x = vertices[3 * faces[k] + c];
          if (x < box[c]) box[c] = x;
          if (x > box[3 + c]) box[3 + c] = x;
        }
      }
      this.boxes.set(box, 6 * block);
    }
  }

  /**
   * Vertices that identify the surface, as the program chooses them: each the farthest from those before it, the first the farthest
   * from the middle. @returns {Vector[]}
   */
  fingerprint() {
    const n = this.vertices.length / 3;
    const at = (/** @type {number} */ k) => [...this.vertices.subarray(3 * k, 3 * k + 3)];
    let last = [0, 0, 0];
    for (let k = 0; k < n; k++) last = plus(last, at(k), 1 / n);
    const distances = new Float64Array(n).fill(Infinity);
    /** @type {Vector[]} */
    const chosen = [];
    while (chosen.length < N_FINGERPRINT) {
      let farthest = -1;
      for (let k = 0; k < n; k++) {
        const v = minus(at(k), last);
        // The middle is no vertex and only chooses the first.
        distances[k] = chosen.length < 2 ? dot(v, v) : Math.min(distances[k], dot(v, v));
        if (farthest < 0 || distances[k] > distances[farthest]) farthest = k;
      }
      if (farthest < 0 || !(distances[farthest] > 0)) break;
      last = at(farthest);
      chosen.push(last);
    }
    return chosen;
  }

  /** @param {number} face @param {0 | 1 | 2} corner @returns {Vector} */
  corner(face, corner) {
    const at = 3 * this.faces[3 * face + corner];
    return [this.vertices[at], this.vertices[at + 1], this.vertices[at + 2]];
  }

  /** The direction of a face, by the order of its corners. @param {number} face */
  normal(face) {
    const a = this.corner(face, 0);
    return unit(cross(minus(this.corner(face, 1), a), minus(this.corner(face, 2), a)));
  }

  /** @param {number} block @param {(face: number) => void} visit */
  each(block, visit) {
    const end = Math.min((block + 1) * BLOCK, this.n);
    for (let face = block * BLOCK; face < end; face++) visit(face);
  }

  /**
   * The first point of the surface on a ray, from either side of a triangle (Möller and Trumbore 1997).
   * @param {Vector} origin
   * @param {Vector} direction of any length
   * @returns {Hit | null}
   */
  cast(origin, direction) {
    const along = unit(direction);
    const inverse = along.map((c) => 1 / c);
    let best = Infinity;
    let found = -1;
    for (let block = 0; 6 * block < this.boxes.length; block++) {
      const from = this.enters(block, origin, inverse);
      if (from === Infinity || from > best) continue;
      this.each(block, (face) => {
        const a = this.corner(face, 0);
        const u = minus(this.corner(face, 1), a);
        const v = minus(this.corner(face, 2), a);
        const p = cross(along, v);
        const determinant = dot(u, p);
        if (determinant === 0) return;
        const s = minus(origin, a);
        const b = dot(s, p) / determinant;
        const q = cross(s, u);
        const c = dot(along, q) / determinant;
        // A ray through an edge meets at least one of its triangles.
        if (b < -1e-12 || c < -1e-12 || b + c > 1 + 1e-12) return;
        const distance = dot(v, q) / determinant;
        if (distance > 0 && distance < best) {
          best = distance;
          found = face;
        }
      });
    }
    return found < 0 ? null : { point: plus(origin, along, best), face: found, distance: best };
  }

  /** Where a ray enters a block's box; infinite if it does not. @param {number} block @param {Vector} origin @param {Vector} inverse */
  enters(block, origin, inverse) {
    const { boxes } = this;
    let from = 0;
    let to = Infinity;
    for (let c = 0; c < 3; c++) {
      // The side that the ray comes to first. In the plane of a side there is no number, and no comparison keeps the ray out.
      const first = inverse[c] < 0 ? 3 : 0;
      const near = (boxes[6 * block + c + first] - origin[c]) * inverse[c];
      const far = (boxes[6 * block + c + 3 - first] - origin[c]) * inverse[c];
      if (near > from) from = near;
      if (far < to) to = far;
    }
    return from <= to * (1 + 1e-12) + 1e-12 ? from : Infinity;
  }

  /** The nearest point of the surface. @param {Vector} to @returns {Hit | null} */
  closest(to) {
    let best = Infinity;
    /** @type {Hit | null} */
    let found = null;
    for (let block = 0; 6 * block < this.boxes.length; block++) {
      let squared = 0;
      for (let c = 0; c < 3; c++) {
        const out = Math.max(this.boxes[6 * block + c] - to[c], to[c] - this.boxes[6 * block + 3 + c], 0);
        squared += out * out;
      }
      if (squared > best) continue;
      this.each(block, (face) => {
        const point = this.closestOnFace(face, to);
        const off = minus(point, to);
        const here = dot(off, off);
        if (here < best) {
          best = here;
          found = { point, face, distance: Math.sqrt(here) };
        }
      });
    }
    return found;
  }

  /** The point of a triangle nearest to a point (Ericson 2005, section 5.1.5). @param {number} face @param {Vector} to @returns {Vector} */
  closestOnFace(face, to) {
    const [a, b, c] = [this.corner(face, 0), this.corner(face, 1), this.corner(face, 2)];
    const [u, v] = [minus(b, a), minus(c, a)];
    const [p, q, r] = [minus(to, a), minus(to, b), minus(to, c)];
    const [d1, d2, d3, d4, d5, d6] = [dot(u, p), dot(v, p), dot(u, q), dot(v, q), dot(u, r), dot(v, r)];
    if (d1 <= 0 && d2 <= 0) return a;
    if (d3 >= 0 && d4 <= d3) return b;
    const areaC = d1 * d4 - d3 * d2;
    if (areaC <= 0 && d1 >= 0 && d3 <= 0) return plus(a, u, d1 / (d1 - d3));
    if (d6 >= 0 && d5 <= d6) return c;
    const areaB = d5 * d2 - d1 * d6;
    if (areaB <= 0 && d2 >= 0 && d6 <= 0) return plus(a, v, d2 / (d2 - d6));
    const areaA = d3 * d6 - d5 * d4;
    if (areaA <= 0 && d4 - d3 >= 0 && d5 - d6 >= 0) return plus(b, minus(c, b), (d4 - d3) / (d4 - d3 + (d5 - d6)));
    const all = areaA + areaB + areaC;
    // A triangle without area has its corner.
    if (!(Math.abs(all) > 0)) return a;
    return plus(plus(a, u, areaB / all), v, areaC / all);
  }

  /**
   * The outline in which a plane cuts the surface, and its middle; null if it misses. Only what is near the plane's origin counts.
   * @param {Vector} origin
   * @param {Vector} normal of length 1
   * @returns {{middle: Vector, edges: Vector[]} | null} the ends of the edges, two by two
   */
  section(origin, normal) {
    /** @type {Vector[]} */
    const edges = [];
    let length = 0;
    let moment = [0, 0, 0];
    for (let block = 0; 6 * block < this.boxes.length; block++) {
      const low = [0, 1, 2].map((c) => this.boxes[6 * block + c]);
      const high = [0, 1, 2].map((c) => this.boxes[6 * block + 3 + c]);
      const centre = low.map((x, c) => (x + high[c]) / 2);
      const reach = low.reduce((sum, x, c) => sum + (Math.abs(normal[c]) * (high[c] - x)) / 2, 0);
      if (Math.abs(dot(minus(centre, origin), normal)) > reach + 1e-9) continue;
      this.each(block, (face) => {
        const corners = [this.corner(face, 0), this.corner(face, 1), this.corner(face, 2)];
        const heights = corners.map((corner) => dot(minus(corner, origin), normal));
        const ends = [];
        for (let k = 0; k < 3; k++) {
          const [from, to] = [heights[k], heights[(k + 1) % 3]];
          if (from < 0 !== to < 0) ends.push(plus(corners[k], minus(corners[(k + 1) % 3], corners[k]), from / (from - to)));
        }
        if (ends.length !== 2) return;
        const middle = plus(ends[0], minus(ends[1], ends[0]), 0.5);
        if (norm(minus(middle, origin)) > REACH_MM) return;
        const mm = norm(minus(ends[1], ends[0]));
        length += mm;
        moment = plus(moment, middle, mm);
        edges.push(ends[0], ends[1]);
      });
    }
    return length > 0 ? { middle: moment.map((c) => c / length), edges } : null;
  }

  /** The middle of the vertices, and the direction in which they are spread most. @returns {{centre: Vector, along: Vector}} */
  longAxis() {
    if (!this.axis) {
      const { origin, direction } = longAxis(this.vertices);
      this.axis = { centre: origin, along: direction };
    }
    return this.axis;
  }

  /** Lowest and highest height of the surface along a direction. @param {Vector} direction */
  extent(direction) {
    let [low, high] = [Infinity, -Infinity];
    for (let k = 0; k < this.vertices.length; k += 3) {
      const at = direction[0] * this.vertices[k] + direction[1] * this.vertices[k + 1] + direction[2] * this.vertices[k + 2];
      low = Math.min(low, at);
      high = Math.max(high, at);
    }
    return [low, high];
  }
}

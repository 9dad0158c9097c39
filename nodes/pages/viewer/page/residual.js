// Distances of points from a surface, in a thread of its own: positive outside, by the nearest triangle.

/** Points farther away have no residual, mm. */
const FAR_MM = 5;
/** Edge of the cells that triangles are found by, mm. */
const CELL_MM = 2.5;

/** @typedef {{vertices: Float64Array, faces: Uint32Array, cells: Map<number, number[]>, low: number[], n: number[]}} Surface */

/** @type {Surface | null} */
let surface = null;

/**
 * @param {Float64Array} vertices
 * @param {Uint32Array} faces
 * @returns {Surface}
 */
export function prepare(vertices, faces) {
  const low = [Infinity, Infinity, Infinity];
  const high = [-Infinity, -Infinity, -Infinity];
  for (let k = 0; k < vertices.length; k++) {
    low[k % 3] = Math.min(low[k % 3], vertices[k]);
    high[k % 3] = Math.max(high[k % 3], vertices[k]);
  }
  const n = low.map((from, k) => Math.floor((high[k] - from) / CELL_MM) + 1);
  const cells = new Map();
  for (let f = 0; f < faces.length; f += 3) {
    const from = [0, 0, 0];
    const to = [0, 0, 0];
    for (let k = 0; k < 3; k++) {
      const corners = [0, 1, 2].map((c) => vertices[3 * faces[f + c] + k]);
      from[k] = Math.floor((Math.min(...corners) - low[k]) / CELL_MM);
      to[k] = Math.floor((Math.max(...corners) - low[k]) / CELL_MM);
    }
    for (let x = from[0]; x <= to[0]; x++) {
      for (let y = from[1]; y <= to[1]; y++) {
        for (let z = from[2]; z <= to[2]; z++) {
          const key = x + n[0] * (y + n[1] * z);
          const cell = cells.get(key);
          if (cell) cell.push(f);
          else cells.set(key, [f]);
        }
      }
    }
  }
  return { vertices, faces, cells, low, n };
}

/**
 * The signed distance of a point from the surface, mm; NaN if it is far.
 * @param {Surface} of
 * @param {number} x
 * @param {number} y
 * @param {number} z
 */
export function residual(of, x, y, z) {
  const { cells, low, n } = of;
  const at = [x, y, z].map((c, k) => Math.floor((c - low[k]) / CELL_MM));
  let best = FAR_MM * FAR_MM;
  let signed = NaN;
  // Rings of cells, until none that is farther out can be nearer.
  for (let ring = 0; (ring - 1) * CELL_MM <= Math.sqrt(best); ring++) {
    for (let i = at[0] - ring; i <= at[0] + ring; i++) {
      for (let j = at[1] - ring; j <= at[1] + ring; j++) {
        const onRim = Math.abs(i - at[0]) === ring || Math.abs(j - at[1]) === ring;
        for (let k = at[2] - ring; k <= at[2] + ring; k += onRim || ring === 0 ? 1 : 2 * ring) {
          if (i < 0 || j < 0 || k < 0 || i >= n[0] || j >= n[1] || k >= n[2]) continue;
          for (const face of cells.get(i + n[0] * (j + n[1] * k)) ?? []) {
            const [squared, side] = toTriangle(of, face, x, y, z);
            if (squared < best) {
              best = squared;
              signed = side < 0 ? -Math.sqrt(squared) : Math.sqrt(squared);
            }
          }
        }
      }
    }
  }
  return signed;
}

/**
 * Squared distance of a point from a triangle, and on which side of it the point lies (Ericson 2005, section 5.1.5).
 * @param {Surface} of
 * @param {number} face
 * @param {number} x
 * @param {number} y
 * @param {number} z
 * @returns {[number, number]}
 */
function toTriangle({ vertices, faces }, face, x, y, z) {
  const [a, b, c] = [3 * faces[face], 3 * faces[face + 1], 3 * faces[face + 2]];
  const [ax, ay, az] = [vertices[a], vertices[a + 1], vertices[a + 2]];
  const [ux, uy, uz] = [vertices[b] - ax, vertices[b + 1] - ay, vertices[b + 2] - az];
  const [vx, vy, vz] = [vertices[c] - ax, vertices[c + 1] - ay, vertices[c + 2] - az];
  const [px, py, pz] = [x - ax, y - ay, z - az];
  const [d1, d2] = [ux * px + uy * py + uz * pz, vx * px + vy * py + vz * pz];
  const [uu, uv, vv] = [ux * ux + uy * uy + uz * uz, ux * vx + uy * vy + uz * vz, vx * vx + vy * vy + vz * vz];
  // At b and c.
  const [d3, d4, d5, d6] = [d1 - uu, d2 - uv, d1 - uv, d2 - vv];
  let s = 0;
  let t = 0;
  const area = d1 * d4 - d3 * d2;
  const areaB = d5 * d2 - d1 * d6;
  const areaA = d3 * d6 - d5 * d4;
  if (d1 <= 0 && d2 <= 0) {
    // The corner a.
  } else if (d3 >= 0 && d4 <= d3) s = 1;
  else if (area <= 0 && d1 >= 0 && d3 <= 0) s = d1 / (d1 - d3);
  else if (d6 >= 0 && d5 <= d6) t = 1;
  else if (areaB <= 0 && d2 >= 0 && d6 <= 0) t = d2 / (d2 - d6);
  else if (areaA <= 0 && d4 - d3 >= 0 && d5 - d6 >= 0) {
    t = (d4 - d3) / (d4 - d3 + (d5 - d6));
    s = 1 - t;
  } else {
    const all = areaA + areaB + area;
    s = areaB / all;
    t = area / all;
  }
  const [ex, ey, ez] = [px - s * ux - t * vx, py - s * uy - t * vy, pz - s * uz - t * vz];
  const side = ex * (uy * vz - uz * vy) + ey * (uz * vx - ux * vz) + ez * (ux * vy - uy * vx);
  return [ex * ex + ey * ey + ez * ez, side];
}

/**
 * Residuals of points that a matrix (column by column) takes to the surface's frame.
 * @param {Surface} of
 * @param {Float64Array} points
 * @param {number[]} m
 */
export function residuals(of, points, m) {
  const out = new Float32Array(points.length / 3);
  for (let k = 0; k < out.length; k++) {
    const [x, y, z] = [points[3 * k], points[3 * k + 1], points[3 * k + 2]];
    out[k] = residual(
      of,
      m[0] * x + m[4] * y + m[8] * z + m[12],
      m[1] * x + m[5] * y + m[9] * z + m[13],
      m[2] * x + m[6] * y + m[10] * z + m[14],
    );
  }
  return out;
}

// As a worker: a surface, then clouds; each answer has the number of its question.
if ("WorkerGlobalScope" in globalThis) {
  self.onmessage = ({ data }) => {
    if (data.vertices) surface = prepare(data.vertices, data.faces);
    else if (surface) {
      const found = residuals(surface, data.points, data.matrix);
      self.postMessage({ wire: data.wire, question: data.question, residuals: found }, { transfer: [found.buffer] });
    }
  };
}

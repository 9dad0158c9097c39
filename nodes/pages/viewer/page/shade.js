// Light and shade on the points of a scan, as if it were a surface seen from one side.

import { cross, dot, minus, plus, unit } from "./surface.js";

/** @typedef {import("./surface.js").Vector} Vector */

/** Edge of the cells whose mean depth is compared with their neighbours', mm: a few points of a scan. */
const CELL_MM = 1.2;
/** The light comes over the viewer's left shoulder. */
const LIGHT = unit([-0.5, 0.6, 1]);

/**
 * Colours of points, three numbers each: by the slope of the cells that they are in, seen along a direction.
 * @param {Float64Array} points
 * @param {Vector} towards the viewer, of length 1
 * @param {Vector} up
 * @param {number} colour
 */
export function shade(points, towards, up, colour) {
  const right = unit(cross(up, towards));
  const above = cross(towards, right);
  /** @type {Map<string, [number, number]>} */
  const cells = new Map();
  const n = points.length / 3;
  const at = (/** @type {number} */ k) => {
    const p = [points[3 * k], points[3 * k + 1], points[3 * k + 2]];
    return [Math.floor(dot(p, right) / CELL_MM), Math.floor(dot(p, above) / CELL_MM), dot(p, towards)];
  };
  for (let k = 0; k < n; k++) {
    const [x, y, depth] = at(k);
    const cell = cells.get(`${x} ${y}`);
    if (cell) {
      cell[0] += depth;
      cell[1] += 1;
    } else cells.set(`${x} ${y}`, [depth, 1]);
  }
  const mean = (/** @type {number} */ x, /** @type {number} */ y) => {
    const cell = cells.get(`${x} ${y}`);
    return cell ? cell[0] / cell[1] : null;
  };
  /** The slope between the neighbours of a cell, as far as it has them. @param {number[]} cell @param {number[]} step */
  const slope = ([x, y], [i, j]) => {
    const [before, here, after] = [mean(x - i, y - j), mean(x, y) ?? 0, mean(x + i, y + j)];
    if (before === null && after === null) return 0;
    return ((after ?? here) - (before ?? here)) / (CELL_MM * (before === null || after === null ? 1 : 2));
  };
  const colours = new Float32Array(3 * n);
  const full = [(colour >> 16) & 255, (colour >> 8) & 255, colour & 255].map((c) => c / 255);
  for (let k = 0; k < n; k++) {
    const cell = at(k);
    const normal = unit([-slope(cell, [1, 0]), -slope(cell, [0, 1]), 1]);
    const light = 0.15 + 0.85 * Math.max(0, dot(normal, LIGHT));
    for (let c = 0; c < 3; c++) colours[3 * k + c] = light * full[c];
  }
  return colours;
}

/** The middle of points and the corners of their box. @param {Float64Array} points */
export function extent(points) {
  const [low, high] = [[Infinity, Infinity, Infinity], [-Infinity, -Infinity, -Infinity]];
  points.forEach((x, k) => {
    low[k % 3] = Math.min(low[k % 3], x);
    high[k % 3] = Math.max(high[k % 3], x);
  });
  return { centre: plus(low, high).map((c) => c / 2), size: minus(high, low) };
}

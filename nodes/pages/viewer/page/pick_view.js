// Where the view looks from while picking, and a scan with light and shade.

import * as THREE from "three";
import { BONE, MM } from "./drawables.js";
import { extent, shade } from "./shade.js";
import { longAxis } from "./shapes.js";
import { cross, dot, minus, norm, unit } from "./surface.js";

/** @typedef {import("./message.js").Item} Item */
/** @typedef {import("./scene.js").Scene} Scene */
/** @typedef {import("./surface.js").Vector} Vector */

/** A camera sees at most this far aside of what is a length of one before it. */
const OPENING = 1;
/** How much of what is across a shell must be told by how far it is from its middle, for it to have an outside: a share of its variance. */
const BULGE = 0.1;

/**
 * From where a scan is looked at: where it was made, if that is known, else the camera's place in its frame; where no camera can have been
 * there, as in the world of a tracker, the outside.
 * @param {Item} item
 */
export function sideOf(item) {
  const rows = /** @type {Float64Array} */ (item.columns.points.rows);
  const { centre, size } = extent(rows);
  const viewpoint = /** @type {number[] | undefined} */ (item.fields.viewpoint)?.slice(0, 3);
  const from = minus(viewpoint ?? [0, 0, 0], centre);
  // Inside the scan there is no side to look from.
  const isBeside = norm(from) > norm(size) / 2;
  if (isBeside && (viewpoint !== undefined || isBeforeCamera(rows))) return { towards: unit(from), up: [0, -1, 0] };
  const towards = outside(rows) ?? (isBeside ? unit(from) : [0, 0, -1]);
  return { towards, up: Math.abs(towards[1]) > 0.9 ? [0, 0, 1] : [0, -1, 0] };
}

/** Whether a camera at the origin that looks along z can have seen these points. @param {Float64Array} rows */
export function isBeforeCamera(rows) {
  for (let k = 0; k < rows.length; k += 3) {
    if (!(rows[k + 2] > 0) || Math.abs(rows[k]) > OPENING * rows[k + 2] || Math.abs(rows[k + 1]) > OPENING * rows[k + 2]) return false;
  }
  return true;
}

/** The direction in which a shell bulges, of those across its length; null if it does not. @param {Float64Array} rows */
function outside(rows) {
  const { origin, direction } = longAxis(rows);
  const one = unit(cross(direction, Math.abs(direction[2]) < 0.9 ? [0, 0, 1] : [1, 0, 0]));
  const other = cross(direction, one);
  let [xx, xy, yy] = [0, 0, 0];
  /** @type {[number, number][]} */
  const flat = [];
  for (let k = 0; k < rows.length; k += 3) {
    const p = minus([rows[k], rows[k + 1], rows[k + 2]], origin);
    const [x, y] = [dot(p, one), dot(p, other)];
    flat.push([x, y]);
    [xx, xy, yy] = [xx + x * x, xy + x * y, yy + y * y];
  }
  // The narrower direction is through the shell.
  const angle = 0.5 * Math.atan2(2 * xy, xx - yy) + Math.PI / 2;
  const [c, s] = [Math.cos(angle), Math.sin(angle)];
  // How the height falls with the square of what is beside the middle.
  const pairs = flat.map(([x, y]) => ({ height: c * x + s * y, square: (c * y - s * x) ** 2 }));
  const mean = pairs.reduce((sum, { square }) => sum + square, 0) / pairs.length;
  let [hh, hq, qq] = [0, 0, 0];
  for (const { height, square } of pairs) [hh, hq, qq] = [hh + height * height, hq + height * (square - mean), qq + (square - mean) ** 2];
  if (hq * hq < BULGE * hh * qq) return null;
  const sign = hq < 0 ? 1 : -1;
  return [0, 1, 2].map((k) => sign * (c * one[k] + s * other[k]));
}

/** Shows the shape of a scan, which its points in one colour do not; a scan in its own colours keeps them. @param {Scene} scene @param {{wire: string, item: Item}} cloud */
export function shadeCloud(scene, { wire, item }) {
  const object = scene.drawn.get(wire)?.object;
  const drawn = object?.children[0];
  if (!(drawn instanceof THREE.Points) || (scene.colours.isOwn && object?.userData.hasOwn)) return;
  if (drawn.userData.shades && drawn.geometry.getAttribute("color") === drawn.userData.shades) return;
  const { towards, up } = sideOf(item);
  const shades = (drawn.userData.shades ??= new THREE.BufferAttribute(shade(/** @type {Float64Array} */ (item.columns.points.rows), towards, up, BONE), 3));
  drawn.geometry.setAttribute("color", shades);
  Object.assign(drawn.material, { vertexColors: true, size: 3, needsUpdate: true });
  drawn.material.color.set(0xffffff);
}

/** @param {Scene} scene @param {Vector} at mm @param {Vector} from a direction @param {number} mm what the view shows of it @param {Vector} up */
export function lookFrom(scene, at, from, mm, up) {
  const { controls } = scene;
  const camera = scene.perspective();
  const distance = (mm * MM) / 2 / Math.tan((camera.fov * Math.PI) / 360);
  camera.up.fromArray(Math.abs(dot(unit(up), from)) > 0.95 ? cross(from, [1, 0, 0]) : up);
  controls.target.fromArray(at).multiplyScalar(MM);
  camera.position.copy(controls.target).addScaledVector(new THREE.Vector3(...from), distance);
  camera.near = (mm * MM) / 200;
  camera.far = 20;
  camera.updateProjectionMatrix();
  controls.update();
  scene.isLookedAt = true;
  scene.redraw();
}

// Where the view looks from while picking, and a scan with light and shade.

import * as THREE from "three";
import { BONE, MM } from "./drawables.js";
import { extent, shade } from "./shade.js";
import { cross, dot, minus, norm, unit } from "./surface.js";

/** @typedef {import("./message.js").Item} Item */
/** @typedef {import("./scene.js").Scene} Scene */
/** @typedef {import("./surface.js").Vector} Vector */

/** From where a scan is looked at: where it was made, else the origin of its frame. @param {Item} item */
function sideOf(item) {
  const { centre, size } = extent(/** @type {Float64Array} */ (item.columns.points.rows));
  const from = minus(/** @type {number[] | undefined} */ (item.fields.viewpoint)?.slice(0, 3) ?? [0, 0, 0], centre);
  // Inside the scan there is no side to look from.
  return { centre, mm: norm(size), towards: norm(from) > norm(size) / 2 ? unit(from) : [0, 0, -1], up: [0, -1, 0] };
}

/** @param {Scene} scene @param {Item} item */
export function lookAtCloud(scene, item) {
  const { centre, mm, towards, up } = sideOf(item);
  lookFrom(scene, centre, towards, mm, up);
}

/** Shows the shape of a scan, which its points in one colour do not. @param {Scene} scene @param {{wire: string, item: Item}} cloud */
export function shadeCloud(scene, { wire, item }) {
  const drawn = scene.drawn.get(wire)?.object.children[0];
  if (!(drawn instanceof THREE.Points) || drawn.userData.isShaded) return;
  const { towards, up } = sideOf(item);
  const colours = shade(/** @type {Float64Array} */ (item.columns.points.rows), towards, up, BONE);
  drawn.geometry.setAttribute("color", new THREE.BufferAttribute(colours, 3));
  Object.assign(drawn.material, { vertexColors: true, size: 3, needsUpdate: true });
  drawn.material.color.set(0xffffff);
  drawn.userData.isShaded = true;
}

/** Gives scans their own colours again. @param {Scene} scene */
export function unshade(scene) {
  for (const [wire, { object }] of scene.drawn) {
    const drawn = object.children[0];
    if (!(drawn instanceof THREE.Points) || !drawn.userData.isShaded) continue;
    drawn.userData.isShaded = false;
    drawn.material.size = 2;
    scene.colours.forget(wire);
  }
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

// What is under a place of the window: the nearest point of the bone in front, or a measured point of the scan. Double precision.

import * as THREE from "three";
import { MM } from "./drawables.js";
import { Surface, dot, minus, norm, plus } from "./surface.js";

/** @typedef {import("./picks.js").Group} Group */
/** @typedef {import("./surface.js").Vector} Vector */

/** Points of a scan this far behind the nearest under the pointer belong to its other side, mm. */
const BEHIND_MM = 3;
/** A point this far behind the surface is hidden by it, mm. */
const HIDDEN_MM = 1;

export class Aim {
  /**
   * @param {import("./scene.js").Scene} scene
   * @param {import("./shown_plan.js").Shown} shown
   */
  constructor(scene, shown) {
    this.scene = scene;
    this.shown = shown;
  }

  /** The rectangle of the view. */
  rectangle() { return this.scene.renderer.domElement.getBoundingClientRect(); }

  /** The ray under a place of the window, mm. @param {number} x @param {number} y */
  ray(x, y) {
    const { camera } = this.scene;
    camera.updateMatrixWorld();
    const box = this.rectangle();
    const through = new THREE.Vector3((2 * (x - box.left)) / box.width - 1, 1 - (2 * (y - box.top)) / box.height, 0.5).unproject(camera);
    const origin = new THREE.Vector3().setFromMatrixPosition(camera.matrixWorld);
    const direction = through.sub(origin).normalize();
    return { origin: origin.toArray().map((c) => c / MM), direction: direction.toArray() };
  }

  /** The place of a point in the window; null behind the camera. @param {Vector} point mm @returns {number[] | null} */
  onScreen(point) {
    const { camera } = this.scene;
    camera.updateMatrixWorld();
    const at = new THREE.Vector3(...point).multiplyScalar(MM).project(camera);
    const box = this.rectangle();
    if (Math.abs(at.z) > 1) return null;
    return [box.left + ((at.x + 1) / 2) * box.width, box.top + ((1 - at.y) / 2) * box.height];
  }

  /** Whether the bone hides a point. @param {Vector} point @param {boolean} isOnScan */
  isHidden(point, isOnScan) {
    const surface = isOnScan ? null : this.shown.surface();
    if (!surface) return false;
    const origin = this.scene.camera.position.toArray().map((c) => c / MM);
    const hit = surface.cast(origin, minus(point, origin));
    return hit !== null && hit.distance < norm(minus(point, origin)) - HIDDEN_MM;
  }

  /**
   * The point of the bone or of the scan under a place of the window.
   * @param {Group} group
   * @param {number} x
   * @param {number} y
   * @param {number} px reach
   * @returns {{position: Vector} | {why: string}}
   */
  at(group, x, y, px) {
    const { origin, direction } = this.ray(x, y);
    if (group === "scan") return this.atCloud(origin, direction, px);
    const [bone, surface] = [this.shown.bone(), this.shown.surface()];
    if (!bone || !surface) return { why: "no surface of a bone is shown" };
    if (!this.scene.drawn.get(bone.wire)?.object.visible) return { why: `${bone.wire} is not shown` };
    const hit = surface.cast(origin, direction);
    for (const [wire, { columns }] of this.shown.items) {
      if (!columns.faces || wire === bone.wire || !this.scene.drawn.get(wire)?.object.visible) continue;
      const other = new Surface(/** @type {Float64Array} */ (columns.vertices.rows), /** @type {Uint32Array} */ (columns.faces.rows));
      const before = other.cast(origin, direction);
      if (before && before.distance < (hit?.distance ?? Infinity)) return { why: `${wire} is in front of the bone there; nothing was picked` };
    }
    return hit ? { position: hit.point } : { why: "there is no bone under the pointer" };
  }

  /** @param {Vector} origin @param {Vector} direction @param {number} px @returns {{position: Vector} | {why: string}} */
  atCloud(origin, direction, px) {
    const cloud = this.shown.cloud();
    if (!cloud || !this.scene.drawn.get(cloud.wire)?.object.visible) return { why: "no scan is shown" };
    const rows = /** @type {Float64Array} */ (cloud.item.columns.points.rows);
    const camera = this.scene.perspective();
    // Millimetres across at a distance of one, for a reach in pixels.
    const share = (px * 2 * Math.tan((camera.fov * Math.PI) / 360)) / this.rectangle().height;
    /** @type {{off: number, depth: number, at: number}[]} */
    const near = [];
    for (let k = 0; k < rows.length; k += 3) {
      const to = [rows[k] - origin[0], rows[k + 1] - origin[1], rows[k + 2] - origin[2]];
      const depth = dot(to, direction);
      if (depth <= 0) continue;
      const off = norm(plus(to, direction, -depth));
      if (off <= share * depth) near.push({ off, depth, at: k });
    }
    if (near.length === 0) return { why: "there is no point of the scan under the pointer" };
    const first = near.reduce((least, { depth }) => Math.min(least, depth), Infinity);
    const { at } = near.filter(({ depth }) => depth <= first + BEHIND_MM).reduce((a, b) => (b.off < a.off ? b : a));
    return { position: [...rows.subarray(at, at + 3)] };
  }
}

// The camera, by what it has seen, and the axes of all frames.

import * as THREE from "three";
import { MM, label } from "./drawables.js";

/** @typedef {import("./message.js").Item} Item */
/** @typedef {import("./frames.js").Frames} Frames */
/** @typedef {import("./scene.js").Scene} Scene */

/** The frame in which scans are as the camera made them: its origin is the camera. */
const CAMERA = "camera";
/** The names in the list of what is shown. */
const VIEW = "camera and what it has seen", AXES = "axes of the frames";
/** Length of a drawn axis, mm. */
const AXIS_MM = 25;
/** Colours of x, y and z that differ in lightness. */
const COLOURS = [0xd55e00, 0x009e73, 0x0072b2];
const LINE = 0x5b6670;
/** One point in so many is looked at. */
const EVERY = 7;

export class Devices {
  /** @param {Scene} scene */
  constructor(scene) {
    this.scene = scene;
    /** Least and greatest of x / z, y / z and z that the camera has seen. @type {number[] | null} */
    this.seen = null;
    this.isDirty = false;
    /** Number of scans that were looked at. */
    this.n = 0;
    /** The frames whose axes are drawn. */
    this.names = "";
    /** Whether the user wants to see them; the scene forgets what it draws when a recording jumps. @type {Map<string, boolean>} */
    this.shown = new Map([[VIEW, false], [AXES, false]]);
  }

  /** What was seen before the recording jumped or another run began is not known any more. */
  clear() {
    this.seen = null;
    this.n = 0;
  }

  /** @param {string} payload @param {Item} item */
  item(payload, item) {
    if (payload !== "geometry/Cloud" || item.empty || item.fields.frame !== CAMERA) return;
    const { rows } = item.columns.points;
    this.n++;
    const seen = this.seen ?? [Infinity, -Infinity, Infinity, -Infinity, Infinity, -Infinity];
    for (let k = 0; k + 2 < rows.length; k += 3 * EVERY) {
      const [x, y, z] = [Number(rows[k]), Number(rows[k + 1]), Number(rows[k + 2])];
      // A camera sees nothing behind it: such a scan is not in the frame of its camera.
      if (!(z > 1)) continue;
      [x / z, y / z, z].forEach((c, i) => {
        if (c < seen[2 * i]) [seen[2 * i], this.isDirty] = [c, true];
        if (c > seen[2 * i + 1]) [seen[2 * i + 1], this.isDirty] = [c, true];
      });
    }
    if (Number.isFinite(seen[0])) this.seen = seen;
  }

  /** Before each frame. @param {Frames} frames */
  draw(frames) {
    const { scene } = this;
    for (const name of [VIEW, AXES]) {
      const drawn = scene.drawn.get(name);
      if (drawn) this.shown.set(name, drawn.shown);
    }
    if (this.seen && (this.isDirty || !scene.drawn.has(VIEW))) {
      this.isDirty = false;
      this.put(VIEW, pyramid(this.seen), CAMERA);
    }
    this.drawAxes(frames);
  }

  /** @param {string} name @param {THREE.Object3D} object @param {string} frame */
  put(name, object, frame) {
    this.scene.put(name, object, { frame, payload: "device", shown: this.shown.get(name) ?? false });
  }

  /** @param {Frames} frames */
  drawAxes(frames) {
    const { scene } = this;
    const root = scene.rootOf(frames);
    // A frame that is placed twice has its second place under a name with the wire, for viewers: `ct (icp.t_target_source)`.
    const all = [...new Set([root, ...frames.edges.keys()])].filter((name) => name !== "" && !name.includes(" ")).sort();
    const key = JSON.stringify([root, all]);
    if (all.length === 0) return;
    if (key !== this.names || !scene.drawn.has(AXES)) {
      this.names = key;
      const object = new THREE.Group();
      all.forEach((name) => object.add(axes(name)));
      this.put(AXES, object, root);
    }
    const { object, shown } = /** @type {import("./scene.js").Drawn} */ (scene.drawn.get(AXES));
    if (!shown) return;
    all.forEach((name, k) => {
      const place = frames.toRoot(name);
      const child = object.children[k];
      child.visible = place.unknown === null && place.root === root;
      child.matrix.copy(place.matrix);
      // The scene draws in metres what is given in millimetres.
      for (const at of [12, 13, 14]) child.matrix.elements[at] /= MM;
    });
  }
}

/** @param {number[][]} ends two by two @param {number} colour */
function lines(ends, colour) {
  const geometry = new THREE.BufferGeometry().setAttribute("position", new THREE.Float32BufferAttribute(ends.flat(), 3));
  return new THREE.LineSegments(geometry, new THREE.LineBasicMaterial({ color: colour }));
}

/** The camera's place and the edges of what it has seen: near, far and between. @param {number[]} seen */
function pyramid([x0, x1, y0, y1, near, far]) {
  const at = (/** @type {number} */ z) => [[x0, y0], [x1, y0], [x1, y1], [x0, y1]].map(([x, y]) => [x * z, y * z, z]);
  /** @type {number[][]} */
  const ends = [];
  for (const z of [near, far]) at(z).forEach((corner, k, all) => ends.push(corner, all[(k + 1) % 4]));
  at(far).forEach((corner) => ends.push([0, 0, 0], corner));
  const object = new THREE.Group();
  object.add(lines(ends, LINE), label("camera"));
  return object;
}

/** @param {string} name */
function axes(name) {
  const object = new THREE.Group();
  object.matrixAutoUpdate = false;
  COLOURS.forEach((colour, k) => object.add(lines([[0, 0, 0], [0, 1, 2].map((c) => (c === k ? AXIS_MM : 0))], colour)));
  object.add(label(name));
  return object;
}

// The colours of scans by their distance from the bone, as a worker computes it or as it was given with the scan.

import * as THREE from "three";
import { MM, UNKNOWN } from "./drawables.js";

/** @typedef {import("./frames.js").Frames} Frames */
/** @typedef {import("./scene.js").Scene} Scene */

/** Residual at the ends of the colour scale, mm. */
export const RESIDUAL_MM = 1;

/** Ends and middle of the scale, as the screen shows them: blue inside, white on the surface, orange outside; grey where there is none near. */
const INSIDE = [0, 115, 178], ON = [247, 247, 242], OUTSIDE = [214, 94, 0], NONE = [140, 145, 153];
/** Steps from the middle to an end. */
const STEPS = 127;

/** A colour for the renderer, which mixes in linear light. @param {number[]} rgb */
const linear = ([r, g, b]) => new THREE.Color().setRGB(r / 255, g / 255, b / 255, THREE.SRGBColorSpace).toArray();
const GREY = linear(NONE);
const SCALE = Array.from({ length: 2 * STEPS + 1 }, (_, k) => {
  const share = Math.abs(k - STEPS) / STEPS;
  const end = k < STEPS ? INSIDE : OUTSIDE;
  return linear(ON.map((c, i) => c + share * (end[i] - c)));
});

/** The colour of a signed value; `max` is at the ends of the scale. @param {number} value @param {number} max */
export function scaleColour(value, max) {
  if (!Number.isFinite(value)) return GREY;
  return SCALE[STEPS + Math.round(STEPS * Math.max(-1, Math.min(1, value / max)))];
}

/** Colours of vertices or points, three numbers each. @param {Float32Array} values @param {number} max */
export function scaleColours(values, max) {
  const colours = new Float32Array(3 * values.length);
  values.forEach((value, k) => colours.set(scaleColour(value, max), 3 * k));
  return new THREE.BufferAttribute(colours, 3);
}

/** The columns of the colours that a scan has itself. */
const OWN = ["red", "green", "blue"].map((name) => `extra/${name}`);

/** Whether a scan has colours itself. @param {import("./message.js").Item} item */
export function hasOwnColours({ columns }) { return OWN.every((name) => columns[name]); }

/** The colours that a scan has itself; null if it has none. @param {import("./message.js").Item} item */
export function ownColours(item) {
  if (!hasOwnColours(item)) return null;
  const [red, green, blue] = OWN.map((name) => item.columns[name].rows);
  let top = 0;
  for (const rows of [red, green, blue]) for (const value of rows) top = Math.max(top, Number(value));
  // Bytes, shares of one, or numbers of 16 bits.
  const scale = top > 255 ? 255 / 65535 : top > 1 ? 1 : 255;
  const colours = new Float32Array(3 * red.length);
  for (let k = 0; k < red.length; k++) colours.set(linear([red, green, blue].map((rows) => scale * Number(rows[k]))), 3 * k);
  return new THREE.BufferAttribute(colours, 3);
}

export class ResidualColours {
  /** @param {Scene} scene @param {Worker | null} worker that computes residuals; without one they come with the clouds */
  constructor(scene, worker) {
    this.scene = scene;
    this.worker = worker;
    if (worker) worker.onmessage = ({ data }) => this.answer(data);
    /** The surface that residuals are measured from. @type {string | null} */
    this.surface = null;
    /** What was asked last for each cloud. @type {Map<string, {key: string, question: number}>} */
    this.asked = new Map();
    this.questions = 0;
    /** The distances of the points of each cloud from the surface, mm. @type {Map<string, Float32Array>} */
    this.known = new Map();
    /** Whether scans have their own colours, where they have some. */
    this.isOwn = false;
  }

  /** Whether a scan that is drawn has colours of its own. */
  get hasOwn() { return [...this.scene.drawn.values()].some(({ object }) => object.userData.hasOwn); }

  /** Shows scans in their own colours, or in those of their distance. @param {boolean} isOwn */
  choose(isOwn) {
    this.isOwn = isOwn;
    this.asked.clear();
    for (const [wire, { payload }] of this.scene.drawn) if (payload === "geometry/Cloud") this.paint(wire);
  }

  clear() {
    this.surface = null;
    this.asked.clear();
    this.known.clear();
  }

  /** Takes a surface to measure from. @param {string} wire @param {import("./message.js").Item} item */
  measureFrom(wire, item) {
    this.surface = wire;
    this.asked.clear();
    this.worker?.postMessage({ vertices: item.columns.vertices.rows, faces: item.columns.faces.rows });
  }

  /** Asks for the residuals of the clouds that are drawn, if a cloud or its place on the surface has changed. @param {Frames} frames */
  ask(frames) {
    const { drawn } = this.scene;
    const surface = this.surface === null ? undefined : drawn.get(this.surface);
    if (!surface || !this.worker || this.scene.focus) return;
    const toSurface = frames.toRoot(surface.frame).matrix.clone().invert();
    for (const [wire, { object, frame, payload }] of drawn) {
      const { points } = object.userData;
      if (payload !== "geometry/Cloud" || !points) continue;
      const known = this.asked.get(wire);
      if (!object.visible || frames.toRoot(frame).root !== frames.toRoot(surface.frame).root) continue;
      const matrix = toSurface.clone().multiply(frames.toRoot(frame).matrix);
      // From metres to millimetres.
      const elements = matrix.elements.map((c, k) => (k >= 12 && k < 15 ? c / MM : c));
      // To 10 nm: the rounding of a pose that goes there and back is no motion.
      const key = `${object.id} ${elements.map((c) => c.toFixed(5))}`;
      // One question at a time: of a stream the newest is asked next.
      if (known?.key === key || (known && known.question >= 0)) continue;
      const question = this.questions++;
      this.asked.set(wire, { key, question });
      this.worker.postMessage({ wire, question, points, matrix: elements });
    }
  }

  /** @param {{wire: string, question: number, residuals: Float32Array}} answer */
  answer({ wire, question, residuals }) {
    const asked = this.asked.get(wire);
    if (!asked || asked.question !== question) return;
    this.asked.set(wire, { ...asked, question: -1 });
    this.colour(wire, residuals);
  }

  /** Colours a cloud, unless it is another one by now. @param {string} wire @param {Float32Array} residuals mm, positive outside */
  colour(wire, residuals) {
    this.known.set(wire, residuals);
    this.paint(wire);
  }

  /** Paints a scan: in its own colours, or in those of its distances, or grey. @param {string} wire */
  paint(wire) {
    const object = this.scene.drawn.get(wire)?.object;
    const points = object?.children[0];
    if (!object || !(points instanceof THREE.Points)) return;
    const residuals = this.known.get(wire);
    const isKnown = residuals?.length === points.geometry.getAttribute("position").count;
    const colours = (this.isOwn ? object.userData.own?.() : null) ?? (residuals && isKnown ? scaleColours(residuals, RESIDUAL_MM) : null);
    if (colours) points.geometry.setAttribute("color", colours);
    else points.geometry.deleteAttribute("color");
    points.material.vertexColors = colours !== null;
    points.material.color.set(colours ? 0xffffff : UNKNOWN);
    points.material.needsUpdate = true;
    this.scene.redraw();
  }
}

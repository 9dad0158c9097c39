// The region of interest, drawn by hand on a scan: lasso, box, slab, brush; kept or cut, with the points inside counted.

import * as THREE from "three";
import { BONE, MM } from "./drawables.js";
import { fileField, readRegion } from "./load.js";
import { isBeforeCamera, sideOf } from "./pick_view.js";
import { post } from "./request.js";
import { shade } from "./shade.js";
import { boxAround, longAxis, within } from "./shapes.js";

/** @typedef {import("./scene.js").Scene} Scene */
/** @typedef {import("./shapes.js").Shape} Shape */
/** @typedef {import("./shapes.js").Outline} Outline */

/** Colours of points in full light: of all before anything is drawn, then inside and outside. */
const PLAIN = [(BONE >> 16) & 255, (BONE >> 8) & 255, BONE & 255].map((c) => c / 255);
const INSIDE = [0.2, 0.75, 1], OUTSIDE = [0.55, 0.55, 0.55];
/** How near the pointer must be to a point to touch it, pixels. */
const TOUCH_PX = 16;
/** What is drawn where, for the user. */
const HINTS = {
  turn: "drag to turn the scan",
  lasso: "drag around the points",
  box: "drag a rectangle: the box around the points in it",
  slab: "drag along the bone, from one end of the slab to the other",
  brush: "paint over the points",
};
/** @typedef {keyof typeof HINTS} Mode */

export class RegionTool {
  /**
   * @param {Scene} scene
   * @param {HTMLElement} panel
   * @param {(text: string) => void} say
   * @param {(isOpen: boolean) => void} changed called when drawing begins and ends
   */
  constructor(scene, panel, say, changed) {
    this.scene = scene;
    this.panel = panel;
    this.say = say;
    this.changed = changed;
    /** The cloud that is drawn on, with how light each point is. @type {{node: string, frame: string, rows: Float64Array, light: Float32Array, object: THREE.Points, box: THREE.LineSegments | null} | null} */
    this.on = null;
    /** @type {{shape: Shape, keeps: boolean}[]} */
    this.shapes = [];
    /** @type {Mode} */
    this.mode = "turn";
    this.keeps = true;
    this.radius = 4;
    /** The drag under way, in pixels of the view. @type {number[][] | null} */
    this.stroke = null;
    /** Centres of a brush's stroke. @type {number[][]} */
    this.centres = [];
    /** The view before. @type {(() => void) | null} */
    this.restore = null;
    this.overlay = document.createElementNS("http://www.w3.org/2000/svg", "svg");
    this.overlay.id = "stroke";
    this.line = document.createElementNS("http://www.w3.org/2000/svg", "polyline");
    this.overlay.append(this.line);
    this.overlay.style.display = "none";
    scene.holder.append(this.overlay);
    this.overlay.addEventListener("pointerdown", (event) => this.begin(event));
    this.overlay.addEventListener("pointermove", (event) => this.extend(event));
    for (const end of ["pointerup", "pointercancel"]) this.overlay.addEventListener(end, () => this.finish());
  }

  get isOpen() { return this.on !== null; }

  /**
   * Shows the cloud alone, as the camera sees it.
   * @param {string} node the crop
   * @param {string} wire its cloud
   */
  open(node, wire) {
    const drawn = this.scene.drawn.get(wire);
    const rows = drawn?.object.userData.points;
    if (!drawn || !(rows instanceof Float64Array) || rows.length === 0) {
      this.say(`no cloud of ${wire} is known here; record it: [record] wires = ["${wire}"]`);
      return;
    }
    this.close();
    this.changed(true);
    const positions = new THREE.BufferAttribute(Float32Array.from(rows), 3);
    const geometry = new THREE.BufferGeometry().setAttribute("position", positions);
    const material = new THREE.PointsMaterial({ size: 2.5, sizeAttenuation: false, vertexColors: true });
    const object = new THREE.Points(geometry, material);
    object.scale.setScalar(MM);
    const { towards, up } = sideOf(/** @type {any} */ ({ fields: {}, columns: { points: { rows } } }));
    const light = shade(rows, towards, up, 0xffffff);
    this.on = { node, frame: drawn.frame, rows, light, object, box: null };
    this.shapes = [];
    this.restore = this.scene.alone(object);
    this.setMode("lasso");
    this.count();
    // The buttons take room from the view.
    this.scene.resize();
    this.look();
  }

  close() {
    if (!this.on) return;
    this.on.object.geometry.dispose();
    this.on = null;
    this.restore?.();
    this.overlay.style.display = "none";
    this.show();
    this.changed(false);
  }

  /** Whether a camera at the origin of the cloud's frame can have seen it. */
  isBeforeCamera() { return this.on !== null && isBeforeCamera(this.on.rows); }

  /** Looks from the camera if the cloud is in front of it, else from outside. */
  look() {
    if (!this.on) return;
    const { rows } = this.on;
    const { origin, direction } = longAxis(rows);
    if (!this.isBeforeCamera()) {
      // Elsewhere than in the camera's frame from outside, its length upright.
      const from = new THREE.Vector3(...sideOf(/** @type {any} */ ({ fields: {}, columns: { points: { rows } } })).towards);
      const up = new THREE.Vector3(...direction).projectOnPlane(from);
      const all = [];
      for (let k = 0; k < rows.length; k += 3) all.push(new THREE.Vector3(rows[k], rows[k + 1], rows[k + 2]).multiplyScalar(MM));
      return this.scene.fit(all, from, up.length() > 0.1 ? up.normalize() : from.clone().cross(new THREE.Vector3(from.y, from.z, -from.x)).normalize());
    }
    const centre = new THREE.Vector3(...origin).multiplyScalar(MM);
    const size = new THREE.Box3().setFromBufferAttribute(/** @type {THREE.BufferAttribute} */ (this.on.object.geometry.getAttribute("position"))).getSize(new THREE.Vector3()).length() * MM;
    this.scene.lookFrom(new THREE.Vector3(0, 0, 0), centre, new THREE.Vector3(0, -1, 0), size);
  }

  /** @param {Mode} mode */
  setMode(mode) {
    this.mode = mode;
    this.overlay.style.display = this.on && mode !== "turn" ? "block" : "none";
    this.show();
  }

  /** @param {PointerEvent} event */
  begin(event) {
    if (!this.on || event.button !== 0) return;
    event.preventDefault();
    this.overlay.setPointerCapture(event.pointerId);
    this.stroke = [];
    this.centres = [];
    this.extend(event);
  }

  /** @param {PointerEvent} event */
  extend(event) {
    if (!this.stroke) return;
    const bounds = this.overlay.getBoundingClientRect();
    const place = [event.clientX - bounds.left, event.clientY - bounds.top];
    const last = this.stroke.at(-1);
    if (last && Math.hypot(place[0] - last[0], place[1] - last[1]) < 2) return;
    this.stroke.push(place);
    if (this.mode === "brush") {
      const touched = this.touched(place);
      const before = this.centres.at(-1);
      if (touched && (!before || Math.hypot(...touched.map((c, k) => c - before[k])) > this.radius / 3)) this.centres.push(touched);
    }
    this.line.setAttribute("points", this.drawnStroke().map((at) => at.join(",")).join(" "));
  }

  /** The stroke as it is shown. */
  drawnStroke() {
    const stroke = this.stroke ?? [];
    if (stroke.length < 2) return stroke;
    const [from, to] = [stroke[0], stroke[stroke.length - 1]];
    if (this.mode === "box") return [from, [to[0], from[1]], to, [from[0], to[1]], from];
    if (this.mode === "slab") return [from, to];
    return this.mode === "lasso" ? [...stroke, from] : stroke;
  }

  finish() {
    if (!this.stroke || !this.on) return;
    const shape = this.shape();
    this.stroke = null;
    this.line.setAttribute("points", "");
    if (!shape) {
      this.say("nothing was enclosed");
      return;
    }
    this.shapes.push({ shape, keeps: this.keeps });
    this.count();
  }

  /** The shape of the stroke. @returns {Shape | null} */
  shape() {
    if (!this.on || !this.stroke) return null;
    const { rows } = this.on;
    const corners = this.drawnStroke();
    if (this.mode === "brush") {
      return this.centres.length > 0 ? { shape: "brush", centres: this.centres, radius: this.radius } : null;
    }
    if (this.mode === "slab") {
      const ends = [corners[0], corners[corners.length - 1]].map((place) => this.touched(place, Infinity));
      if (!ends[0] || !ends[1]) return null;
      const { origin, direction } = longAxis(rows);
      const heights = ends.map((end) => direction.reduce((sum, d, k) => sum + d * (/** @type {number[]} */ (end)[k] - origin[k]), 0));
      const [from, to] = [Math.min(...heights), Math.max(...heights)];
      return from < to ? { shape: "slab", origin, direction, from, to } : null;
    }
    const outline = this.outline(corners.slice(0, -1));
    if (!outline || within({ keep: [outline], cut: [] }, rows).every((is) => is === 0)) return null;
    return this.mode === "box" ? boxAround(outline, rows) : outline;
  }

  /** What the view shows inside these places. @param {number[][]} places @returns {Outline | null} */
  outline(places) {
    if (places.length < 3) return null;
    const { holder } = this.scene;
    const camera = this.scene.perspective();
    camera.updateMatrixWorld();
    const axis = (/** @type {number} */ k) => new THREE.Vector3().setFromMatrixColumn(camera.matrixWorld, k).normalize().toArray();
    const eye = camera.position.toArray().map((c) => c / MM);
    const half = Math.tan((camera.fov * Math.PI) / 360);
    const [width, height] = [holder.clientWidth, holder.clientHeight];
    const corners = places.map(([x, y]) => [((2 * x) / width - 1) * half * camera.aspect, ((2 * y) / height - 1) * half]);
    return { shape: "outline", eye, right: axis(0), down: axis(1).map((c) => -c), corners };
  }

  /** The point of the cloud that is nearest to a place of the view. @param {number[]} place @param {number} limit pixels */
  touched(place, limit = TOUCH_PX) {
    if (!this.on) return null;
    const { rows } = this.on;
    const { holder } = this.scene;
    const camera = this.scene.perspective();
    camera.updateMatrixWorld();
    const matrix = new THREE.Matrix4().multiplyMatrices(camera.projectionMatrix, camera.matrixWorldInverse);
    const at = new THREE.Vector3();
    let best = limit;
    let found = null;
    for (let k = 0; k < rows.length; k += 3) {
      at.set(rows[k] * MM, rows[k + 1] * MM, rows[k + 2] * MM).applyMatrix4(matrix);
      const far = Math.hypot(((at.x + 1) / 2) * holder.clientWidth - place[0], ((1 - at.y) / 2) * holder.clientHeight - place[1]);
      if (at.z < 1 && far < best) {
        best = far;
        found = [rows[k], rows[k + 1], rows[k + 2]];
      }
    }
    return found;
  }

  /** @returns {import("./shapes.js").Region} */
  region() {
    const of = (/** @type {boolean} */ keeps) => this.shapes.filter((drawn) => drawn.keeps === keeps).map(({ shape }) => shape);
    return { keep: of(true), cut: of(false) };
  }

  /** Counts the points inside, and colours them. */
  count() {
    if (!this.on) return;
    const is = within(this.region(), this.on.rows);
    const { light } = this.on;
    const full = (/** @type {number} */ inside) => (this.shapes.length === 0 ? PLAIN : inside ? INSIDE : OUTSIDE);
    const colours = Float32Array.from(light, (share, k) => share * full(is[Math.floor(k / 3)])[k % 3]);
    this.on.object.geometry.setAttribute("color", new THREE.BufferAttribute(colours, 3));
    this.nInside = is.reduce((sum, inside) => sum + inside, 0);
    this.scene.redraw();
    this.show();
  }

  /** Takes the shapes of a file that was saved earlier, or says why not. @param {string} text @param {string} name */
  load(text, name) {
    if (!this.on) return;
    try {
      this.shapes = readRegion(text, this.on.frame);
      this.count();
    } catch (error) {
      this.say(`${name} is not loaded: ${error instanceof Error ? error.message : error}`);
    }
  }

  async save() {
    if (!this.on) return;
    const { node, frame, rows } = this.on;
    const drawn_on = { n_points: rows.length / 3, n_inside: this.nInside };
    const region = { format: "osteoflow-region", version: 1, units: "mm", frame, drawn_on, ...this.region() };
    try {
      const { message } = await post("region", { node, region });
      this.say(`region ${message}`);
      this.close();
    } catch (error) {
      this.say(error instanceof Error ? error.message : String(error));
    }
  }

  /** The buttons. */
  show() {
    this.panel.hidden = !this.on;
    if (!this.on) return this.panel.replaceChildren();
    const button = (/** @type {string} */ id, /** @type {string} */ text, /** @type {() => void} */ onclick, /** @type {boolean | null} */ pressed = null) => {
      const made = document.createElement("button");
      made.id = `region-${id}`;
      made.textContent = text;
      made.onclick = onclick;
      if (pressed !== null) made.setAttribute("aria-pressed", String(pressed));
      return made;
    };
    const row = (/** @type {(HTMLElement | string)[]} */ ...parts) => {
      const made = document.createElement("div");
      made.append(...parts);
      return made;
    };
    const modes = /** @type {Mode[]} */ (Object.keys(HINTS));
    const radius = document.createElement("input");
    Object.assign(radius, { type: "number", min: "0.5", max: "50", step: "0.5", value: String(this.radius) });
    radius.setAttribute("aria-label", "radius of the brush, mm");
    radius.onchange = () => { this.radius = Math.min(Math.max(Number(radius.value) || 4, 0.5), 50); };
    const counted = document.createElement("strong");
    counted.id = "region-count";
    counted.textContent = `${this.nInside} of ${this.on.rows.length / 3} points`;
    const hint = document.createElement("small");
    hint.textContent = HINTS[this.mode];
    const save = button("save", "save and run", () => this.save());
    save.disabled = this.shapes.length === 0 || this.nInside === 0;
    const focused = document.activeElement?.id;
    this.panel.replaceChildren(
      row(`region for ${this.on.node}: `, counted),
      row(...modes.map((mode) => button(mode, mode, () => this.setMode(mode), mode === this.mode)), ...(this.mode === "brush" ? [radius, " mm"] : [])),
      row(
        button("keep", "keep", () => { this.keeps = true; this.show(); }, this.keeps),
        button("cut", "cut away", () => { this.keeps = false; this.show(); }, !this.keeps),
        button("undo", "undo", () => { this.shapes.pop(); this.count(); }),
        button("camera", this.isBeforeCamera() ? "as the camera sees it" : "from outside", () => { this.look(); this.scene.redraw(); }),
      ),
      row(save, button("close", "close", () => this.close())),
      row(fileField("region-load", "saved earlier:", (text, name) => this.load(text, name))),
      hint,
    );
    if (focused) document.getElementById(focused)?.focus();
  }
}

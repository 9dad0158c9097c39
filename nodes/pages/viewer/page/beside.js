// The view beside that of the bone: scans that no pose connects to the bone yet, in their own frame; and while pairs are picked, the scan.

import * as THREE from "three";
import { shadeCloud, sideOf } from "./pick_view.js";
import { Scene, places, rendererIn } from "./scene.js";
import { longAxis } from "./shapes.js";

/** @typedef {import("./message.js").Item} Item */
/** @typedef {import("./frames.js").Frames} Frames */

export class Beside {
  /**
   * @param {Scene} main the view of the bone
   * @param {HTMLElement} holder
   */
  constructor(main, holder) {
    this.main = main;
    this.holder = holder;
    this.caption = /** @type {HTMLElement} */ (holder.querySelector(".caption"));
    this.view = /** @type {HTMLElement} */ (holder.querySelector(".view"));
    /** @type {Scene | null} */
    this.made = null;
    /** The last item of each cloud. @type {Map<string, Item>} */
    this.items = new Map();
    /** What is shown alone, with light and shade: the scan of pairs. @type {{wire: string, item: Item} | null} */
    this.picked = null;
    /** What was looked at last. */
    this.lookedAt = "";
    this.isNew = false;
  }

  /** The view, which is made when it is needed first: a browser holds few drawings at a time. */
  get scene() {
    if (!this.made) {
      this.made = new Scene(this.view, { worker: null, isOrthographic: false, renderer: rendererIn(this.view) });
      this.made.looksItself = false;
    }
    return this.made;
  }

  /** @param {string} wire @param {string} payload @param {Item} item */
  item(wire, payload, item) {
    if (payload !== "geometry/Cloud") return;
    if (item.empty) this.items.delete(wire);
    else this.items.set(wire, item);
  }

  clear() { this.items.clear(); }

  /** Shows a scan alone, to be picked on; null ends it. @param {{wire: string, item: Item} | null} picked */
  pick(picked) {
    if (picked?.wire === this.picked?.wire && picked?.item === this.picked?.item) return;
    this.picked = picked;
    this.lookedAt = "";
    this.made?.clear();
    // What is picked on is in its own coordinates.
    if (picked) this.scene.focus = { frame: String(picked.item.fields.frame), shows: () => true };
    else if (this.made) this.made.focus = null;
    this.main.redraw();
  }

  /** What no pose connects to the view of the bone, of what is shown: all that is in the frame of the first of it. @param {Frames} frames */
  loose(frames) {
    const root = this.main.rootOf(frames);
    const hasBone = [...this.main.drawn.values()].some(({ payload, shown }) => payload === "geometry/Mesh" && shown);
    if (!hasBone || this.main.focus || this.main.solo) return [];
    const loose = [...this.main.drawn].filter(([wire, { frame, payload, shown, unknown }]) =>
      payload === "geometry/Cloud" && shown && unknown === null && frames.root(frame) !== root && this.items.has(wire));
    const first = loose.map(([, { frame }]) => frames.root(frame))[0];
    return loose.filter(([, { frame }]) => frames.root(frame) === first).map(([wire]) => wire);
  }

  /** Before each frame: what is to be seen, and where. @param {Frames} frames */
  prepare(frames) {
    const wires = this.picked ? [] : this.loose(frames);
    const isOpen = this.picked !== null || wires.length > 0;
    const notes = wires.map((wire) => /** @type {const} */ ([wire, `not registered: shown beside the bone, in ${this.items.get(wire)?.fields.frame}`]));
    this.main.beside = this.picked ? new Map([[this.picked.wire, "shown beside the bone"]]) : new Map(notes);
    if (this.holder.hidden === isOpen) {
      this.holder.hidden = !isOpen;
      this.main.redraw();
    }
    if (!isOpen) return this.made?.clear();
    const { scene } = this;
    const shown = this.picked ? new Map([[this.picked.wire, this.picked.item]]) : new Map(wires.map((wire) => [wire, /** @type {Item} */ (this.items.get(wire))]));
    for (const wire of [...scene.drawn.keys()]) if (scene.drawn.get(wire)?.payload === "geometry/Cloud" && !shown.has(wire)) scene.remove(wire);
    for (const [wire, item] of shown) {
      if (scene.drawn.get(wire)?.object.userData.item === item) continue;
      scene.update(wire, "geometry/Cloud", item);
      const drawn = scene.drawn.get(wire);
      if (!drawn) continue;
      drawn.shown = true;
      // There is no surface to bring it before.
      Object.assign(drawn.object.userData, { item, forthMm: 0 });
      scene.redraw();
    }
    // Both views have the same colours.
    if (scene.colours.isOwn !== this.main.colours.isOwn) scene.colours.choose(this.main.colours.isOwn);
    if (this.picked) shadeCloud(scene, this.picked);
    const names = [...shown].map(([wire, { fields }]) => `${wire}, in ${fields.frame}`).join("; ");
    this.caption.textContent = this.picked ? `the scan: ${names}` : `not registered: ${names}`;
    const key = [...shown].map(([wire, { fields }]) => `${wire} ${frames.root(String(fields.frame))}`).join();
    if (key === this.lookedAt) return;
    if (this.lookedAt === "") scene.isTurned = false;
    this.lookedAt = key;
    if (!scene.isTurned) this.isNew = true;
  }

  /** Looks at the first scan from where it was made, its longest direction upwards. */
  look() {
    const [wire] = [...this.scene.drawn].find(([, { payload }]) => payload === "geometry/Cloud") ?? [""];
    const [drawn, item] = [this.scene.drawn.get(wire), this.picked?.item ?? this.items.get(wire)];
    if (!drawn || !item) return;
    this.scene.scene.updateMatrixWorld(true);
    const { towards, up } = sideOf(item);
    const turn = new THREE.Matrix4().extractRotation(drawn.object.matrixWorld);
    const from = new THREE.Vector3(...towards);
    const long = longAxis(/** @type {Float64Array} */ (item.columns.points.rows));
    const above = new THREE.Vector3(...up).projectOnPlane(from);
    const along = new THREE.Vector3(...long.direction).projectOnPlane(from);
    // A scan that is looked at along its longest direction stands as its camera does.
    const isUpright = long.isLong && along.length() > 0.5;
    if (isUpright && along.dot(above) < 0) along.negate();
    this.scene.fit(places(drawn), from.transformDirection(turn), (isUpright ? along : above).normalize().transformDirection(turn));
  }

  /** Turns what is shown upside down, as seen. */
  turnOver() {
    const { camera, controls } = this.scene;
    camera.up.negate();
    controls.update();
    this.scene.isTurned = true;
  }

  /** @param {Frames} frames */
  draw(frames) {
    if (this.holder.hidden || !this.made) return 0;
    const ms = this.made.draw(frames);
    // Where things are is known once they were drawn.
    if (!this.isNew) return ms;
    this.isNew = false;
    this.look();
    return ms + this.made.draw(frames);
  }
}

// What is shown and can be picked on: the plan of the run, the bone's surface and the scans, as they came.

import { NOTHING } from "./picks.js";
import { Surface } from "./surface.js";

/** @typedef {import("./message.js").Item} Item */
/** @typedef {import("./picks.js").Picked} Picked */

/** Wires of a plan, by what they carry. */
export const PARTS = ["landmarks", "assessment", "planes", "axes", "t_phantom_phantom_marker", "t_camera_camera_marker_nominal"];

export class Shown {
  /** @param {import("./scene.js").Scene} scene */
  constructor(scene) {
    this.scene = scene;
    /** Nodes that give plans. */
    this.planNodes = new Set(["plan"]);
    /** Last items of the wires of plans, of meshes and of clouds. @type {Map<string, Item>} */
    this.items = new Map();
    /** @type {{wire: string, item: Item, surface: Surface} | null} */
    this.built = null;
    /** The scan that was chosen, if there are several. @type {string | null} */
    this.chosen = null;
  }

  /** @param {{nodes: {name: string, kind: string}[]}} graph */
  graph({ nodes }) {
    const plans = nodes.filter(({ kind }) => kind.startsWith("plan."));
    if (plans.length > 0) this.planNodes = new Set(plans.map(({ name }) => name));
  }

  /**
   * Keeps an item, if it is of a kind that picking needs.
   * @param {string} wire @param {string} payload @param {Item} item
   * @returns {{isPart: boolean, isReplaced: boolean, isSeen: boolean} | null} of a plan; another surface than before; worth drawing again
   */
  add(wire, payload, item) {
    const isReport = payload === "report/Json" && [...this.planNodes].some((node) => wire === `${node}.report`);
    const isPart = isReport || PARTS.some((part) => wire.endsWith(`.${part}`));
    if (item.empty || !(isPart || payload === "geometry/Mesh" || payload === "geometry/Cloud")) return null;
    const isNew = !this.items.has(wire);
    this.items.set(wire, item);
    const isReplaced = payload === "geometry/Mesh" && this.isReplaced();
    return { isPart, isReplaced, isSeen: isNew || payload === "geometry/Mesh" || wire === this.cloud()?.wire };
  }

  /** The item of a part of the plan that is shown. @param {string} part */
  part(part) {
    for (const node of this.planNodes) {
      const item = this.items.get(`${node}.${part}`);
      if (item) return item;
    }
    return null;
  }

  /** The points and planes of the plan that is shown. @returns {Picked} */
  picked() {
    const points = (/** @type {Item | null} */ item) => {
      if (!item?.columns.positions) return [];
      const rows = /** @type {Float64Array} */ (item.columns.positions.rows);
      const names = String(item.fields.names).split("\n");
      return Array.from({ length: rows.length / 3 }, (_, k) => ({ name: names[k], position: [...rows.subarray(3 * k, 3 * k + 3)] }));
    };
    // Landmarks that were moved after the procedure located them: the report has where they are planned now.
    const now = JSON.parse(String(this.part("report")?.fields.json ?? "{}")).planned_landmarks;
    const moved = now && Object.entries(now).map(([name, position]) => ({ name, position: /** @type {number[]} */ (position) }));
    const item = this.part("planes");
    const rows = /** @type {Float64Array} */ (item?.columns.isometries?.rows ?? new Float64Array(0));
    const names = String(item?.fields.names ?? "").split("\n");
    const planes = Array.from({ length: rows.length / 7 }, (_, k) => ({
      name: names[k],
      origin: [...rows.subarray(7 * k, 7 * k + 3)],
      rotation: [...rows.subarray(7 * k + 3, 7 * k + 7)],
    }));
    return {
      ...NOTHING,
      landmarks: moved ?? points(this.part("landmarks")),
      assessment: points(this.part("assessment")),
      planes: planes.filter(({ origin }) => origin.every(Number.isFinite)),
    };
  }

  /** The bone's surface: that of the plan's frame, and never the phantom's. @returns {{wire: string, item: Item} | null} */
  bone() {
    const frame = this.part("landmarks")?.fields.frame;
    const meshes = [...this.items].filter(([wire, { columns, fields }]) => columns.faces && !/(^|\.)phantom/.test(wire) && fields.frame !== "phantom");
    const found = meshes.find(([, { fields }]) => fields.frame === frame) ?? meshes.find(([wire]) => wire === this.scene.surface) ?? meshes[0];
    return found ? { wire: found[0], item: found[1] } : null;
  }

  /** @returns {Surface | null} */
  surface() {
    const bone = this.bone();
    if (!bone) return null;
    if (this.built?.item !== bone.item) {
      const { vertices, faces } = bone.item.columns;
      this.built = { ...bone, surface: new Surface(/** @type {Float64Array} */ (vertices.rows), /** @type {Uint32Array} */ (faces.rows)) };
    }
    return this.built.surface;
  }

  /** Whether the surface that was asked is another one now; the same one that came again is none. */
  isReplaced() {
    const bone = this.bone();
    if (!this.built || !bone || bone.item === this.built.item) return false;
    const same = (/** @type {string} */ column) => {
      const [a, b] = [bone.item, /** @type {any} */ (this.built).item].map((item) => item.columns[column].rows);
      return a.length === b.length && a.every((/** @type {number} */ x, /** @type {number} */ k) => x === b[k]);
    };
    if (bone.wire === this.built.wire && same("vertices") && same("faces")) {
      this.items.set(bone.wire, this.built.item);
      return false;
    }
    this.built = null;
    return true;
  }

  /** The scans that can be picked on. @returns {string[]} */
  clouds() {
    return [...this.items].filter(([wire, { columns }]) => columns.points && !columns.faces && !/phantom|laser/.test(wire)).map(([wire]) => wire);
  }

  forgetClouds() { for (const wire of this.clouds()) this.items.delete(wire); }

  /** @returns {{wire: string, item: Item} | null} */
  cloud() {
    const all = this.clouds();
    const wire = this.chosen && all.includes(this.chosen) ? this.chosen : all.find((wire) => !wire.startsWith("recording.")) ?? all[0];
    const item = wire === undefined ? undefined : this.items.get(wire);
    return item ? { wire, item } : null;
  }

  /** What of the shown plan is not picked. */
  rest() {
    const axes = this.part("axes");
    const pose = (/** @type {string} */ part) => /** @type {number[] | null} */ (this.part(part)?.fields.isometry ?? null);
    return {
      axes: axes ? { centre: /** @type {number[]} */ (axes.fields.centre), columns: /** @type {number[]} */ (axes.fields.columns) } : null,
      phantomMarker: pose("t_phantom_phantom_marker"),
      cameraMarker: pose("t_camera_camera_marker_nominal"),
    };
  }
}

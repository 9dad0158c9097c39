// What is shown: an item of a wire goes to the frames or into the view, and a list has each layer with why it is not drawn.

/** @typedef {import("./message.js").Item} Item */
/** @typedef {import("./scene.js").Scene} Scene */

/**
 * Shows an item of a wire.
 * @param {{scene: Scene, frames: import("./frames.js").Frames}} view
 * @param {string} wire
 * @param {string} payload
 * @param {Item} item
 */
export function showItem({ scene, frames }, wire, payload, item) {
  if (payload !== "geometry/Pose") return scene.update(wire, payload, item);
  if (item.empty) frames.unknown.set(wire, item.empty.reason);
  else frames.unknown.delete(wire);
  scene.redraw();
}

/** The list of what can be shown, with why something is not. */
export class LayerList {
  /** @param {HTMLElement} holder @param {Scene} scene @param {(wire: string) => string | null} ageOf */
  constructor(holder, scene, ageOf = () => null) {
    this.ageOf = ageOf;
    this.holder = holder;
    this.scene = scene;
    this.listed = "";
  }

  draw() {
    for (const age of /** @type {NodeListOf<HTMLElement>} */ (this.holder.querySelectorAll("[data-age]"))) age.textContent = this.ageOf(age.dataset.age ?? "");
    const rows = [...this.scene.drawn].map(([wire, { shown, object }]) => ({
      wire, shown, why: object.userData.why ?? null, note: object.userData.note ?? null, hasAge: this.ageOf(wire) !== null,
    }));
    rows.sort((a, b) => (a.wire < b.wire ? -1 : 1));
    const key = JSON.stringify(rows);
    if (key === this.listed) return;
    this.listed = key;
    this.holder.replaceChildren(...rows.map((row) => this.entry(row)));
  }

  /** @param {{wire: string, shown: boolean, why: string | null, note: string | null, hasAge: boolean}} row */
  entry({ wire, shown, why, note, hasAge }) {
    const entry = document.createElement("li");
    const name = document.createElement("label");
    const box = document.createElement("input");
    box.type = "checkbox";
    box.dataset.wire = wire;
    box.checked = shown;
    box.onchange = () => this.scene.choose(wire, box.checked);
    name.append(box, ` ${wire}`);
    entry.append(name);
    if (hasAge) {
      const age = document.createElement("small");
      age.dataset.age = wire;
      entry.append(age);
    }
    const said = note ?? why;
    if (said !== null) {
      entry.className = note === null ? "hidden" : "beside";
      const reason = document.createElement("small");
      reason.textContent = said;
      entry.append(reason);
    }
    return entry;
  }
}

// The panel of what is picked: points with their rulers, planes with their sliders, what the next click does, saving.

import { fileField } from "./load.js";
import { MAX_DEG, N_NEEDED, height, placing, sides } from "./picks.js";
import { norm, minus } from "./surface.js";
import { may, whatNot } from "./request.js";

/** @typedef {import("./pick.js").Picking} Picking */
/** @typedef {import("./picks.js").Group} Group */
/** @typedef {import("./picks.js").Picked} Picked */

/** What a next click does. @type {Record<Group, string>} */
const NEXT = {
  landmarks: "click the bone to set a landmark",
  assessment: "click the bone to set an assessment point",
  tip: "click the tip of the malleolus",
  bone: "click a place on the bone, and the same place on the scan",
  scan: "click a place on the bone, and the same place on the scan",
};
/** A shape for each group, as its marks have. @type {Record<Group, string>} */
const SHAPES = { landmarks: "\u25cb", assessment: "\u25a1", tip: "\u25b3", bone: "\u25cb", scan: "\u25cb" };

/**
 * @template {keyof HTMLElementTagNameMap} T
 * @param {T} tag
 * @param {Record<string, any>} properties
 * @param {(Node | string)[]} children
 * @returns {HTMLElementTagNameMap[T]}
 */
function make(tag, properties, ...children) {
  const made = Object.assign(document.createElement(tag), properties);
  made.append(...children);
  return made;
}

export class Panel {
  /**
   * @param {Picking} picking
   * @param {HTMLElement} holder
   */
  constructor(picking, holder) {
    this.picking = picking;
    const button = (/** @type {string} */ text, /** @type {() => void} */ onclick, title = "") => make("button", { textContent: text, onclick, title });
    /** The planes whose rows are shown, and what names their angles. */
    this.planeNames = "";
    this.plan = button("pick on the bone", () => picking.enter(picking.mode === "plan" ? null : "plan"), "key p");
    this.pairs = button("pick pairs", () => picking.enter(picking.mode === "pairs" ? null : "pairs"), "the same points on the bone and on the scan");
    this.plan.id = "pick-plan";
    this.pairs.id = "pick-pairs";
    this.next = make("p", { id: "pick-next", role: "status" });
    this.problem = make("p", { id: "pick-problem", role: "alert", hidden: true });
    this.result = make("div", { id: "pick-saved", role: "status", hidden: true });
    this.undo = button("undo", () => picking.undo(), "Ctrl-Z");
    this.redo = button("redo", () => picking.redo(), "Ctrl-Shift-Z");
    this.remove = button("delete", () => picking.remove(), "Delete");
    this.adds = make("div", { className: "row" });
    this.points = make("ul", { id: "pick-points" });
    this.rulers = make("dl", { id: "pick-rulers" });
    this.planes = make("div", { id: "pick-planes" });
    this.save = button("save", () => void picking.save());
    this.save.id = "pick-save";
    this.where = make("small", {});
    this.body = make("div", { hidden: true }, this.adds, this.next, this.problem, make("div", { className: "row" }, this.undo, this.redo, this.remove),
      this.points, this.rulers, this.planes, this.save, this.where);
    holder.append(make("div", { className: "row" }, this.plan, this.pairs), this.body, this.result);
  }

  /** @param {string} text what went wrong; nothing if all is well */
  say(text) {
    this.problem.textContent = text;
    this.problem.hidden = text === "";
    if (text !== "") this.result.hidden = true;
    // Without a mode the body is hidden.
    this.body.hidden = this.picking.mode === null && text === "";
  }

  /** @param {string} message @param {string[]} files */
  saved(message, files) {
    this.say("");
    this.result.hidden = false;
    // The message names the folder.
    const names = files.map((file) => file.split(/[\\/]/).pop() ?? file);
    this.result.replaceChildren(message, make("ul", {}, ...names.map((name) => make("li", { textContent: name }))));
  }

  update() {
    const { picking } = this;
    const { mode, history } = picking;
    this.plan.setAttribute("aria-pressed", String(mode === "plan"));
    this.pairs.setAttribute("aria-pressed", String(mode === "pairs"));
    this.pairs.hidden = picking.clouds().length === 0;
    this.body.hidden = mode === null;
    picking.scene.holder.classList.toggle("takes", mode !== null && picking.takes("bone") !== null);
    picking.beside.view.classList.toggle("takes", mode !== null && picking.takes("scan") !== null);
    if (mode === null) return;
    this.undo.disabled = history.before.length === 0;
    this.redo.disabled = history.after.length === 0;
    this.remove.disabled = picking.selected === null && picking.selectedPlane === null;
    this.next.textContent = this.whatNext();
    this.save.disabled = !may("write");
    this.save.textContent = picking.runsWith() ? "save and run" : mode === "pairs" ? "save the pairs" : "save the plan";
    const { known } = picking;
    this.where.textContent = !may("write") ? whatNot() : known?.folder ? `a new folder in ${known.folder} each time` : known === null ? "nothing can be saved here; open the run with osteoflow view" : "";
    this.updateAdds();
    // What is typed or moved now is not replaced under the hand.
    const active = document.activeElement;
    if (!(active instanceof HTMLInputElement && this.points.contains(active))) {
      this.points.replaceChildren(...(mode === "pairs" ? this.pairRows() : this.pointRows()));
    }
    this.rulers.replaceChildren(...this.rulerRows());
    this.updatePlanes();
  }

  whatNext() {
    const { picking } = this;
    const { armed, history, mode } = picking;
    const warning = picking.warning ? `${picking.warning}. ` : "";
    const fault = picking.fault();
    if (mode === "pairs" && (picking.takes("bone") || picking.takes("scan"))) {
      const [onBone, onScan] = [picking.waiting("bone"), picking.waiting("scan")];
      const next = onScan.length > 0 ? `click ${onScan[0].name} on the scan` : onBone.length > 0 ? `click ${onBone[0].name} on the bone` : NEXT.bone;
      return `${warning}${next}; ${picking.nPairs()} of ${N_NEEDED} pairs; drag turns the view`;
    }
    if (armed) return `${warning}${NEXT[armed]}; drag turns the view${fault ? ` (${fault})` : ""}`;
    if (fault) return `${warning}${fault}`;
    const rest = mode === "pairs" ? "drag a mark to move it, save when the sides agree" : "drag a mark to move it, arrow keys move the selected one";
    return `${warning}${history.isEdited ? "" : "as shown; "}${rest}`;
  }

  updateAdds() {
    const { picking } = this;
    const arm = (/** @type {Group} */ group, /** @type {string} */ text) => {
      const made = make("button", { textContent: text, onclick: () => picking.arm(picking.armed === group ? null : group) });
      made.dataset.group = group;
      made.setAttribute("aria-pressed", String(picking.armed === group));
      return made;
    };
    if (picking.mode === "pairs") {
      const all = picking.clouds();
      const choice = make("select", { onchange: (/** @type {Event} */ event) => picking.chooseCloud(/** @type {HTMLSelectElement} */ (event.target).value) },
        ...all.map((wire) => make("option", { textContent: wire, selected: wire === picking.cloud()?.wire })));
      choice.setAttribute("aria-label", "the scan");
      const over = make("button", { textContent: "turn the scan over", title: "upside down, as seen", onclick: () => picking.beside.turnOver() });
      this.adds.replaceChildren(arm("bone", "+ pair"), over, ...(all.length > 1 ? [choice] : []));
      return;
    }
    const again = make("button", { textContent: "as shown", title: "take the plan that is shown", onclick: () => picking.again() });
    this.adds.replaceChildren(arm("landmarks", "+ landmark"), arm("assessment", "+ assessment"), arm("tip", "malleolus tip"),
      make("button", { textContent: "+ plane", onclick: () => picking.addPlane() }), ...(picking.shown.picked().landmarks.length > 0 ? [again] : []),
      fileField("pick-load", "saved earlier:", (text, name) => picking.load(text, name)));
  }

  /** @param {Group} group @param {string} name @param {(string | Node)[]} texts */
  row(group, name, ...texts) {
    const { picking } = this;
    // Of a pair both points are.
    const isSelected = picking.selected?.name === name && (picking.mode === "pairs" || picking.selected.group === group);
    const select = make("button", { className: "shape", textContent: SHAPES[group], title: "select", onclick: () => picking.select(group, name) });
    select.setAttribute("aria-label", `select ${name}`);
    select.setAttribute("aria-pressed", String(isSelected));
    const label = make("input", { value: name, title: name, readOnly: group === "tip", onchange: () => picking.rename(group, name, label.value) });
    label.setAttribute("aria-label", "name");
    label.onkeydown = (event) => {
      if (event.key === "Enter") label.blur();
    };
    const look = make("button", { textContent: "show", title: "look at it from outside the bone", onclick: () => picking.lookAt(group, name) });
    const row = make("li", { className: isSelected ? "selected" : "" }, select, label, ...(group === "scan" ? [] : [look]), ...texts);
    row.dataset.name = name;
    return row;
  }

  pointRows() {
    const { picking } = this;
    const [of, surface] = [picking.bearings(), picking.surface()];
    if (!of || !surface) return [];
    return /** @type {Group[]} */ (["landmarks", "assessment", "tip"]).flatMap((group) =>
      picking.history.now[group].map(({ name, position }) => {
        const mm = of.tip && group !== "tip" ? `${height(of, position).toFixed(1)} mm` : "";
        const off = surface.closest(position)?.distance ?? Infinity;
        const place = `L ${position[0].toFixed(2)} P ${position[1].toFixed(2)} S ${position[2].toFixed(2)}`;
        const away = off > 0.05 ? `, ${off.toFixed(2)} mm off the surface` : "";
        return this.row(group, name, make("output", { textContent: mm, title: "above the tip of the malleolus, along the bone" }), make("small", { textContent: place + away }));
      }),
    );
  }

  pairRows() {
    const { now } = this.picking.history;
    const names = [...new Set([...now.bone, ...now.scan].map(({ name }) => name))];
    return names.map((name) => {
      const on = (/** @type {"bone" | "scan"} */ side) => {
        const pick = now[side].find((pick) => pick.name === name);
        return pick ? `${side} ${pick.position.map((c) => c.toFixed(2)).join(" ")}` : `not yet on the ${side}`;
      };
      const group = now.bone.some((pick) => pick.name === name) ? "bone" : "scan";
      return this.row(group, name, make("small", { textContent: `${on("bone")}; ${on("scan")}` }));
    });
  }

  rulerRows() {
    const { picking } = this;
    const { now } = picking.history;
    const of = picking.bearings();
    if (!of) return [];
    const line = (/** @type {string} */ term, /** @type {string} */ text) => [make("dt", { textContent: term }), make("dd", { textContent: text })];
    if (picking.mode === "pairs") {
      return sides(now.bone, of.along).flatMap(({ from, to, mm }) => {
        const [a, b] = [from, to].map(({ name }) => now.scan.find((pick) => pick.name === name));
        if (!a || !b) return [];
        const other = norm(minus(b.position, a.position));
        return line(`${from.name} to ${to.name} (bone, scan)`, `${mm.toFixed(1)}, ${other.toFixed(1)} mm`);
      });
    }
    const source = of.tip ? (now.tip.length > 0 ? "tip as picked" : "tip of the plan") : "no tip of the malleolus: pick it for heights";
    const rows = now.landmarks.length > 0 && of.tip ? line(`tip to ${now.landmarks[0].name}, along the bone`, `${height(of, now.landmarks[0].position).toFixed(1)} mm`) : [];
    for (const { from, to, mm, along } of sides(now.landmarks.slice(0, 3), of.along)) {
      rows.push(...line(`${from.name} to ${to.name} (along the bone)`, `${mm.toFixed(1)} (${Math.abs(along).toFixed(1)}) mm`));
    }
    return [...rows, make("small", { textContent: `${source}; along the bone: ${of.says}; coordinates are LPS, mm` })];
  }

  updatePlanes() {
    const { picking } = this;
    const { planes } = picking.history.now;
    const [of, surface] = [picking.bearings(), picking.surface()];
    if (picking.mode === "pairs" || !of || !surface) return this.planes.replaceChildren();
    const names = JSON.stringify([planes.map(({ name }) => name), of.names, of.tip !== null]);
    if (names !== this.planeNames) {
      this.planeNames = names;
      this.planes.replaceChildren(...planes.map(({ name }) => this.planeRow(name)));
    }
    const [low, high] = surface.extent(of.along).map((mm) => mm - (of.tip ? of.tip.reduce((sum, c, k) => sum + c * of.along[k], 0) : 0));
    planes.forEach((plane, k) => {
      const { mm, deg, cuts } = placing(plane, of, surface);
      const row = /** @type {HTMLElement} */ (this.planes.children[k]);
      row.classList.toggle("selected", picking.selectedPlane === plane.name);
      row.querySelector("em")?.replaceChildren(cuts ? "" : "does not meet the bone");
      row.querySelectorAll("input[data-key]").forEach((part) => {
        const input = /** @type {HTMLInputElement} */ (part);
        const value = input.dataset.key === "mm" ? mm : deg[Number(input.dataset.key)];
        if (input.dataset.key === "mm") [input.min, input.max] = [low.toFixed(1), high.toFixed(1)];
        if (input !== document.activeElement || input.type === "range") input.value = value.toFixed(2).replace(/^-(?=0\.0+$)/, "");
      });
    });
  }

  /** @param {string} name */
  planeRow(name) {
    const { picking } = this;
    const of = picking.bearings();
    const choose = () => {
      if (picking.selectedPlane === name) return;
      picking.selected = null;
      picking.selectedPlane = name;
      picking.changed();
    };
    /** What was before a slider moved. @type {Picked | null} */
    let from = null;
    const set = (/** @type {string} */ key, /** @type {number} */ value, /** @type {Picked | null} */ before) => {
      const plane = picking.history.now.planes.find((plane) => plane.name === name);
      const [bearings, surface] = [picking.bearings(), picking.surface()];
      if (!plane || !bearings || !surface || !Number.isFinite(value)) return;
      if (key === "mm") return picking.placePlane(name, { mm: value }, before);
      const deg = placing(plane, bearings, surface).deg;
      deg[Number(key)] = value;
      picking.placePlane(name, { deg }, before);
    };
    const inputs = (/** @type {string} */ key, /** @type {string} */ text, /** @type {string} */ unit) => {
      const limits = key === "mm" ? { step: "any" } : { step: "any", min: String(-MAX_DEG), max: String(MAX_DEG) };
      const range = make("input", { type: "range", ...limits, onfocus: choose });
      range.oninput = () => {
        choose();
        from ??= picking.history.now;
        set(key, Number(range.value), from);
      };
      range.onchange = () => {
        if (from) picking.history.settle(from, picking.history.now);
        from = null;
        picking.changed();
      };
      const number = make("input", { type: "number", ...limits, onfocus: choose, onchange: () => set(key, number.value === "" ? NaN : Number(number.value), null) });
      for (const input of [range, number]) {
        input.dataset.key = key;
        input.setAttribute("aria-label", `${text}, ${unit}`);
      }
      return make("label", {}, make("span", { textContent: text }), number, unit, range);
    };
    const label = make("input", { value: name, onfocus: choose, onchange: () => picking.renamePlane(name, label.value) });
    label.setAttribute("aria-label", "name of the plane");
    const where = of?.tip ? "above the tip" : "along the bone";
    const row = make("fieldset", {}, make("div", { className: "row" }, label, make("em", {})), inputs("mm", where, "mm"),
      inputs("0", `leans ${of?.names[0]}`, "\u00b0"), inputs("1", `leans ${of?.names[1]}`, "\u00b0"));
    row.dataset.name = name;
    row.onpointerdown = choose;
    return row;
  }
}

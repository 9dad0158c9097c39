// Picking by hand: its modes, what is selected, every change of what is picked, and saving it.

import * as THREE from "three";
import { Aim } from "./aim.js";
import { MM } from "./drawables.js";
import { Gestures } from "./gestures.js";
import { drawPlanes, drawPoints, drawRulers } from "./marks.js";
import { readPlan } from "./load.js";
import { Panel } from "./pick_panel.js";
import { lookFrom } from "./pick_view.js";
import { History, N_NEEDED, bearings, isSamePlan, nextName, normalOf, placed, planeAcross, planJson } from "./picks.js";
import { post } from "./request.js";
import { extent } from "./shade.js";
import { PARTS, Shown } from "./shown_plan.js";
import { dot, minus, norm, plus, unit } from "./surface.js";

/** @typedef {import("./message.js").Item} Item */
/** @typedef {import("./picks.js").Picked} Picked */
/** @typedef {import("./picks.js").Pick} Pick */
/** @typedef {import("./picks.js").Group} Group */
/** @typedef {import("./surface.js").Vector} Vector */

/** Distance from the surface above which a point is not on it, mm: as of `register`. */
export const OFF_MM = 2;
/** Height of the view when it shows a point, mm. */
const NEAR_MM = 70;
/** Shortest side on which its length is written, pixels. */
const ROOM_PX = 70;
/** The names under which marks are in the list of what is shown. */
const MARKS = { bone: "picked on the bone", scan: "picked on the scan" };
const CHANGED = "the plan that is shown has changed; what was picked is kept";
const LETTERS = { landmarks: "P", assessment: "M", tip: "malleolus tip", bone: "P", scan: "P" };

export class Picking {
  /**
   * @param {import("./scene.js").Scene} scene of the bone
   * @param {import("./beside.js").Beside} beside the view of the scan, while pairs are picked
   * @param {HTMLElement} holder of the panel
   */
  constructor(scene, beside, holder) {
    this.scene = scene;
    this.beside = beside;
    /** @type {"plan" | "pairs" | null} */
    this.mode = null;
    /** What the next click sets; of pairs one more than are needed, on either side. @type {Group | null} */
    this.armed = null;
    /** @type {{group: Group, name: string} | null} */
    this.selected = null;
    /** @type {string | null} */
    this.selectedPlane = null;
    this.history = new History();
    this.shown = new Shown(scene);
    this.aim = new Aim(scene, this.shown);
    /** @type {Aim | null} */
    this.aimOnScan = null;
    /** What the server knows of the plan besides, where it saves, and what it then runs with; null if it saves nothing. @type {{folder?: string, plan?: any, runs?: string[]} | null | undefined} */
    this.known = undefined;
    /** The plan that was shown when picking began, as text. */
    this.base = "";
    this.warning = "";
    /** @type {Map<string, {position: import("three").Vector3, up: import("three").Vector3, target: import("three").Vector3}>} */
    this.views = new Map();
    /** @type {{position: Vector, sprites: import("three").Sprite[]}[]} */
    this.marks = [];
    /** @type {{from: Vector, to: Vector, sprite: import("three").Sprite}[]} */
    this.lengths = [];
    this.isDirty = false;
    this.camera = "";
    this.panel = new Panel(this, holder);
    this.gestures = [new Gestures(this, "bone", scene.holder), new Gestures(this, "scan", beside.view)];
  }

  /** Whether another tool has the view. */
  isBlocked() { return this.scene.solo !== null; }

  /** Asks the server, the first time, where it saves and what it knows of the plan. */
  async ask() {
    if (this.known !== undefined) return;
    this.known = null;
    const answer = await fetch(new URL("picks", new URL(".", location.href))).catch(() => null);
    if (answer?.ok) this.known = await answer.json();
    this.changed();
  }

  // What is shown.

  /** @param {{nodes: {name: string, kind: string}[]}} graph */
  graph(graph) {
    this.shown.graph(graph);
    this.follow();
  }

  /** @param {string} wire @param {string} payload @param {Item} item */
  item(wire, payload, item) {
    const added = this.shown.add(wire, payload, item);
    if (!added) return;
    if (added.isPart) this.follow();
    if (added.isReplaced && (this.mode || this.history.isEdited)) this.warning = "the surface was replaced by another; look at each point again";
    if (added.isSeen) this.changed();
  }

  /** Scans that were shown before the recording jumped or another run began are not picked on any more, but for that under the hand. */
  forget() {
    if (this.mode) return;
    this.shown.forgetClouds();
    this.changed();
  }

  bone() { return this.shown.bone(); }
  surface() { return this.shown.surface(); }
  cloud() { return this.shown.cloud(); }
  clouds() { return this.shown.clouds(); }

  /** Takes the plan that is shown, unless something was picked by hand. */
  follow() {
    const shown = this.shown.picked();
    const text = JSON.stringify(shown);
    if (text === this.base) return;
    if (isSamePlan(shown, this.history.now)) {
      // A run with what was picked shows it.
      this.base = text;
      if (this.warning === CHANGED) this.warning = "";
    } else if (this.history.isEdited) {
      this.warning = CHANGED;
    } else {
      this.base = text;
      this.history.reset(shown);
    }
    this.changed();
  }

  /** Takes the plan that is shown instead of what was picked; can be undone. */
  again() {
    const { bone, scan } = this.history.now;
    const shown = this.shown.picked();
    this.base = JSON.stringify(shown);
    this.warning = "";
    this.history.set({ ...shown, bone, scan });
    this.changed();
  }

  /** Takes the points and planes of a plan's file instead of what was picked, or says why not; can be undone. @param {string} text @param {string} name */
  load(text, name) {
    try {
      const { bone, scan } = this.history.now;
      const { tip, ...plan } = readPlan(text);
      this.history.set({ ...plan, tip: this.anatomy() ? [] : tip, bone, scan });
      this.warning = "";
    } catch (error) {
      this.warning = `${name} is not loaded: ${error instanceof Error ? error.message : error}`;
    }
    this.changed();
  }

  /** @param {string} wire */
  chooseCloud(wire) {
    this.shown.chosen = wire;
    if (this.mode === "pairs") this.focus();
    this.changed();
  }

  /** @returns {any} */
  anatomy() { return this.known?.plan?.malleolus_tip ? this.known.plan : null; }

  /** @returns {import("./picks.js").Bearings | null} */
  bearings() {
    const surface = this.surface();
    if (!surface) return null;
    return bearings(this.anatomy(), this.shown.rest().axes?.columns ?? null, surface, this.history.now.tip[0]?.position ?? null);
  }

  // Modes.

  /** @param {"plan" | "pairs" | null} mode */
  enter(mode) {
    if (mode && !this.surface()) return this.say("no surface of a bone is shown yet; nothing can be picked");
    if (mode === "pairs" && !this.cloud()) return this.say("no scan is shown yet; pairs cannot be picked");
    void this.ask();
    this.keepView();
    // On a narrow screen the list is below.
    if (mode) this.scene.holder.scrollIntoView({ block: "nearest" });
    this.mode = mode;
    this.selected = null;
    this.selectedPlane = null;
    this.cancel();
    this.arm(mode === "plan" && this.history.now.landmarks.length < N_NEEDED ? "landmarks" : null);
    this.focus();
    this.changed();
  }

  /** Ends drags without a change. */
  cancel() { for (const hand of this.gestures) hand.cancel(); }

  /** Shows what is picked on alone, in its own coordinates: of pairs the scan beside the bone. */
  focus() {
    const [bone, cloud] = [this.bone(), this.cloud()];
    for (const name of Object.values(MARKS)) this.scene.remove(name);
    this.beside.pick(this.mode === "pairs" ? cloud : null);
    if (this.mode === null || !bone) {
      this.scene.focus = null;
    } else {
      const shows = (/** @type {string} */ wire) => (this.mode === "pairs" ? wire === bone.wire || wire === MARKS.bone : PARTS.every((part) => !wire.endsWith(`.${part}`)));
      this.scene.focus = { frame: String(bone.item.fields.frame), shows };
      const drawn = this.scene.drawn.get(bone.wire);
      if (drawn) drawn.shown = true;
    }
    const view = this.views.get(this.viewName());
    if (view) {
      this.scene.camera.position.copy(view.position);
      this.scene.camera.up.copy(view.up);
      this.scene.controls.target.copy(view.target);
      this.scene.controls.update();
    } else if (this.mode === null || !this.lookAtLandmarks()) {
      this.scene.isLookedAt = false;
    }
    this.scene.redraw();
  }

  viewName() { return this.mode === null ? "all" : "bone"; }

  keepView() {
    const { camera, controls } = this.scene;
    if (!this.scene.isLookedAt) return;
    this.views.set(this.viewName(), { position: camera.position.clone(), up: camera.up.clone(), target: controls.target.clone() });
  }

  /** Shows the whole bone from the side on which the landmarks are; false if there are none, or they are all around it. */
  lookAtLandmarks() {
    const [surface, of] = [this.surface(), this.bearings()];
    if (!surface || !of) return false;
    const { centre, size } = extent(surface.vertices);
    const out = this.history.now.landmarks.reduce((sum, { position }) => {
      const middle = surface.section(position, of.along)?.middle;
      return middle ? plus(sum, unit(minus(position, middle))) : sum;
    }, [0, 0, 0]);
    const across = plus(out, of.along, -dot(out, of.along));
    if (norm(across) < 0.3) return false;
    this.lookFrom(centre, unit(across), 1.05 * norm(size), of.along);
    return true;
  }

  /** @param {Vector} at mm @param {Vector} from a direction @param {number} mm what the view shows of it @param {Vector} up */
  lookFrom(at, from, mm, up) { lookFrom(this.scene, at, from, mm, up); }

  /** Shows a point from outside the bone. @param {Group} group @param {string} name */
  lookAt(group, name) {
    const pick = this.history.now[group].find((pick) => pick.name === name);
    const [surface, of] = [this.surface(), this.bearings()];
    if (!pick || !surface || !of) return;
    this.select(group, name);
    if (group === "scan" || this.mode === "pairs") {
      const on = this.history.now.scan.find((pick) => pick.name === name);
      if (on) this.beside.scene.controls.centre(new THREE.Vector3(...on.position).multiplyScalar(MM));
    }
    if (group === "scan") return;
    const middle = surface.section(pick.position, of.along)?.middle;
    const hit = surface.closest(pick.position);
    const out = middle ? minus(pick.position, middle) : surface.normal(hit?.face ?? 0);
    this.lookFrom(pick.position, unit(out), NEAR_MM, of.along);
  }

  /** @param {Group | null} group what the next click sets */
  arm(group) {
    this.armed = group;
    this.changed();
  }

  /** Points that lack their counterpart on the other side. @param {"bone" | "scan"} side */
  waiting(side) {
    const { bone, scan } = this.history.now;
    const [own, other] = side === "bone" ? [bone, scan] : [scan, bone];
    return other.filter(({ name }) => own.every((pick) => pick.name !== name));
  }

  /** Pairs of which both points are picked. */
  nPairs() { return this.history.now.bone.length - this.waiting("scan").length; }

  /** What a click sets in the view of the bone or of the scan. @param {"bone" | "scan"} side @returns {Group | null} */
  takes(side) {
    if (this.mode !== "pairs") return side === "bone" ? this.armed : null;
    const isMore = this.armed !== null || this.history.now[side].length < N_NEEDED || this.waiting(side).length > 0;
    return isMore ? side : null;
  }

  /** The view in which points of a group are. @param {Group} group */
  sceneOf(group) { return group === "scan" ? this.beside.scene : this.scene; }

  /** @param {Group} group */
  aimOf(group) { return group === "scan" ? (this.aimOnScan ??= new Aim(this.beside.scene, this.shown)) : this.aim; }

  /** Groups whose points are in a view. @param {"bone" | "scan"} side @returns {Group[]} */
  groups(side) { return this.mode === "pairs" ? [side] : side === "bone" ? ["landmarks", "assessment", "tip"] : []; }

  /** The mark under a place of the window. @param {"bone" | "scan"} side @param {number} x @param {number} y @param {number} px */
  markAt(side, x, y, px) {
    let best = px;
    /** @type {{group: Group, pick: Pick, at: number[]} | null} */
    let found = null;
    for (const group of this.groups(side)) {
      const aim = this.aimOf(group);
      for (const pick of this.history.now[group]) {
        const at = aim.onScreen(pick.position);
        const off = at ? Math.hypot(at[0] - x, at[1] - y) : Infinity;
        if (at && off < best && !aim.isHidden(pick.position, group === "scan")) {
          best = off;
          found = { group, pick, at };
        }
      }
    }
    return found;
  }

  /** @param {Group} group @param {Vector} position */
  add(group, position) {
    const { now } = this.history;
    if (group === "tip") {
      this.history.set({ ...now, tip: [{ name: LETTERS.tip, position }] });
      this.select("tip", LETTERS.tip);
      return this.arm(null);
    }
    const other = group === "bone" ? now.scan : group === "scan" ? now.bone : [];
    // The name that the other side of a pair waits with.
    const waiting = other.find(({ name }) => now[group].every((pick) => pick.name !== name));
    const taken = [...now[group], ...other, ...(group === "landmarks" ? now.assessment : group === "assessment" ? now.landmarks : [])];
    const name = waiting?.name ?? nextName(taken, LETTERS[group]);
    const order = group === "landmarks" ? (/** @type {Pick[]} */ all) => all.sort((a, b) => a.name.localeCompare(b.name, "en", { numeric: true })) : (/** @type {Pick[]} */ all) => all;
    this.history.set({ ...now, [group]: order([...now[group], { name, position }]) });
    this.select(group, name);
    this.arm(group === "landmarks" && this.history.now.landmarks.length < N_NEEDED ? group : null);
  }

  // Changes.

  /** @param {Group | null} group @param {string} name */
  select(group, name) {
    this.selected = group ? { group, name } : null;
    this.selectedPlane = null;
    this.changed();
  }

  /** @param {Group} group @param {string} name @param {Vector} position @returns {Picked} */
  moved(group, name, position) {
    const { now } = this.history;
    return { ...now, [group]: now[group].map((pick) => (pick.name === name ? { ...pick, position } : pick)) };
  }

  undo() {
    this.cancel();
    this.history.undo();
    this.afterTime();
  }

  redo() {
    this.cancel();
    this.history.redo();
    this.afterTime();
  }

  /** What was selected may not be there any more. */
  afterTime() {
    const { selected, history } = this;
    if (selected && history.now[selected.group].every(({ name }) => name !== selected.name)) this.selected = null;
    if (this.mode === "plan") this.armed = history.now.landmarks.length < N_NEEDED ? "landmarks" : null;
    this.say("");
    this.changed();
  }

  /** Deletes what is selected; of a pair both points. */
  remove() {
    const { now } = this.history;
    if (this.selectedPlane !== null) {
      this.history.set({ ...now, planes: now.planes.filter(({ name }) => name !== this.selectedPlane) });
      this.selectedPlane = null;
      return this.changed();
    }
    if (!this.selected) return this.say("nothing is selected; click a point first");
    const { group, name } = this.selected;
    const without = (/** @type {Pick[]} */ all) => all.filter((pick) => pick.name !== name);
    const isPair = group === "bone" || group === "scan";
    this.history.set(isPair ? { ...now, bone: without(now.bone), scan: without(now.scan) } : { ...now, [group]: without(now[group]) });
    this.afterTime();
  }

  /** @param {Group} group @param {string} from @param {string} to */
  rename(group, from, to) {
    const { now } = this.history;
    const name = to.trim();
    const isPair = group === "bone" || group === "scan";
    const taken = isPair ? [...now.bone, ...now.scan] : [...now.landmarks, ...now.assessment, ...now.tip];
    if (name === from) return this.changed();
    if (name === "" || taken.some((pick) => pick.name === name)) {
      this.say(name === "" ? "a point needs a name" : `there is a point ${name} already`);
      return this.changed();
    }
    const renamed = (/** @type {Pick[]} */ all) => all.map((pick) => (pick.name === from ? { ...pick, name } : pick));
    this.history.set(isPair ? { ...now, bone: renamed(now.bone), scan: renamed(now.scan) } : { ...now, [group]: renamed(now[group]) });
    this.select(group, name);
  }

  /** Moves the selected point along the surface, as seen. @param {number} right @param {number} up @param {number} mm */
  nudge(right, up, mm) {
    const pick = this.selected && this.history.now[this.selected.group].find(({ name }) => name === this.selected?.name);
    if (!this.selected || !pick) return this.say("nothing is selected; click a point first");
    const { group, name } = this.selected;
    const e = this.scene.camera.matrixWorld.elements;
    const wanted = plus([right * e[0], right * e[1], right * e[2]], [e[4], e[5], e[6]], up);
    const surface = this.surface();
    if (group === "scan" || !surface) return this.say("points of a scan are moved by dragging, from one measured point to another");
    const normal = surface.normal(surface.closest(pick.position)?.face ?? 0);
    const tangent = plus(wanted, normal, -dot(wanted, normal));
    if (norm(tangent) < 0.05) return this.say("the surface is seen edge-on there; turn the view");
    const hit = surface.closest(plus(pick.position, unit(tangent), mm));
    if (!hit) return;
    this.history.set(this.moved(group, name, hit.point));
    this.changed();
  }

  addPlane() {
    const [surface, of] = [this.surface(), this.bearings()];
    if (!surface || !of) return;
    const { now } = this.history;
    const [low, high] = surface.extent(of.along);
    const below = of.tip ? dot(of.tip, of.along) : 0;
    let n = now.planes.length + 1;
    while (now.planes.some(({ name }) => name === `plane_${n}`)) n++;
    this.history.set({ ...now, planes: [...now.planes, planeAcross(`plane_${n}`, (low + high) / 2 - below, of, surface)] });
    this.selected = null;
    this.selectedPlane = `plane_${n}`;
    this.changed();
  }

  /** @param {string} plane @param {{mm?: number, deg?: [number, number]}} to @param {Picked | null} from of a slider that moves: what was before */
  placePlane(plane, to, from) {
    const [surface, of] = [this.surface(), this.bearings()];
    if (!surface || !of) return;
    const { now } = this.history;
    const next = { ...now, planes: now.planes.map((known) => (known.name === plane ? placed(known, to, of, surface) : known)) };
    if (from) this.history.now = next;
    else this.history.set(next);
    this.changed();
  }

  /** @param {string} from @param {string} to */
  renamePlane(from, to) {
    const { now } = this.history;
    const name = to.trim();
    if (name !== from && (name === "" || now.planes.some((plane) => plane.name === name))) {
      this.say(name === "" ? "a plane needs a name" : `there is a plane ${name} already`);
    } else if (name !== from) {
      this.history.set({ ...now, planes: now.planes.map((plane) => (plane.name === from ? { ...plane, name } : plane)) });
      this.selectedPlane = name;
    }
    this.changed();
  }

  // Saving.

  /** What keeps the picks from being saved; null if nothing does. @returns {string | null} */
  fault() {
    const { now } = this.history;
    if (this.mode === "pairs") {
      const paired = now.bone.filter(({ name }) => now.scan.some((pick) => pick.name === name));
      const rows = this.cloud()?.item.columns.points.rows ?? [];
      const isMeasured = (/** @type {Pick} */ { position: [x, y, z] }) => {
        for (let k = 0; k < rows.length; k += 3) if (rows[k] === x && rows[k + 1] === y && rows[k + 2] === z) return true;
        return false;
      };
      const old = now.scan.filter((pick) => !isMeasured(pick)).map(({ name }) => name);
      if (old.length > 0) return `${old.join(", ")} was picked on a scan that is not shown any more; drag it onto the scan, or delete it`;
      return paired.length < N_NEEDED ? `${paired.length} of ${N_NEEDED} pairs are picked` : null;
    }
    const surface = this.surface();
    if (!surface) return "no surface of a bone is shown";
    if (now.landmarks.length < N_NEEDED) return `${now.landmarks.length} of ${N_NEEDED} landmarks are picked`;
    const off = [...now.landmarks, ...now.assessment, ...now.tip].map(({ name, position }) => ({ name, mm: surface.closest(position)?.distance ?? Infinity }));
    const far = off.filter(({ mm }) => !(mm <= OFF_MM));
    if (far.length > 0) return far.map(({ name, mm }) => `${name} is ${mm.toFixed(1)} mm off the surface`).join(", ") + "; drag it onto the bone, or delete it";
    // A JSON object orders such names by itself.
    const numbers = [...now.landmarks, ...now.assessment].filter(({ name }) => /^\d+$/.test(name)).map(({ name }) => name);
    if (numbers.length > 0) return `${numbers.join(", ")}: a name needs a letter, such as P${numbers[0]}`;
    const missed = now.planes.filter((plane) => !surface.section(plane.origin, normalOf(plane)));
    return missed.length > 0 ? `${missed.map(({ name }) => name).join(", ")} does not meet the bone` : null;
  }

  async save() {
    const { now } = this.history;
    const fault = this.fault();
    const surface = this.surface();
    if (fault) return this.say(`not saved: ${fault}`);
    const along = this.anatomy() ? null : this.bearings()?.along ?? null;
    try {
      const pairs = now.bone.filter(({ name }) => now.scan.some((pick) => pick.name === name));
      const inOrder = pairs.map(({ name }) => /** @type {Pick} */ (now.scan.find((pick) => pick.name === name)));
      const saved = this.mode === "pairs"
        ? await post("save/pairs", { bone: pairs, scan: inOrder })
        : await post("save/plan", planJson(now, this.shown.rest(), along, surface));
      this.panel.saved(String(saved.message), saved.files ?? []);
      // What the run gives is seen where everything is shown.
      if (this.runsWith()) this.enter(null);
    } catch (error) {
      this.say(`not saved: ${error instanceof Error ? error.message : error}`);
    }
  }

  /** Whether the graph is run with what is saved. */
  runsWith() { return this.known?.runs?.includes(String(this.mode)) ?? false; }

  /** @param {string} text */
  say(text) { this.panel.say(text); }

  changed() {
    this.isDirty = true;
    this.scene.redraw();
  }

  /** Before each frame: the marks as they are now. */
  draw() {
    const { scene } = this;
    if (this.mode) this.keepShown();
    if (this.isDirty) {
      this.isDirty = false;
      this.panel.update();
      this.drawMarks();
      this.camera = "";
    }
    const camera = this.mode ? [...scene.camera.position.toArray(), ...scene.camera.quaternion.toArray()].join() : "";
    if (this.mode === null || camera === this.camera) return;
    this.camera = camera;
    for (const { position, sprites } of this.marks) {
      const isHidden = this.aim.isHidden(position, false);
      for (const sprite of sprites) sprite.material.opacity = isHidden ? 0.25 : 1;
    }
    for (const { from, to, sprite } of this.lengths) {
      const [a, b] = [this.aim.onScreen(from), this.aim.onScreen(to)];
      sprite.visible = a !== null && b !== null && Math.hypot(a[0] - b[0], a[1] - b[1]) > ROOM_PX;
    }
    scene.redraw();
  }

  /** What is picked on stays, also where a recording is at a time before it. */
  keepShown() {
    const bone = this.bone();
    if (bone && !this.scene.drawn.has(bone.wire)) this.scene.update(bone.wire, "geometry/Mesh", bone.item);
    if (!this.scene.drawn.has(MARKS.bone)) this.isDirty = true;
    if (this.mode !== "pairs") return;
    this.beside.pick(this.cloud());
    if (!this.beside.scene.drawn.has(MARKS.scan)) this.isDirty = true;
  }

  drawMarks() {
    for (const name of Object.values(MARKS)) for (const scene of [this.scene, this.beside.made]) scene?.remove(name);
    this.marks = [];
    this.lengths = [];
    if (this.mode === null) return;
    const [surface, of, bone, cloud] = [this.surface(), this.bearings(), this.bone(), this.cloud()];
    if (!surface || !of || !bone) return;
    const { now } = this.history;
    const { object, marks } = drawPoints(now, this.groups("bone"), this.selected);
    this.marks = marks;
    if (this.mode === "plan") {
      const rulers = drawRulers(now, of);
      this.lengths = rulers.lengths;
      object.add(rulers.object, drawPlanes(now, surface, this.selectedPlane));
    }
    this.scene.put(MARKS.bone, object, { frame: String(bone.item.fields.frame), payload: "picking", shown: true });
    if (this.mode !== "pairs" || !cloud) return;
    const onScan = drawPoints(now, this.groups("scan"), this.selected).object;
    this.beside.scene.put(MARKS.scan, onScan, { frame: String(cloud.item.fields.frame), payload: "picking", shown: true });
  }
}

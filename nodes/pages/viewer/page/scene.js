// The view: surfaces, clouds, points, planes and frames, drawn where the frames are now.

import * as THREE from "three";
import { MM, addPoints, dispose, ellipsoids, hatch, make, move } from "./drawables.js";
import { Eye } from "./eye.js";
import { ResidualColours, hasOwnColours, ownColours } from "./residual_colours.js";
import { longAxis } from "./shapes.js";
import { Trackball } from "./trackball.js";

/** @typedef {import("./message.js").Item} Item */
/** @typedef {import("./frames.js").Frames} Frames */
/** @typedef {import("./verdict.js").Errors} Errors */
/** @typedef {"trusted" | "doubtful" | "refused" | null} Answer */

/** How much more than what is looked at a view shows. */
const ROOM = 1.12;
/** Points this far before a surface lie on it, mm. */
const ON_IT_MM = 5;
/** How near to a point of a cloud the pointer must be to take hold of it, pixels. */
const REACH_PX = 6;
/** What is predicted of points that no verdict is about. @type {import("./verdict.js").PredictedPoint[]} */
const NOTHING_PREDICTED = [];

/**
 * What is drawn of a wire.
 * @typedef {object} Drawn
 * @property {THREE.Object3D} object in the coordinates of `frame`, mm
 * @property {string} frame
 * @property {string} payload
 * @property {boolean} shown whether the user wants to see it
 * @property {string | null} unknown why it is not drawn
 */

/** @typedef {Pick<THREE.WebGLRenderer, "domElement" | "setPixelRatio" | "setSize" | "render">} Renderer */

const renderer = () => new THREE.WebGLRenderer({ antialias: true, alpha: true, preserveDrawingBuffer: true });

/** What draws. Without WebGL nothing is drawn, which is said in its place, and the rest of the page works. @param {HTMLElement} holder @returns {Renderer} */
export const rendererIn = (holder) => {
  try {
    return renderer();
  } catch {
    const said = document.createElement("p");
    said.className = "missing";
    said.textContent = "No view in three dimensions: this browser has no WebGL, as over some remote desktops or with a blocked graphics driver "
      + "(chrome://gpu or about:support says why). Verdict, numbers, graph and messages are complete.";
    holder.append(said);
    return { domElement: document.createElement("canvas"), setPixelRatio: () => {}, setSize: () => {}, render: () => {} };
  }
};

export class Scene {
  /**
   * @param {HTMLElement} holder
   * @param {{worker: Worker | null, isOrthographic: boolean, renderer?: Renderer}} options the worker computes residuals; without one they come with
   * the scans; without a renderer it is made, or nothing is
   */
  constructor(holder, { worker, isOrthographic, renderer: given }) {
    this.holder = holder;
    /** @type {Renderer} */
    this.renderer = given ?? renderer();
    this.renderer.setPixelRatio(Math.min(window.devicePixelRatio, 2));
    holder.append(this.renderer.domElement);
    this.scene = new THREE.Scene();
    this.eye = new Eye(isOrthographic);
    this.camera = this.eye.camera;
    const light = new THREE.DirectionalLight(0xffffff, 2.2);
    // Over the viewer's left shoulder, wherever the viewer is.
    light.position.set(-0.5, 0.6, 1);
    this.camera.add(light, light.target);
    this.scene.add(this.camera, new THREE.AmbientLight(0xffffff, 0.9));
    this.controls = new Trackball(this.camera, this.renderer.domElement, (place) => this.under(place));
    this.controls.addEventListener("change", () => this.redraw());
    this.controls.addEventListener("start", () => { this.isTurned = true; });
    /** @type {Map<string, Drawn>} */
    this.drawn = new Map();
    /** What the user chose to show or hide. @type {Map<string, boolean>} */
    this.choices = new Map();
    /** Directions of the bone in its frame. @type {{frame: string, axes: THREE.Matrix3} | null} */
    this.axes = null;
    /** @type {Answer} */
    this.answer = null;
    /** @type {Errors | null} */
    this.errors = null;
    this.isLookedAt = false;
    /** Whether it chooses what to look at. */
    this.looksItself = true;
    /** What was known when the view was chosen. */
    this.lookedAt = "";
    /** Whether the user chose the view, which then stays. */
    this.isTurned = false;
    this.isGlass = false;
    this.isDirty = true;
    /** Called when there is something to draw. */
    this.asks = () => {};
    /** What is shown instead of everything else. @type {THREE.Object3D | null} */
    this.solo = null;
    this.colours = new ResidualColours(this, worker);
    /** What is shown in the view beside this one, and why. @type {Map<string, string>} */
    this.beside = new Map();
    /** The wires of clouds that nodes made of a cloud. @type {Map<string, Set<string>>} */
    this.derived = new Map();
    /** Shows some of one frame alone, in its own coordinates: what is picked on does not move. @type {{frame: string, shows: (wire: string) => boolean} | null} */
    this.focus = null;
    new ResizeObserver(() => this.resize()).observe(holder);
    this.resize();
  }

  resize() {
    const { clientWidth: width, clientHeight: height } = this.holder;
    if (width === 0 || height === 0) return;
    this.renderer.setSize(width, height);
    this.eye.resize(width, height);
    this.redraw();
  }

  redraw() {
    this.isDirty = true;
    this.asks();
  }

  clear() {
    for (const wire of [...this.drawn.keys()]) this.remove(wire);
    this.axes = null;
    this.colours.clear();
    if (!this.isTurned) this.isLookedAt = false;
    this.redraw();
  }

  /** @param {string} wire */
  remove(wire) {
    const drawn = this.drawn.get(wire);
    if (!drawn) return;
    dispose(drawn.object);
    this.scene.remove(drawn.object);
    this.drawn.delete(wire);
  }

  /**
   * Draws an item of a wire, or remembers why there is nothing to draw.
   * @param {string} wire
   * @param {string} payload
   * @param {Item} item
   */
  update(wire, payload, item) {
    const before = this.drawn.get(wire);
    if (item.empty) {
      if (before) before.unknown = item.empty.reason;
      this.redraw();
      return;
    }
    const frame = String(item.fields.frame ?? "");
    if (payload === "geometry/Axes") {
      const axes = /** @type {number[]} */ (item.fields.columns);
      this.axes = { frame, axes: new THREE.Matrix3().fromArray(axes) };
      return;
    }
    if (before && before.frame === frame && payload === "geometry/Planes" && move(before, item)) {
      this.redraw();
      return;
    }
    if (before && before.frame === frame && payload === "geometry/Points") {
      addPoints(before.object, item);
      before.unknown = null;
      this.redraw();
      return;
    }
    const made = make(payload, item);
    if (!made) return;
    const { object, unknown } = made;
    const shown = before?.shown ?? this.choices.get(wire) ?? (isShownAtFirst(wire, payload) && !this.isReplaced(wire));
    this.remove(wire);
    object.matrixAutoUpdate = false;
    this.scene.add(object);
    this.drawn.set(wire, { object, frame, payload, shown, unknown });
    if (payload === "geometry/Mesh") this.glaze(object);
    if (payload === "geometry/Mesh" && !wire.startsWith("phantom")) {
      this.colours.measureFrom(wire, item);
    }
    if (payload === "geometry/Cloud") {
      object.userData.points = item.columns.points.rows;
      // Made when they are asked for.
      object.userData.hasOwn = hasOwnColours(item);
      object.userData.own = () => (object.userData.colours ??= ownColours(item));
      if (this.colours.isOwn) this.colours.paint(wire);
      this.hideReplaced();
    }
    this.redraw();
  }

  /** Whether something that was made of a cloud is drawn: it cropped, or moved to where it belongs. @param {string} wire */
  isReplaced(wire) {
    const made = this.derived.get(wire);
    if (made) return [...made].some((other) => this.drawn.has(other));
    // A page that has no graph goes by the names.
    return isRaw(wire) && [...this.drawn].some(([other, { payload }]) => payload === "geometry/Cloud" && !isRaw(other) && !other.includes("phantom"));
  }

  /** A cloud is not shown beside what was made of it, unless the user wants to see it. */
  hideReplaced() {
    for (const [wire, drawn] of this.drawn) {
      if (drawn.payload === "geometry/Cloud" && drawn.shown && !this.choices.has(wire) && this.isReplaced(wire)) drawn.shown = false;
    }
  }

  /** Takes which clouds a graph makes of which. @param {Map<string, Set<string>>} derived */
  takeDerived(derived) {
    this.derived = derived;
    this.hideReplaced();
    this.redraw();
  }

  /**
   * Draws an object that no item of a wire gave.
   * @param {string} name
   * @param {THREE.Object3D} object in the coordinates of the frame, mm
   * @param {{frame: string, payload: string, shown: boolean}} layer
   */
  put(name, object, { frame, payload, shown }) {
    this.remove(name);
    object.matrixAutoUpdate = false;
    this.scene.add(object);
    this.drawn.set(name, { object, frame, payload, shown, unknown: null });
    this.redraw();
  }

  /** Shows or hides a layer, as the user chose. @param {string} wire @param {boolean} shown */
  choose(wire, shown) {
    const drawn = this.drawn.get(wire);
    if (drawn) drawn.shown = shown;
    this.choices.set(wire, shown);
    this.redraw();
  }

  /** The surface that residuals are measured from. */
  get surface() { return this.colours.surface; }

  /** The distances of the points of each cloud from the surface, mm. */
  get residuals() { return this.colours.known; }

  /** @param {Answer} answer @param {Errors | null} errors */
  judge(answer, errors) {
    this.answer = answer;
    this.errors = errors;
    this.redraw();
  }

  /**
   * Places everything and draws it, if anything has changed.
   * @param {Frames} frames
   * @returns {number} the time of the renderer, ms
   */
  draw(frames) {
    if (!this.isDirty) return 0;
    this.isDirty = false;
    const root = this.focus?.frame ?? this.rootOf(frames);
    for (const [wire, drawn] of this.drawn) {
      const place = this.placeOf(drawn.frame, frames);
      const isLeftOut = this.focus !== null && (drawn.frame !== root || !this.focus.shows(wire));
      const why = isLeftOut ? "not shown while picking" : this.whyHidden(drawn, place, root);
      Object.assign(drawn.object.userData, { why, note: this.beside.get(wire) ?? null });
      drawn.object.visible = drawn.shown && why === null && this.solo === null;
      drawn.object.matrix.copy(place.matrix).multiply(new THREE.Matrix4().makeScale(MM, MM, MM));
      if (drawn.payload === "geometry/Planes") hatch(drawn.object, this.answer === "doubtful");
      if (drawn.payload === "geometry/Points") ellipsoids(drawn.object, this.errors?.wire === wire ? this.errors.points : NOTHING_PREDICTED);
    }
    this.colours.ask(frames);
    this.lookAtFirst(frames, root);
    this.bringForth();
    const began = performance.now();
    this.renderer.render(this.scene, this.camera);
    return performance.now() - began;
  }

  /** Where a frame is drawn. @param {string} frame @param {Frames} frames */
  placeOf(frame, frames) {
    return this.focus ? { root: frame, matrix: new THREE.Matrix4(), unknown: null } : frames.toRoot(frame);
  }

  /**
   * Looks at the bone as soon as it is there, and again when it is placed by other frames or a scan comes, unless the user has turned
   * the view.
   * @param {Frames} frames
   * @param {string} root
   */
  lookAtFirst(frames, root) {
    if (this.solo !== null || !this.looksItself) return;
    const hasScan = [...this.drawn.values()].some(({ payload, object }) => payload === "geometry/Cloud" && object.visible);
    const ways = [...this.drawn.values()].filter(({ payload }) => payload === "geometry/Mesh").map(({ frame }) => frames.chain(frame));
    const seen = `${root} ${hasScan} ${ways}`;
    if (this.isLookedAt && (this.isTurned || this.focus !== null || seen === this.lookedAt)) return;
    this.isLookedAt = this.look("scan", frames);
    if (this.isLookedAt) this.lookedAt = seen;
  }

  /** Brings what is on a surface before it, so that the surface does not cover what is just inside, and names to their size. */
  bringForth() {
    this.camera.updateMatrixWorld();
    const towards = new THREE.Vector3().setFromMatrixColumn(this.camera.matrixWorld, 2);
    for (const { object } of this.drawn.values()) {
      const { forthMm } = object.userData;
      if (!forthMm || this.focus !== null) continue;
      object.matrix.premultiply(new THREE.Matrix4().makeTranslation(towards.clone().multiplyScalar(forthMm * MM)));
    }
    const scale = this.eye.nameScale();
    this.scene.traverse((part) => part.userData.size && part.scale.fromArray(part.userData.size).multiplyScalar(scale));
  }

  /** The frame that all is drawn in: that of the bone, else of most of what is drawn. @param {Frames} frames */
  rootOf(frames) {
    const bone = [...this.drawn].find(([, { payload, shown }]) => payload === "geometry/Mesh" && shown)?.[1];
    if (bone) return frames.root(bone.frame);
    const counts = new Map();
    for (const [, { frame, payload }] of this.drawn) {
      if (payload === "device") continue;
      const root = frames.root(frame);
      counts.set(root, (counts.get(root) ?? 0) + 1);
    }
    return [...counts].sort((a, b) => b[1] - a[1])[0]?.[0] ?? "";
  }

  /**
   * @param {Drawn} drawn
   * @param {{root: string, unknown: string | null}} place
   * @param {string} root
   * @returns {string | null}
   */
  whyHidden(drawn, place, root) {
    if (drawn.unknown !== null) return drawn.unknown;
    if (place.unknown !== null) return place.unknown;
    if (place.root !== root) return `no pose connects ${drawn.frame} to ${root}`;
    if (drawn.payload === "geometry/Planes" && this.answer === "refused") return "the registration is refused";
    if (drawn.payload === "geometry/Planes" && this.answer === null) return "the registration is not judged yet";
    return null;
  }

  /**
   * Looks at the bone from a side; `scan` is the side that was scanned.
   * @param {"scan" | "lateral" | "anterior" | "along"} side
   * @param {Frames} frames
   * @returns {boolean} whether there was anything to look at
   */
  look(side, frames) {
    const bone = [...this.drawn.values()].find(({ payload, object }) => payload === "geometry/Mesh" && object.visible)
      ?? [...this.drawn.values()].find(({ payload, object }) => payload === "geometry/Cloud" && object.visible);
    if (!bone) return false;
    this.scene.updateMatrixWorld(true);
    const all = places(bone);
    if (all.length === 0) return false;
    const [lateral, anterior, along] = this.directions(bone, frames);
    const from = side === "scan" ? this.scannedSide(bone, along) ?? lateral : { lateral, anterior, along }[side];
    this.fit(all, from, side === "along" ? anterior : along);
    return true;
  }

  /**
   * Looks at all of these places, however narrow the view is.
   * @param {THREE.Vector3[]} all
   * @param {THREE.Vector3} from the direction from there to the viewer
   * @param {THREE.Vector3} up across it
   */
  fit(all, from, up) {
    const right = new THREE.Vector3().crossVectors(up, from);
    // What is seen of it in each direction of the view.
    const [across, above, depth] = [right, up, from].map((direction) => {
      const levels = all.map((place) => place.dot(direction));
      const [low, high] = [levels.reduce((a, b) => Math.min(a, b)), levels.reduce((a, b) => Math.max(a, b))];
      return { middle: (low + high) / 2, size: high - low };
    });
    const centre = new THREE.Vector3().addScaledVector(right, across.middle).addScaledVector(up, above.middle).addScaledVector(from, depth.middle);
    // What is nearer is seen larger, by the slope of the view.
    const half = (ROOM * Math.max(above.size, across.size / this.eye.aspect)) / 2 + this.eye.growth(depth.size / 2);
    this.controls.target.copy(centre);
    this.eye.look(centre, from, up, half, Math.hypot(across.size, above.size, depth.size));
    this.controls.update();
    this.redraw();
  }

  /**
   * The direction across the bone in which the scan lies: from the middle of the bone along the scan to that of the scan.
   * @param {Drawn} bone
   * @param {THREE.Vector3} along
   */
  scannedSide(bone, along) {
    const scan = [...this.drawn.values()].find(({ payload, object }) => payload === "geometry/Cloud" && object.visible);
    if (!scan || scan === bone) return null;
    const middle = (/** @type {THREE.Vector3[]} */ all) => all.reduce((sum, place) => sum.add(place), new THREE.Vector3()).divideScalar(all.length);
    const scanned = places(scan);
    const levels = scanned.map((place) => place.dot(along));
    const [low, high] = [levels.reduce((a, b) => Math.min(a, b)), levels.reduce((a, b) => Math.max(a, b))];
    const beside = places(bone).filter((place) => place.dot(along) >= low && place.dot(along) <= high);
    if (beside.length === 0) return null;
    const across = middle(scanned).sub(middle(beside)).projectOnPlane(along);
    return across.length() > 0 ? across.normalize() : null;
  }

  /** The camera of a view that is picked or drawn on, which is never orthographic. */
  perspective() {
    if (this.camera instanceof THREE.PerspectiveCamera) return this.camera;
    throw new Error("the view is orthographic");
  }

  /**
   * Shows an object alone, in its own coordinates.
   * @param {THREE.Object3D} object
   * @returns {() => void} shows everything again, from where it was seen
   */
  alone(object) {
    const camera = this.perspective();
    const { position, up, near, far, fov } = camera;
    const before = { position: position.clone(), up: up.clone(), target: this.controls.target.clone(), near, far, fov };
    this.solo = object;
    this.scene.add(object);
    this.redraw();
    return () => {
      this.scene.remove(object);
      this.solo = null;
      Object.assign(camera, { near: before.near, far: before.far, fov: before.fov });
      camera.position.copy(before.position);
      camera.up.copy(before.up);
      camera.updateProjectionMatrix();
      this.controls.target.copy(before.target);
      this.controls.update();
      this.redraw();
    };
  }

  /**
   * @param {THREE.Vector3} eye
   * @param {THREE.Vector3} target
   * @param {THREE.Vector3} up
   * @param {number} size of what is looked at
   */
  lookFrom(eye, target, up, size) {
    const camera = this.perspective();
    // All of it, if the narrower side of the view is that of its breadth.
    camera.fov = (360 / Math.PI) * Math.atan((0.55 * size) / eye.distanceTo(target) / Math.min(camera.aspect, 2));
    camera.up.copy(up);
    camera.position.copy(eye);
    camera.near = size / 500;
    camera.far = size * 40;
    camera.updateProjectionMatrix();
    this.controls.target.copy(target);
    this.controls.update();
    this.redraw();
  }

  /** Shows the bone as glass, or solid. @param {boolean} isGlass */
  glass(isGlass) {
    this.isGlass = isGlass;
    for (const [, { payload, object }] of this.drawn) if (payload === "geometry/Mesh") this.glaze(object);
    this.redraw();
  }

  /** @param {THREE.Object3D} object */
  glaze(object) {
    const { material } = /** @type {THREE.Mesh<any, THREE.MeshLambertMaterial>} */ (object.children[0]);
    material.transparent = this.isGlass;
    material.opacity = this.isGlass ? 0.35 : 1;
    material.depthWrite = !this.isGlass;
    material.needsUpdate = true;
  }

  /**
   * The bone's lateral, anterior and long direction in the scene: by the plan's axes; else its longest is the long one, and the others are
   * across it, the first as near to the frame's x as can be.
   * @param {Drawn} bone
   * @param {Frames} frames
   */
  directions(bone, frames) {
    const axes = this.axes ? this.axes.axes.clone() : longDirections(bone.object);
    const turn = new THREE.Matrix3().setFromMatrix4(this.placeOf(this.axes?.frame ?? bone.frame, frames).matrix);
    return [0, 1, 2].map((k) => new THREE.Vector3().fromArray(axes.elements, 3 * k).applyMatrix3(turn).normalize());
  }

  /**
   * What is under a place of the window: of surfaces the nearest, of clouds a point that is hit.
   * @param {{x: number, y: number}} place
   */
  under({ x, y }) {
    const { left, top, width, height } = this.renderer.domElement.getBoundingClientRect();
    const ray = new THREE.Raycaster();
    this.scene.updateMatrixWorld();
    this.camera.updateMatrixWorld();
    ray.setFromCamera(new THREE.Vector2((2 * (x - left)) / width - 1, 1 - (2 * (y - top)) / height), this.camera);
    const solid = ["geometry/Mesh", "geometry/Cloud"];
    const parts = [...this.drawn.values()].filter(({ payload, object }) => object.visible && solid.includes(payload)).map(({ object }) => object);
    // A hand is a few pixels off a point; what is drawn of wires is in millimetres, which the ray does not know.
    ray.params.Points.threshold = (2 * REACH_PX * this.eye.half(this.controls.target)) / height / (this.solo ? 1 : MM);
    const hits = ray.intersectObjects(this.solo ? [this.solo] : parts);
    // A point of a cloud is hit beside it: what lies on a surface is held at the surface.
    const surface = hits.find(({ object }) => object instanceof THREE.Mesh);
    return (surface && surface.distance - hits[0].distance < ON_IT_MM * MM ? surface : hits[0])?.point ?? null;
  }
}

/** Places in the scene of what is drawn, at most some ten thousand. @param {Drawn} drawn */
export function places({ object }) {
  const [part] = object.children;
  const { array } = /** @type {THREE.Points} */ (part).geometry.getAttribute("position");
  const every = 3 * Math.ceil(array.length / 30000);
  const all = [];
  for (let k = 0; k + 2 < array.length; k += every) all.push(new THREE.Vector3().fromArray(array, k).applyMatrix4(part.matrixWorld));
  return all;
}

/** Directions of a bone without a plan, in its frame, as columns. @param {THREE.Object3D} object */
function longDirections(object) {
  const { array } = /** @type {THREE.Points} */ (object.children[0]).geometry.getAttribute("position");
  const axis = longAxis(array);
  // Of two ways along it that of the frame's axis, so that in a CT the head is up.
  const along = new THREE.Vector3(...(axis.isLong ? axis.direction : [0, 0, 1]));
  const largest = along.toArray().reduce((a, b) => (Math.abs(b) > Math.abs(a) ? b : a));
  if (largest < 0) along.negate();
  const first = new THREE.Vector3(1, 0, 0).projectOnPlane(along);
  const lateral = (first.length() > 0.5 ? first : new THREE.Vector3(0, 1, 0).projectOnPlane(along)).normalize();
  return new THREE.Matrix3().set(...columns(lateral, new THREE.Vector3().crossVectors(along, lateral), along));
}

/** @param {THREE.Vector3} a @param {THREE.Vector3} b @param {THREE.Vector3} c @returns {[number, number, number, number, number, number, number, number, number]} row by row */
function columns(a, b, c) { return [a.x, b.x, c.x, a.y, b.y, c.y, a.z, b.z, c.z]; }

/** Whether a wire has clouds as they came from a camera. @param {string} wire */
function isRaw(wire) { return /^recording\.(.*\.)?(scan|laser)$/.test(wire); }

/** @param {string} wire @param {string} payload */
function isShownAtFirst(wire, payload) {
  // Spots of a laser are drawn as points; a simulation's truths are for comparisons.
  const isLaser = payload === "geometry/Cloud" && isRaw(wire) && wire.endsWith("laser");
  // Touched points lie where the bone was then.
  const isTouched = payload === "geometry/Points" && wire.startsWith("recording.");
  const isPlan = payload === "geometry/Planes" && wire.startsWith("plan.");
  return !isLaser && !isTouched && !isPlan && !/true|marks|palpation|check_|phantom|planes_at_scan/.test(wire);
}

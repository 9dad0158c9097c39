// The view: surfaces, clouds, points, planes and frames, drawn where the frames are now.

import * as THREE from "three";
import { OrbitControls } from "./three/OrbitControls.js";

/** @typedef {import("./message.js").Item} Item */
/** @typedef {import("./frames.js").Frames} Frames */
/** @typedef {"trusted" | "doubtful" | "refused" | null} Answer */

/** Millimetres in the scene's metres. */
export const MM = 0.001;
/** Half the side of a drawn plane, mm: a bone's width and some. */
export const PLANE_MM = 18;
/** Colours that differ in lightness too, for those who cannot tell red from green. */
export const BONE = 0xd9cfbb, SCAN = 0x0072b2, PLANE = 0x8a3ffc, POINT = 0xd55e00;

/** Residual at the ends of the colour scale, mm. */
export const RESIDUAL_MM = 1;

/**
 * What is drawn of a wire.
 * @typedef {object} Drawn
 * @property {THREE.Object3D} object in the coordinates of `frame`, mm
 * @property {string} frame
 * @property {string} payload
 * @property {boolean} shown whether the user wants to see it
 * @property {string | null} unknown why it is not drawn
 */

export class Scene {
  /** @param {HTMLElement} holder */
  constructor(holder) {
    this.holder = holder;
    this.renderer = new THREE.WebGLRenderer({ antialias: true, alpha: true, preserveDrawingBuffer: true });
    this.renderer.setPixelRatio(Math.min(window.devicePixelRatio, 2));
    holder.append(this.renderer.domElement);
    this.scene = new THREE.Scene();
    this.camera = new THREE.PerspectiveCamera(35, 1, 0.001, 20);
    this.camera.position.set(0.3, 0.3, 0.3);
    const light = new THREE.DirectionalLight(0xffffff, 2.2);
    // Over the viewer's left shoulder, wherever the viewer is.
    light.position.set(-0.5, 0.6, 1);
    this.camera.add(light, light.target);
    this.scene.add(this.camera, new THREE.AmbientLight(0xffffff, 0.9));
    this.controls = new OrbitControls(this.camera, this.renderer.domElement);
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
    this.isLookedAt = false;
    /** What was known when the view was chosen. */
    this.lookedAt = "";
    /** Whether the user chose the view, which then stays. */
    this.isTurned = false;
    this.isGlass = false;
    this.isDirty = true;
    /** What is shown instead of everything else. @type {THREE.Object3D | null} */
    this.solo = null;
    this.worker = new Worker("residual.js", { type: "module" });
    this.worker.onmessage = ({ data }) => this.colour(data);
    /** The surface that residuals are measured from. @type {string | null} */
    this.surface = null;
    /** What was asked last for each cloud. @type {Map<string, {key: string, question: number}>} */
    this.asked = new Map();
    this.questions = 0;
    /** The distances of the points of each cloud from the surface, mm. @type {Map<string, Float32Array>} */
    this.residuals = new Map();
    /** Shows some of one frame alone, in its own coordinates: what is picked on does not move. @type {{frame: string, shows: (wire: string) => boolean} | null} */
    this.focus = null;
    new ResizeObserver(() => this.resize()).observe(holder);
    this.resize();
  }

  resize() {
    const { clientWidth: width, clientHeight: height } = this.holder;
    if (width === 0 || height === 0) return;
    this.renderer.setSize(width, height);
    this.camera.aspect = width / height;
    this.camera.updateProjectionMatrix();
    this.redraw();
  }

  redraw() { this.isDirty = true; }

  clear() {
    for (const wire of [...this.drawn.keys()]) this.remove(wire);
    this.axes = null;
    this.surface = null;
    this.asked.clear();
    this.residuals.clear();
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
    const shown = before?.shown ?? this.choices.get(wire) ?? isShownAtFirst(wire, payload);
    this.remove(wire);
    object.matrixAutoUpdate = false;
    this.scene.add(object);
    this.drawn.set(wire, { object, frame, payload, shown, unknown });
    if (payload === "geometry/Mesh") this.glaze(object);
    if (payload === "geometry/Mesh" && !wire.startsWith("phantom")) {
      const { vertices, faces } = item.columns;
      this.surface = wire;
      this.asked.clear();
      this.worker.postMessage({ vertices: vertices.rows, faces: faces.rows });
    }
    if (payload === "geometry/Cloud") object.userData.points = item.columns.points.rows;
    this.redraw();
  }

  /** @param {Answer} answer */
  judge(answer) {
    this.answer = answer;
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
      drawn.object.userData.why = why;
      drawn.object.visible = drawn.shown && why === null && this.solo === null;
      drawn.object.matrix.copy(place.matrix).multiply(new THREE.Matrix4().makeScale(MM, MM, MM));
      if (drawn.payload === "geometry/Planes") hatch(drawn.object, this.answer === "doubtful");
    }
    this.askForResiduals(frames);
    this.lookAtFirst(frames, root);
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
    if (this.solo !== null) return;
    const hasScan = [...this.drawn.values()].some(({ payload, object }) => payload === "geometry/Cloud" && object.visible);
    const ways = [...this.drawn.values()].filter(({ payload }) => payload === "geometry/Mesh").map(({ frame }) => frames.chain(frame));
    const seen = `${root} ${hasScan} ${ways}`;
    if (this.isLookedAt && (this.isTurned || this.focus !== null || seen === this.lookedAt)) return;
    this.isLookedAt = this.look("scan", frames);
    if (this.isLookedAt) this.lookedAt = seen;
  }

  /** Asks for the residuals of the clouds that are drawn, if a cloud or its place on the surface has changed. @param {Frames} frames */
  askForResiduals(frames) {
    const surface = this.surface === null ? undefined : this.drawn.get(this.surface);
    if (!surface || this.focus) return;
    const toSurface = frames.toRoot(surface.frame).matrix.clone().invert();
    for (const [wire, { object, frame, payload }] of this.drawn) {
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
  colour({ wire, question, residuals }) {
    const asked = this.asked.get(wire);
    const drawn = this.drawn.get(wire);
    if (!asked || asked.question !== question || !drawn) return;
    this.asked.set(wire, { ...asked, question: -1 });
    const points = drawn.object.children[0];
    if (!(points instanceof THREE.Points) || points.geometry.getAttribute("position").count !== residuals.length) return this.redraw();
    this.residuals.set(wire, residuals);
    const colours = new Float32Array(3 * residuals.length);
    residuals.forEach((mm, k) => colours.set(residualColour(mm), 3 * k));
    points.geometry.setAttribute("color", new THREE.BufferAttribute(colours, 3));
    points.material.vertexColors = true;
    points.material.color.set(0xffffff);
    points.material.needsUpdate = true;
    this.redraw();
  }

  /** The frame that all is drawn in: that of most of what is drawn. @param {Frames} frames */
  rootOf(frames) {
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
    const box = new THREE.Box3().setFromObject(bone.object, true);
    if (box.isEmpty()) return false;
    const centre = box.getCenter(new THREE.Vector3());
    const length = box.getSize(new THREE.Vector3()).length();
    const [lateral, anterior, along] = this.directions(bone, frames);
    const from = side === "scan" ? this.scannedSide(bone, along) ?? lateral : { lateral, anterior, along }[side];
    this.camera.up.copy(side === "along" ? anterior : along);
    const distance = (0.55 * length) / Math.tan((this.camera.fov * Math.PI) / 360);
    this.camera.position.copy(centre).addScaledVector(from, side === "along" ? 0.6 * length : distance);
    this.camera.near = length / 500;
    this.camera.far = length * 20;
    this.camera.updateProjectionMatrix();
    this.controls.target.copy(centre);
    this.controls.update();
    this.redraw();
    return true;
  }

  /**
   * The direction across the bone in which the scan lies: from the middle of the bone along the scan to that of the scan.
   * @param {Drawn} bone
   * @param {THREE.Vector3} along
   */
  scannedSide(bone, along) {
    const scan = [...this.drawn.values()].find(({ payload, object }) => payload === "geometry/Cloud" && object.visible);
    if (!scan || scan === bone) return null;
    const places = (/** @type {Drawn} */ { object }) => {
      const [part] = object.children;
      const { array } = /** @type {THREE.Points} */ (part).geometry.getAttribute("position");
      const every = 3 * Math.ceil(array.length / 30000);
      const all = [];
      for (let k = 0; k + 2 < array.length; k += every) all.push(new THREE.Vector3().fromArray(array, k).applyMatrix4(part.matrixWorld));
      return all;
    };
    const middle = (/** @type {THREE.Vector3[]} */ all) => all.reduce((sum, place) => sum.add(place), new THREE.Vector3()).divideScalar(all.length);
    const scanned = places(scan);
    const levels = scanned.map((place) => place.dot(along));
    const [low, high] = [levels.reduce((a, b) => Math.min(a, b)), levels.reduce((a, b) => Math.max(a, b))];
    const beside = places(bone).filter((place) => place.dot(along) >= low && place.dot(along) <= high);
    if (beside.length === 0) return null;
    const across = middle(scanned).sub(middle(beside)).projectOnPlane(along);
    return across.length() > 0 ? across.normalize() : null;
  }

  /**
   * Shows an object alone, in its own coordinates.
   * @param {THREE.Object3D} object
   * @returns {() => void} shows everything again, from where it was seen
   */
  alone(object) {
    const { position, up, near, far, fov } = this.camera;
    const before = { position: position.clone(), up: up.clone(), target: this.controls.target.clone(), near, far, fov };
    this.solo = object;
    this.scene.add(object);
    this.redraw();
    return () => {
      this.scene.remove(object);
      this.solo = null;
      Object.assign(this.camera, { near: before.near, far: before.far, fov: before.fov });
      this.camera.position.copy(before.position);
      this.camera.up.copy(before.up);
      this.camera.updateProjectionMatrix();
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
    // All of it, if the narrower side of the view is that of its breadth.
    this.camera.fov = (360 / Math.PI) * Math.atan((0.55 * size) / eye.distanceTo(target) / Math.min(this.camera.aspect, 2));
    this.camera.up.copy(up);
    this.camera.position.copy(eye);
    this.camera.near = size / 500;
    this.camera.far = size * 40;
    this.camera.updateProjectionMatrix();
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
   * The bone's lateral, anterior and long direction in the scene: by the plan's axes, else by the frame's.
   * @param {Drawn} bone
   * @param {Frames} frames
   */
  directions(bone, frames) {
    const frame = this.axes?.frame ?? bone.frame;
    const turn = new THREE.Matrix3().setFromMatrix4(this.placeOf(frame, frames).matrix);
    const axes = this.axes?.axes ?? new THREE.Matrix3();
    const [x, y, z] = [0, 1, 2].map((k) => {
      const column = new THREE.Vector3().fromArray(axes.elements, 3 * k);
      return column.applyMatrix3(turn).normalize();
    });
    return [x, y, z];
  }
}

/** Ends and middle of the scale: blue inside, white on the surface, orange outside; grey where there is none near. */
const INSIDE = [0, 0.45, 0.7], ON = [0.97, 0.97, 0.95], OUTSIDE = [0.84, 0.37, 0], NONE = [0.55, 0.57, 0.6];

/** @param {number} mm */
function residualColour(mm) {
  if (!Number.isFinite(mm)) return NONE;
  const share = Math.min(Math.abs(mm) / RESIDUAL_MM, 1);
  const end = mm < 0 ? INSIDE : OUTSIDE;
  return ON.map((c, k) => c + share * (end[k] - c));
}

/** @param {string} wire @param {string} payload */
function isShownAtFirst(wire, payload) {
  // Raw scans are drawn again where they belong, and a simulation's truths are for comparisons.
  const isRaw = payload === "geometry/Cloud" && /(^|\.)(scan|laser|phantom_scan)$/.test(wire) && wire.startsWith("recording.");
  // Touched points lie where the bone was then.
  const isTouched = payload === "geometry/Points" && wire.startsWith("recording.");
  const isPlan = payload === "geometry/Planes" && wire.startsWith("plan.");
  return !isRaw && !isTouched && !isPlan && !/true|marks|palpation|check_|phantom|planes_at_scan/.test(wire);
}

/**
 * @param {string} payload
 * @param {Item} item
 * @returns {{object: THREE.Object3D, unknown: string | null} | null}
 */
function make(payload, item) {
  switch (payload) {
    case "geometry/Mesh": return { object: surface(item), unknown: null };
    case "geometry/Cloud": return { object: cloud(item), unknown: null };
    case "geometry/Planes": return planes(item);
    case "geometry/Points": return { object: addPoints(new THREE.Group(), item), unknown: null };
    default: return null;
  }
}

/** Float32 positions relative to the first, which WebGL needs far from the origin; the object carries the rest.
 * @param {ArrayLike<number>} rows
 */
function positions(rows) {
  const origin = rows.length >= 3 ? [rows[0], rows[1], rows[2]] : [0, 0, 0];
  const out = new Float32Array(rows.length);
  for (let k = 0; k < rows.length; k++) out[k] = rows[k] - origin[k % 3];
  return { origin, attribute: new THREE.BufferAttribute(out, 3) };
}

/** @param {THREE.Object3D} object @param {number[]} origin */
function at(object, origin) {
  const holder = new THREE.Group();
  object.position.set(origin[0], origin[1], origin[2]);
  holder.add(object);
  return holder;
}

/** @param {Item} item */
function surface(item) {
  const { origin, attribute } = positions(/** @type {Float64Array} */ (item.columns.vertices.rows));
  const geometry = new THREE.BufferGeometry().setAttribute("position", attribute);
  geometry.setIndex(new THREE.BufferAttribute(/** @type {Uint32Array} */ (item.columns.faces.rows).slice(), 1));
  geometry.computeVertexNormals();
  const material = new THREE.MeshLambertMaterial({ color: BONE, side: THREE.DoubleSide });
  return at(new THREE.Mesh(geometry, material), origin);
}

/** @param {Item} item */
function cloud(item) {
  const { origin, attribute } = positions(/** @type {Float64Array} */ (item.columns.points.rows));
  const geometry = new THREE.BufferGeometry().setAttribute("position", attribute);
  const material = new THREE.PointsMaterial({ color: SCAN, size: 2, sizeAttenuation: false });
  return at(new THREE.Points(geometry, material), origin);
}

const BALL = new THREE.SphereGeometry(1.2, 16, 12);

/**
 * Puts the points of an item into a group, beside those of other names that its wire gave before: the three laser points come one
 * by one.
 * @param {THREE.Object3D} group
 * @param {Item} item
 */
function addPoints(group, item) {
  const rows = /** @type {Float64Array} */ (item.columns.positions.rows);
  const names = String(item.fields.names ?? "").split("\n");
  /** @type {Map<string, number[]>} */
  const places = (group.userData.places ??= new Map());
  /** @type {Map<string, THREE.Object3D[]>} */
  const parts = (group.userData.parts ??= new Map());
  for (let k = 0; 3 * k < rows.length; k++) {
    const text = names[k] ?? "";
    places.set(text, [rows[3 * k], rows[3 * k + 1], rows[3 * k + 2]]);
    let pair = parts.get(text);
    if (!pair) {
      pair = [new THREE.Mesh(BALL, new THREE.MeshLambertMaterial({ color: POINT })), label(text)];
      parts.set(text, pair);
      group.add(...pair);
    }
    for (const part of pair) part.position.set(rows[3 * k], rows[3 * k + 1], rows[3 * k + 2]);
  }
  return group;
}

/** @param {Item} item */
function planes(item) {
  const rows = /** @type {Float64Array} */ (item.columns.isometries.rows);
  const names = String(item.fields.names ?? "").split("\n");
  const reasons = String(item.fields.unknown ?? "").split("\n");
  const group = new THREE.Group();
  group.userData.names = item.fields.names;
  let unknown = null;
  for (let k = 0; 7 * k < rows.length; k++) {
    const [x, y, z, i, j, l, w] = rows.subarray(7 * k, 7 * k + 7);
    if (![x, y, z, i, j, l, w].every(Number.isFinite)) {
      unknown ??= reasons[k] || "its place is unknown";
      continue;
    }
    const square = new THREE.Mesh(
      new THREE.PlaneGeometry(2 * PLANE_MM, 2 * PLANE_MM),
      new THREE.MeshBasicMaterial({ color: PLANE, transparent: true, opacity: 0.35, side: THREE.DoubleSide, depthWrite: false }),
    );
    square.userData.isPlane = true;
    const edge = new THREE.LineSegments(new THREE.EdgesGeometry(square.geometry), new THREE.LineBasicMaterial({ color: PLANE }));
    const place = new THREE.Group();
    place.position.set(x, y, z);
    place.quaternion.set(i, j, l, w);
    const name = label(names[k] ?? "");
    name.position.set(PLANE_MM, PLANE_MM, 0);
    place.add(square, edge, name);
    group.add(place);
  }
  // One plane without a place hides none of the others.
  return { object: group, unknown: group.children.length === 0 ? unknown ?? "there are no planes" : null };
}

/**
 * Moves planes that are drawn already. False if they are others, or one of them has no place now.
 * @param {Drawn} drawn
 * @param {Item} item
 */
function move(drawn, item) {
  const rows = /** @type {Float64Array} */ (item.columns.isometries.rows);
  const { children, userData } = drawn.object;
  if (userData.names !== item.fields.names || rows.length !== 7 * children.length || !rows.every(Number.isFinite)) return false;
  children.forEach((place, k) => {
    place.position.fromArray(rows, 7 * k);
    place.quaternion.fromArray(rows, 7 * k + 3);
  });
  drawn.unknown = null;
  return true;
}

/** @type {THREE.Texture | null} */
let stripes = null;

/** Planes of a doubtful answer are hatched. @param {THREE.Object3D} object @param {boolean} isDoubtful */
function hatch(object, isDoubtful) {
  object.traverse((part) => {
    if (!(part instanceof THREE.Mesh) || !part.userData.isPlane || part.userData.isHatched === isDoubtful) return;
    part.userData.isHatched = isDoubtful;
    stripes ??= stripeTexture();
    part.material.alphaMap = isDoubtful ? stripes : null;
    part.material.opacity = isDoubtful ? 0.8 : 0.35;
    part.material.needsUpdate = true;
  });
}

function stripeTexture() {
  const canvas = document.createElement("canvas");
  canvas.width = canvas.height = 64;
  const context = /** @type {CanvasRenderingContext2D} */ (canvas.getContext("2d"));
  context.fillRect(0, 0, 64, 64);
  context.strokeStyle = "white";
  context.lineWidth = 10;
  for (let k = -64; k <= 64; k += 32) {
    context.beginPath();
    context.moveTo(k, 64);
    context.lineTo(k + 64, 0);
    context.stroke();
  }
  const texture = new THREE.CanvasTexture(canvas);
  texture.wrapS = texture.wrapT = THREE.RepeatWrapping;
  texture.repeat.set(4, 4);
  return texture;
}

/** A name that faces the viewer. @param {string} text */
export function label(text) {
  const canvas = document.createElement("canvas");
  const context = /** @type {CanvasRenderingContext2D} */ (canvas.getContext("2d"));
  const font = "600 40px system-ui, sans-serif";
  context.font = font;
  canvas.width = Math.max(8, Math.ceil(context.measureText(text).width) + 16);
  canvas.height = 52;
  context.font = font;
  context.lineWidth = 6;
  context.strokeStyle = "white";
  context.fillStyle = "#1f2328";
  context.strokeText(text, 8, 40);
  context.fillText(text, 8, 40);
  const material = new THREE.SpriteMaterial({ map: new THREE.CanvasTexture(canvas), depthTest: false, sizeAttenuation: false });
  const sprite = new THREE.Sprite(material);
  // In shares of the view's height. The parent's scale is that of millimetres.
  const height = 0.022 / MM;
  sprite.scale.set((height * canvas.width) / canvas.height, height, 1);
  sprite.center.set(-0.05, 0.2);
  return sprite;
}

/** @param {THREE.Object3D} object */
function dispose(object) {
  object.traverse((part) => {
    if (part instanceof THREE.Mesh || part instanceof THREE.Points || part instanceof THREE.LineSegments) part.geometry.dispose();
    const { material } = /** @type {any} */ (part);
    if (!material) return;
    if (part instanceof THREE.Sprite) material.map?.dispose();
    material.dispose();
  });
}


// What is drawn of an item: surfaces, clouds, points and planes, in the item's own coordinates, mm.

import * as THREE from "three";

/** @typedef {import("./message.js").Item} Item */
/** @typedef {import("./scene.js").Drawn} Drawn */
/** @typedef {import("./verdict.js").PredictedPoint} PredictedPoint */

/** Millimetres in the scene's metres. */
export const MM = 0.001;
/** Half the side of a drawn plane, mm: a bone's width and some. */
export const PLANE_MM = 18;
/** How far what is on a surface is drawn before it, mm. */
export const FORTH_MM = 1;
/** Colours that differ in lightness too, for those who cannot tell red from green. */
export const BONE = 0xd9cfbb, PLANE = 0x8a3ffc, POINT = 0xd55e00, ELLIPSOID = 0x005f73;

/** The grey of points whose distance from the bone is not known. */
export const UNKNOWN = 0x8c9199;

/**
 * @param {string} payload
 * @param {Item} item
 * @returns {{object: THREE.Object3D, unknown: string | null} | null}
 */
export function make(payload, item) {
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
export function surface(item, colour = BONE) {
  const { origin, attribute } = positions(/** @type {Float64Array} */ (item.columns.vertices.rows));
  const geometry = new THREE.BufferGeometry().setAttribute("position", attribute);
  geometry.setIndex(new THREE.BufferAttribute(/** @type {Uint32Array} */ (item.columns.faces.rows).slice(), 1));
  geometry.computeVertexNormals();
  const material = new THREE.MeshLambertMaterial({ color: colour, side: THREE.DoubleSide });
  return at(new THREE.Mesh(geometry, material), origin);
}

/** @param {Item} item */
function cloud(item) {
  const { origin, attribute } = positions(/** @type {Float64Array} */ (item.columns.points.rows));
  const geometry = new THREE.BufferGeometry().setAttribute("position", attribute);
  const material = new THREE.PointsMaterial({ color: UNKNOWN, size: 2, sizeAttenuation: false });
  const object = at(new THREE.Points(geometry, material), origin);
  object.userData.forthMm = FORTH_MM;
  return object;
}

const BALL = new THREE.SphereGeometry(1.2, 16, 12);

/**
 * Puts the points of an item into a group, beside those of other names that its wire gave before: the three laser points come one
 * by one.
 * @param {THREE.Object3D} group
 * @param {Item} item
 */
export function addPoints(group, item) {
  const rows = /** @type {Float64Array} */ (item.columns.positions.rows);
  const names = String(item.fields.names ?? "").split("\n");
  group.userData.forthMm = FORTH_MM;
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

const SPHERE = new THREE.SphereGeometry(1, 32, 24);
/** A ball in an ellipsoid has at most this share of its shortest semi-axis. */
const SMALL = 0.3;

/**
 * Draws the ellipsoid of the predicted error about each point that has one, true to scale and seen through the bone, and takes others away.
 * @param {THREE.Object3D} group points
 * @param {readonly PredictedPoint[]} errors
 */
export function ellipsoids(group, errors) {
  const { userData } = group;
  /** @type {Map<string, THREE.Object3D[]>} */
  const parts = userData.parts ?? new Map();
  if (userData.errors === errors && userData.nWithErrors === parts.size) return;
  Object.assign(userData, { errors, nWithErrors: parts.size });
  for (const [name, all] of parts) {
    const [ball] = all;
    for (const old of all.splice(2)) {
      group.remove(old);
      dispose(old);
    }
    const { semi_axes_mm: axes, directions } = errors.find((error) => error.name === name) ?? { semi_axes_mm: [], directions: [] };
    const isKnown = axes.length === 3 && axes.every((mm) => mm > 0);
    ball.scale.setScalar(isKnown ? Math.min(1, (SMALL * Math.min(...axes)) / BALL.parameters.radius) : 1);
    if (!isKnown) continue;
    const material = new THREE.MeshLambertMaterial({ color: ELLIPSOID, transparent: true, opacity: 0.45, depthTest: false, depthWrite: false });
    const ellipsoid = new THREE.Mesh(SPHERE, material);
    const [longest, middle] = directions.map((direction) => new THREE.Vector3(...direction));
    // The third direction may be the opposite one, which is the same ellipsoid.
    ellipsoid.quaternion.setFromRotationMatrix(new THREE.Matrix4().makeBasis(longest, middle, longest.clone().cross(middle)));
    ellipsoid.scale.fromArray(axes);
    ellipsoid.position.copy(ball.position);
    ellipsoid.renderOrder = 1;
    ellipsoid.userData.isEllipsoid = true;
    all.push(ellipsoid);
    group.add(ellipsoid);
  }
}

/** @param {Item} item */
export function planes(item, colour = PLANE) {
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
      new THREE.MeshBasicMaterial({ color: colour, transparent: true, opacity: 0.35, side: THREE.DoubleSide, depthWrite: false }),
    );
    square.userData.isPlane = true;
    const edge = new THREE.LineSegments(new THREE.EdgesGeometry(square.geometry), new THREE.LineBasicMaterial({ color: colour }));
    const place = new THREE.Group();
    place.position.set(x, y, z);
    place.quaternion.set(i, j, l, w);
    place.add(square, edge);
    if (names[k]) {
      const name = label(names[k]);
      name.position.set(PLANE_MM, PLANE_MM, 0);
      place.add(name);
    }
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
export function move(drawn, item) {
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
export function hatch(object, isDoubtful) {
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
  const map = new THREE.CanvasTexture(canvas);
  map.colorSpace = THREE.SRGBColorSpace;
  const material = new THREE.SpriteMaterial({ map, depthTest: false, sizeAttenuation: false });
  const sprite = new THREE.Sprite(material);
  // In shares of the view's height. The parent's scale is that of millimetres.
  const height = 0.022 / MM;
  sprite.scale.set((height * canvas.width) / canvas.height, height, 1);
  sprite.userData.size = sprite.scale.toArray();
  sprite.center.set(-0.05, 0.2);
  return sprite;
}

/** @param {THREE.Object3D} object */
export function dispose(object) {
  object.traverse((part) => {
    if (part instanceof THREE.Mesh || part instanceof THREE.Points || part instanceof THREE.LineSegments) part.geometry.dispose();
    const { material } = /** @type {any} */ (part);
    if (!material) return;
    if (part instanceof THREE.Sprite) material.map?.dispose();
    material.dispose();
  });
}


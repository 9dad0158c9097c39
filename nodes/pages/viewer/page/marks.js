// How picked points, rulers and planes are drawn, in the coordinates of what they were picked on.

import * as THREE from "three";
import { MM, PLANE, PLANE_MM, POINT, label } from "./drawables.js";
import { height, normalOf, sides } from "./picks.js";
import { plus } from "./surface.js";

/** @typedef {import("./picks.js").Picked} Picked */
/** @typedef {import("./picks.js").Group} Group */
/** @typedef {import("./picks.js").Bearings} Bearings */
/** @typedef {import("./surface.js").Surface} Surface */
/** @typedef {import("./surface.js").Vector} Vector */

/** Colours that differ in lightness; each group has a shape of its own, too. @type {Record<Group, number>} */
const COLOURS = { landmarks: POINT, assessment: 0x005f73, tip: 0x9b2a8f, bone: POINT, scan: POINT };
/** Height of a mark in shares of the view's. */
const MARK = 0.03;
const LINE = 0x3d2b1f;

/** @type {Map<string, THREE.Texture>} */
const textures = new Map();

/** The mark of a group: a shape with its place in the middle. @param {Group} group @param {boolean} isSelected */
function texture(group, isSelected) {
  const key = `${group} ${isSelected}`;
  const known = textures.get(key);
  if (known) return known;
  const canvas = document.createElement("canvas");
  canvas.width = canvas.height = 64;
  const context = /** @type {CanvasRenderingContext2D} */ (canvas.getContext("2d"));
  context.translate(32, 32);
  const outline = () => {
    context.beginPath();
    if (group === "assessment") context.rect(-18, -18, 36, 36);
    else if (group === "tip") [[0, -24], [22, 16], [-22, 16], [0, -24]].forEach(([x, y]) => context.lineTo(x, y));
    else context.arc(0, 0, 20, 0, 2 * Math.PI);
  };
  for (const [width, style] of /** @type {const} */ ([[isSelected ? 14 : 9, isSelected ? "#ffd400" : "white"], [5, `#${COLOURS[group].toString(16).padStart(6, "0")}`]])) {
    outline();
    context.lineWidth = width;
    context.strokeStyle = style;
    context.stroke();
  }
  context.beginPath();
  context.arc(0, 0, 4, 0, 2 * Math.PI);
  context.fillStyle = "black";
  context.fill();
  const made = new THREE.CanvasTexture(canvas);
  textures.set(key, made);
  return made;
}

/** @param {Group} group @param {Vector} at @param {boolean} isSelected */
function mark(group, at, isSelected) {
  const material = new THREE.SpriteMaterial({ map: texture(group, isSelected), depthTest: false, sizeAttenuation: false, transparent: true });
  const sprite = new THREE.Sprite(material);
  sprite.scale.setScalar(MARK / MM);
  sprite.userData.size = sprite.scale.toArray();
  sprite.position.fromArray(at);
  sprite.renderOrder = 3;
  return sprite;
}

/** @param {Vector[]} ends two by two @param {number} colour @param {boolean} isSeenThrough */
function lines(ends, colour, isSeenThrough) {
  const geometry = new THREE.BufferGeometry().setAttribute("position", new THREE.Float32BufferAttribute(ends.flat(), 3));
  const material = new THREE.LineBasicMaterial({ color: colour, depthTest: !isSeenThrough });
  const made = new THREE.LineSegments(geometry, material);
  made.renderOrder = 2;
  return made;
}

/** @param {string} text @param {Vector} at */
function text(text, at) {
  const made = label(text);
  made.position.fromArray(at);
  made.renderOrder = 4;
  return made;
}

/** Of a pair both points are selected. @param {Group} group */
function isPair(group) { return group === "bone" || group === "scan"; }

/**
 * Marks of points, each with its name; those that the bone hides can be faded.
 * @param {Picked} picked
 * @param {Group[]} groups
 * @param {{group: Group, name: string} | null} selected
 */
export function drawPoints(picked, groups, selected) {
  const object = new THREE.Group();
  /** @type {{position: Vector, sprites: THREE.Sprite[]}[]} */
  const marks = [];
  for (const group of groups) {
    for (const { name, position } of picked[group]) {
      const sprites = [mark(group, position, selected?.name === name && (isPair(group) || selected.group === group)), text(name, position)];
      object.add(...sprites);
      marks.push({ position, sprites });
    }
  }
  return { object, marks };
}

/**
 * The ruler along the bone, from the tip to the first landmark, and the sides of the triangle; the lengths of sides with their ends, as short
 * ones have no room for them.
 * @param {Picked} picked
 * @param {Bearings} of
 */
export function drawRulers(picked, of) {
  const object = new THREE.Group();
  /** @type {{from: Vector, to: Vector, sprite: THREE.Sprite}[]} */
  const lengths = [];
  const [first] = picked.landmarks;
  if (of.tip && first) {
    const mm = height(of, first.position);
    const above = plus(of.tip, of.along, mm);
    object.add(lines([of.tip, above, above, first.position], LINE, true), text(`${mm.toFixed(1)} mm`, plus(of.tip, of.along, mm / 2)));
  }
  for (const { from, to, mm } of sides(picked.landmarks.slice(0, 3), of.along)) {
    const middle = plus(from.position, to.position).map((c) => c / 2);
    const sprite = text(`${mm.toFixed(1)}`, middle);
    lengths.push({ from: from.position, to: to.position, sprite });
    object.add(lines([from.position, to.position], LINE, true), sprite);
  }
  return { object, lengths };
}

/** The planes, with the outline in which each cuts the bone. @param {Picked} picked @param {Surface} surface @param {string | null} selected */
export function drawPlanes(picked, surface, selected) {
  const object = new THREE.Group();
  for (const plane of picked.planes) {
    const cut = surface.section(plane.origin, normalOf(plane));
    const square = new THREE.Mesh(
      new THREE.PlaneGeometry(2 * PLANE_MM, 2 * PLANE_MM),
      new THREE.MeshBasicMaterial({ color: PLANE, transparent: true, opacity: plane.name === selected ? 0.3 : 0.12, side: THREE.DoubleSide, depthWrite: false }),
    );
    const place = new THREE.Group();
    place.position.fromArray(cut?.middle ?? plane.origin);
    place.quaternion.fromArray(plane.rotation);
    const edge = new THREE.LineSegments(new THREE.EdgesGeometry(square.geometry), new THREE.LineBasicMaterial({ color: PLANE }));
    const name = text(plane.name, [PLANE_MM, PLANE_MM, 0]);
    place.add(square, edge, name);
    object.add(place);
    if (cut) object.add(lines(cut.edges, PLANE, false));
  }
  return object;
}

// The layers of a view: items of recorded wires as the live page gets them, and drawings of the report's own.

import * as THREE from "three";
import { FORTH_MM, label, planes, surface } from "./drawables.js";
import { showItem } from "./layers.js";
import { readItem } from "./message.js";
import { RESIDUAL_MM, scaleColours } from "./residual_colours.js";

/** @typedef {import("./message.js").Item} Item */
/** @typedef {{scene: import("./scene.js").Scene, frames: import("./frames.js").Frames, devices: import("./devices.js").Devices}} View */

/** The frame of the report's own drawings. */
const FRAME = "ct";

/** @param {string} text */
const bytes = (text) => Uint8Array.from(atob(text), (c) => c.charCodeAt(0));

/** Coordinates, mm. @param {any} data */
function coordinates(data) {
  const raw = new Uint16Array(bytes(data.positions).buffer);
  return Float64Array.from(raw, (c, k) => c * data.step + data.low[k % 3]);
}

/** @param {any} data @param {number} nVertices */
function faces(data, nVertices) {
  const { buffer } = bytes(data.faces);
  return nVertices < 65536 ? Uint32Array.from(new Uint16Array(buffer)) : new Uint32Array(buffer);
}

/** Values from -1 to 1, NaN where there is none. @param {string} text */
const values = (text) => Float32Array.from(bytes(text), (level) => (level === 0 ? NaN : (level - 128) / 127));

/** @param {string} frame @param {Item["columns"]} columns @returns {Item} */
const itemOf = (frame, columns) => ({ stampNs: 0n, number: 0n, empty: null, payload: null, fields: { frame }, columns });

/** @param {string} frame @param {any} data */
function meshItem(frame, data) {
  const rows = coordinates(data);
  return itemOf(frame, { vertices: { width: 3, rows }, faces: { width: 3, rows: faces(data, rows.length / 3) } });
}

/**
 * Shows what the live page shows of the run.
 * @param {View} view
 * @param {any} picture
 * @param {Record<string, any>} shared
 */
export function showPicture(view, { transforms, items, origin }, shared) {
  const { scene, frames, devices } = view;
  frames.origin = origin;
  for (const { wire, ...transform } of transforms) frames.place(wire, transform);
  for (const { wire, payload, message, frame, own, shared: name } of items) {
    let item;
    if (message) item = readItem(new DataView(bytes(message).buffer));
    else if (name) item = meshItem(frame, shared[name]);
    else item = itemOf(frame, { points: { width: 3, rows: coordinates(own) } });
    showItem(view, wire, payload, item);
    if (own?.values) scene.colours.colour(wire, values(own.values).map((share) => share * RESIDUAL_MM));
    devices.item(payload, item);
  }
}

/**
 * Shows the report's own layers; parts of one name are one layer.
 * @param {View} view
 * @param {any[]} parts
 * @param {Record<string, any>} shared
 */
export function showParts({ scene }, parts, shared) {
  const layers = new Map();
  for (const part of parts) {
    const layer = layers.get(part.name) ?? { object: new THREE.Group(), payload: "drawing" };
    layers.set(part.name, layer);
    // Lines are seen where the surface is a little over them.
    if (part.type === "balls" || part.type === "lines") layer.object.userData.forthMm = part.type === "balls" ? FORTH_MM : 0.3;
    if (part.type === "planes") layer.payload = "geometry/Planes";
    if (part.type === "mesh" && !(part.own?.values)) layer.payload = "geometry/Mesh";
    layer.object.add(...drawing(part, shared));
  }
  for (const [name, { object, payload }] of layers) {
    scene.put(name, object, { frame: FRAME, payload, shown: true });
    if (payload === "geometry/Mesh") scene.glaze(object);
  }
}

/** @param {any} part @param {Record<string, any>} shared @returns {THREE.Object3D[]} */
function drawing(part, shared) {
  const data = part.own ?? shared[part.shared];
  switch (part.type) {
    case "mesh": {
      const object = surface(meshItem(FRAME, data), new THREE.Color(part.colour ?? "white").getHex());
      const mesh = /** @type {THREE.Mesh<THREE.BufferGeometry, THREE.MeshLambertMaterial>} */ (object.children[0]);
      if (data.values) {
        mesh.geometry.setAttribute("color", scaleColours(values(data.values), 1));
        mesh.material.vertexColors = true;
      }
      return [...object.children];
    }
    case "planes": {
      const item = itemOf(FRAME, { isometries: { width: 7, rows: Float64Array.from(part.rows) } });
      item.fields.names = part.names;
      return [...planes(item, new THREE.Color(part.colour).getHex()).object.children];
    }
    case "balls": return balls(coordinates(data), part.radius, part.colour);
    case "lines": {
      const ends = new THREE.Float32BufferAttribute(coordinates(data), 3);
      const geometry = new THREE.BufferGeometry().setAttribute("position", ends);
      return [new THREE.LineSegments(geometry, new THREE.LineBasicMaterial({ color: part.colour }))];
    }
    case "tag": {
      const name = label(part.word);
      name.position.fromArray(part.at);
      return [name];
    }
    default: throw new Error(`a layer of type ${part.type}`);
  }
}

/** @param {Float64Array} rows @param {number} radius @param {string} colour */
function balls(rows, radius, colour) {
  const [shape, material] = [new THREE.SphereGeometry(radius, 16, 12), new THREE.MeshLambertMaterial({ color: colour })];
  return Array.from({ length: rows.length / 3 }, (_, k) => {
    const ball = new THREE.Mesh(shape, material);
    ball.position.fromArray(rows, 3 * k);
    return ball;
  });
}

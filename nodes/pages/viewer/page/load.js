// Regions and plans that were saved earlier, from their files (docs/use/formats.md).

import { Matrix4, Quaternion } from "three";

/** @typedef {import("./shapes.js").Shape} Shape */
/** @typedef {import("./picks.js").Pick} Pick */
/** @typedef {import("./picks.js").Plane} Plane */

/** The keys of each shape, with the numbers of a list; 0 for a number, null for a list of lists. */
const SHAPES = {
  box: { min: 3, max: 3 },
  slab: { origin: 3, direction: 3, from: 0, to: 0 },
  brush: { centres: null, radius: 0 },
  outline: { eye: 3, right: 3, down: 3, corners: null },
};

/** @param {string} text @returns {Record<string, any>} */
function json(text) {
  let read;
  try {
    read = JSON.parse(text);
  } catch (error) {
    throw new Error(`it is no JSON: ${error instanceof Error ? error.message : error}`, { cause: error });
  }
  if (typeof read !== "object" || read === null || Array.isArray(read)) throw new Error("an object is expected");
  return read;
}

/** @param {unknown} value @param {number} n @param {string} where @returns {number[]} */
function numbers(value, n, where) {
  if (Array.isArray(value) && value.length === n && value.every(Number.isFinite)) return value;
  throw new Error(`${where}: ${n} numbers are expected, found ${JSON.stringify(value) ?? "nothing"}`);
}

/**
 * The shapes of a region's file.
 * @param {string} text
 * @param {string} frame of the cloud that is drawn on
 * @returns {{shape: Shape, keeps: boolean}[]}
 */
export function readRegion(text, frame) {
  const read = json(text);
  if (read.format !== "osteoflow-region") throw new Error("it is no region: its format is not osteoflow-region; choose a region.json that this page saved");
  if (read.version !== 1 || read.units !== "mm") throw new Error(`version 1 in mm is expected, found version ${read.version} in ${read.units}`);
  if (read.frame !== frame) throw new Error(`the region was drawn in frame ${read.frame}, but this cloud is in ${frame}; load it on a cloud of that frame`);
  const of = (/** @type {string} */ key) => (read[key] ?? []).map((/** @type {any} */ shape, /** @type {number} */ k) => {
    const keys = Object.hasOwn(SHAPES, shape?.shape) ? SHAPES[/** @type {keyof typeof SHAPES} */ (shape.shape)] : null;
    const where = `${key}[${k}]`;
    if (!keys) throw new Error(`${where}: ${JSON.stringify(shape?.shape) ?? "nothing"} is no shape; known are ${Object.keys(SHAPES).join(", ")}`);
    for (const [name, n] of Object.entries(keys)) {
      if (n === 0 && !Number.isFinite(shape[name])) throw new Error(`${where}.${name}: a number is expected`);
      if (n !== null && n > 0) numbers(shape[name], n, `${where}.${name}`);
      if (n === null) [shape[name]].flat().forEach((one, i) => numbers(one, shape.shape === "outline" ? 2 : 3, `${where}.${name}[${i}]`));
    }
    return { shape, keeps: key === "keep" };
  });
  const all = [...of("keep"), ...of("cut")];
  if (all.length === 0) throw new Error("it has no shapes");
  return all;
}

/**
 * The points and planes of a plan's file.
 * @param {string} text
 * @returns {{landmarks: Pick[], assessment: Pick[], tip: Pick[], planes: Plane[]}}
 */
export function readPlan(text) {
  const read = json(text);
  if (read.units !== undefined && read.units !== "mm") throw new Error(`lengths in mm are expected, found ${read.units}`);
  const points = (/** @type {string} */ key) =>
    Object.entries(read[key] ?? {}).map(([name, at]) => ({ name, position: numbers(at, 3, `${key}.${name}`) }));
  const entries = Array.isArray(read.planes)
    ? read.planes.map((entry, k) => [entry?.name ?? `plane_${k + 1}`, entry?.matrix ?? entry])
    : Object.entries(read.planes ?? {});
  const planes = entries.map(([name, matrix]) => {
    const rows = numbers(Array.isArray(matrix) ? matrix.flat() : matrix, 16, `planes.${name}`);
    const rotation = new Quaternion().setFromRotationMatrix(new Matrix4().fromArray(rows).transpose());
    return { name: String(name), origin: [rows[3], rows[7], rows[11]], rotation: rotation.toArray() };
  });
  const tip = read.malleolus_tip ? [{ name: "malleolus tip", position: numbers(read.malleolus_tip, 3, "malleolus_tip") }] : [];
  const found = { landmarks: points("landmarks"), assessment: points("assessment"), tip, planes };
  if (found.landmarks.length + found.assessment.length + planes.length === 0) throw new Error("it has no landmarks, assessment points or planes");
  return found;
}

/**
 * A field to choose a file.
 * @param {string} id
 * @param {string} label
 * @param {(text: string, name: string) => void} take
 */
export function fileField(id, label, take) {
  const made = document.createElement("label");
  const input = document.createElement("input");
  Object.assign(input, { id, type: "file", accept: ".json" });
  input.onchange = async () => {
    const file = input.files?.[0];
    if (file) take(await file.text(), file.name);
  };
  made.append(`${label} `, input);
  return made;
}

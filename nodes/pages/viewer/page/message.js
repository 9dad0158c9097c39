// Messages of recordings: the exact ones (docs/use/recording.md), and transforms of viewers (protobuf foxglove.FrameTransform).

/**
 * An item of a wire.
 * @typedef {object} Item
 * @property {bigint} stampNs
 * @property {bigint} number
 * @property {{node: string, reason: string} | null} empty why there is no value
 * @property {string | null} payload the payload that it names, on a wire that takes any
 * @property {Record<string, boolean | bigint | number | number[] | string>} fields
 * @property {Record<string, {width: number, rows: Float64Array | Float32Array | BigInt64Array | Uint32Array | Uint8Array}>} columns
 */

/** A transform: takes coordinates in `child` to coordinates in `parent`; metres.
 * @typedef {{parent: string, child: string, translation: number[], rotation: number[]}} Transform
 */

const MAGIC = "OSTEOVW1";
/** Bytes before an item: the head of a sequence of bytes in CDR. Recordings before format 3 have none. */
const FRAME_BYTES = 8;
const CDR_HEAD = 0x00010000;
const EMPTY = 1;
const NAMED = 2;
const MAX_PARTS = 65536;
const COLUMNS = [null, Float64Array, Float32Array, BigInt64Array, Uint32Array, Uint8Array];

/** Reads bytes from the front; throws past the end. */
class Bytes {
  /** @param {DataView} view */
  constructor(view) {
    this.view = view;
    this.at = 0;
  }

  /** @param {number} n */
  take(n) {
    const at = this.at;
    if (!(n >= 0) || at + n > this.view.byteLength) throw new Error("a message is cut short");
    this.at += n;
    return at;
  }

  u8() { return this.view.getUint8(this.take(1)); }
  u32() { return this.view.getUint32(this.take(4), true); }
  i64() { return this.view.getBigInt64(this.take(8), true); }
  u64() { return this.view.getBigUint64(this.take(8), true); }
  f64() { return this.view.getFloat64(this.take(8), true); }

  text() {
    const n = this.u32();
    const at = this.take(n);
    return new TextDecoder("utf-8", { fatal: true }).decode(new Uint8Array(this.view.buffer, this.view.byteOffset + at, n));
  }
}

/** The payload that the schema of an exact channel names: `geometry/msg/CloudV1`, before format 3 `geometry/Cloud@1`. @param {string} schemaName */
export const payloadOf = (schemaName) => schemaName.replace(/^(.+)\/msg\/(.+)V\d+$/, "$1/$2").split("@")[0];

/**
 * Reads an exact message. Columns are copied only where they are not aligned.
 * @param {DataView} view
 * @returns {Item}
 */
export function readItem(view) {
  if (view.byteLength >= FRAME_BYTES && view.getUint32(0, false) === CDR_HEAD && view.getUint32(4, true) === view.byteLength - FRAME_BYTES) {
    view = new DataView(view.buffer, view.byteOffset + FRAME_BYTES, view.byteLength - FRAME_BYTES);
  }
  const bytes = new Bytes(view);
  const buffer = /** @type {ArrayBuffer} */ (view.buffer);
  const magic = String.fromCharCode(...new Uint8Array(view.buffer, view.byteOffset + bytes.take(8), 8));
  if (magic !== MAGIC) throw new Error("a message is no recorded item");
  const stampNs = bytes.i64();
  const number = bytes.u64();
  const body = bytes.u8();
  bytes.take(3);
  const nFields = bytes.u32();
  const nColumns = bytes.u32();
  bytes.take(4);
  if (nFields > MAX_PARTS || nColumns > MAX_PARTS) throw new Error("a message is damaged");
  /** @type {Item} */
  const item = { stampNs, number, empty: null, payload: null, fields: {}, columns: {} };
  if (body === EMPTY) {
    item.empty = { node: bytes.text(), reason: bytes.text() };
    return item;
  }
  if (body === NAMED) {
    item.payload = bytes.text();
    bytes.u32();
  }
  for (let n = 0; n < nFields; n++) {
    const type = bytes.u8();
    item.fields[bytes.text()] = readField(bytes, type);
  }
  for (let n = 0; n < nColumns; n++) {
    const name = bytes.text();
    const Rows = COLUMNS[bytes.u8()];
    const width = bytes.u32();
    const size = Number(bytes.u64());
    bytes.take((8 - (bytes.at % 8)) % 8);
    const at = view.byteOffset + bytes.take(size);
    if (!Rows || size % Rows.BYTES_PER_ELEMENT !== 0) throw new Error("a column is damaged");
    const length = size / Rows.BYTES_PER_ELEMENT;
    const aligned = at % Rows.BYTES_PER_ELEMENT === 0;
    const rows = aligned ? new Rows(buffer, at, length) : new Rows(buffer.slice(at, at + size));
    item.columns[name] = { width, rows };
  }
  return item;
}

/**
 * @param {Bytes} bytes
 * @param {number} type
 */
function readField(bytes, type) {
  switch (type) {
    case 1: return bytes.u8() !== 0;
    case 2: return bytes.i64();
    case 3: return bytes.f64();
    case 4: {
      const n = bytes.u32();
      if (n * 8 > bytes.view.byteLength) throw new Error("a list is cut short");
      return Array.from({ length: n }, () => bytes.f64());
    }
    case 5: return bytes.text();
    default: throw new Error("a field is damaged");
  }
}

/**
 * Reads a foxglove.FrameTransform.
 * @param {DataView} view
 * @returns {Transform}
 */
export function readTransform(view) {
  const transform = { parent: "", child: "", translation: [0, 0, 0], rotation: [0, 0, 0, 1] };
  for (const [field, value] of protobuf(view)) {
    if (field === 2) transform.parent = decode(value);
    if (field === 3) transform.child = decode(value);
    if (field === 4) transform.translation = doubles(value, 3);
    if (field === 5) transform.rotation = doubles(value, 4);
  }
  return transform;
}

/** @param {DataView | number} value */
function decode(value) {
  if (typeof value === "number") throw new Error("a text is expected");
  return new TextDecoder().decode(value);
}

/** The doubles of a message, by their field numbers from 1. Those that are zero are left out by protobuf.
 * @param {DataView | number} value
 * @param {number} n
 */
function doubles(value, n) {
  if (typeof value === "number") throw new Error("a message is expected");
  const all = new Array(n).fill(0);
  for (const [field, number] of protobuf(value)) if (field <= n && typeof number === "number") all[field - 1] = number;
  return all;
}

/** The fields of a protobuf message: doubles as numbers, messages and texts as their bytes; others are passed over.
 * @param {DataView} view
 * @returns {Generator<[number, DataView | number]>}
 */
function* protobuf(view) {
  const bytes = new Bytes(view);
  while (bytes.at < view.byteLength) {
    const key = varint(bytes);
    const field = key >>> 3;
    switch (key & 7) {
      case 0: varint(bytes); break;
      case 1: yield [field, bytes.f64()]; break;
      case 2: {
        const n = varint(bytes);
        yield [field, new DataView(view.buffer, view.byteOffset + bytes.take(n), n)];
        break;
      }
      case 5: bytes.take(4); break;
      default: throw new Error("a message is no protobuf");
    }
  }
}

/** @param {Bytes} bytes */
function varint(bytes) {
  let value = 0;
  for (let shift = 0; shift < 70; shift += 7) {
    const byte = bytes.u8();
    if (shift < 28) value |= (byte & 127) << shift;
    if (byte < 128) return value >>> 0;
  }
  throw new Error("a message is no protobuf");
}

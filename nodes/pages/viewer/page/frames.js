// The tree of frames, from the transforms of viewers; metres.

import { Matrix4, Quaternion, Vector3 } from "three";

/** @typedef {import("./message.js").Transform} Transform */

export class Frames {
  constructor() {
    /** The edge to the parent of each frame, and the wire that placed it. @type {Map<string, {parent: string, matrix: Matrix4, wire: string}>} */
    this.edges = new Map();
    /** Why a wire has no value now. @type {Map<string, string>} */
    this.unknown = new Map();
  }

  clear() {
    this.edges.clear();
    this.unknown.clear();
  }

  /**
   * @param {string} wire
   * @param {Transform} transform
   */
  place(wire, { parent, child, translation, rotation }) {
    const matrix = new Matrix4().compose(new Vector3(...translation), new Quaternion(...rotation), new Vector3(1, 1, 1));
    this.edges.set(child, { parent, matrix, wire });
  }

  /** The frames from one to the top of its chain. @param {string} frame */
  chain(frame) {
    const all = [frame];
    for (let edge = this.edges.get(frame); edge && all.length <= this.edges.size; edge = this.edges.get(edge.parent)) all.push(edge.parent);
    return all;
  }

  /** The frame at the top of a frame's chain. @param {string} frame */
  root(frame) {
    let at = frame;
    for (let n = 0; n <= this.edges.size; n++) {
      const edge = this.edges.get(at);
      if (!edge) return at;
      at = edge.parent;
    }
    throw new Error(`frame ${frame} is in a circle`);
  }

  /**
   * Takes coordinates in `frame` to those in its root; with the reason if a wire on the way has no value now.
   * @param {string} frame
   * @returns {{root: string, matrix: Matrix4, unknown: string | null}}
   */
  toRoot(frame) {
    const matrix = new Matrix4();
    let unknown = null;
    let at = frame;
    for (let n = 0; n <= this.edges.size; n++) {
      const edge = this.edges.get(at);
      if (!edge) return { root: at, matrix, unknown };
      matrix.premultiply(edge.matrix);
      unknown ??= this.unknown.get(edge.wire) ?? null;
      at = edge.parent;
    }
    throw new Error(`frame ${frame} is in a circle`);
  }
}

// The tree of frames, from the transforms of viewers; metres.

import { Matrix4, Quaternion, Vector3 } from "three";

/** @typedef {import("./message.js").Transform} Transform */

export class Frames {
  constructor() {
    /** The edge to the parent of each frame, and the wire that placed it. @type {Map<string, {parent: string, matrix: Matrix4, wire: string}>} */
    this.edges = new Map();
    /** Why a wire has no value now. @type {Map<string, string>} */
    this.unknown = new Map();
    /** The tracker's frame, in which all is shown that is connected to it, whatever the top of the tree is. @type {string | null} */
    this.origin = null;
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

  /** The frames that place one: up from it, and down to the tracker's. @param {string} frame */
  chain(frame) {
    const { up, down } = this.way(frame);
    return [frame, ...up, ...down];
  }

  /** The frame at the top of a frame's chain, or the tracker's, if that is connected to it. @param {string} frame */
  root(frame) {
    return this.way(frame).root;
  }

  /**
   * The frames below the top of a frame's chain that lead there, the frame itself first, and the top.
   * @param {string} frame
   */
  path(frame) {
    /** @type {string[]} */
    const below = [];
    let at = frame;
    for (let n = 0; n <= this.edges.size; n++) {
      const edge = this.edges.get(at);
      if (!edge) return { below, top: at };
      below.push(at);
      at = edge.parent;
    }
    throw new Error(`frame ${frame} is in a circle`);
  }

  /** Takes coordinates from the lowest of these frames to the parent of the highest. @param {string[]} below */
  along(below) {
    const matrix = new Matrix4();
    for (const child of below) matrix.premultiply(/** @type {{matrix: Matrix4}} */ (this.edges.get(child)).matrix);
    return matrix;
  }

  /**
   * The way from a frame to its root: frames whose edges are gone up, those whose edges are gone down, and the root.
   * @param {string} frame
   */
  way(frame) {
    const { below: up, top } = this.path(frame);
    const of = this.origin === null ? null : this.path(this.origin);
    if (this.origin === null || of === null || of.top !== top) return { up, down: [], root: top };
    const down = of.below;
    // What both have in common is gone up and down again, and says nothing.
    while (up.length > 0 && up.at(-1) === down.at(-1)) {
      up.pop();
      down.pop();
    }
    return { up, down, root: this.origin };
  }

  /**
   * Takes coordinates in `frame` to those in its root; with the reason if a wire on the way has no value now.
   * @param {string} frame
   * @returns {{root: string, matrix: Matrix4, unknown: string | null}}
   */
  toRoot(frame) {
    const { up, down, root } = this.way(frame);
    const why = [...up, ...down].map((child) => this.unknown.get(this.edges.get(child)?.wire ?? ""));
    const matrix = this.along(up).premultiply(this.along(down).invert());
    return { root, matrix, unknown: why.find((reason) => reason !== undefined) ?? null };
  }
}

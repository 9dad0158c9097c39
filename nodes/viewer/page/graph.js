// The nodes of the graph: how often each has fired, how long it took, what it is for.

/** @typedef {{name: string, kind: string, role: string, summary: string | null, inputs: any[], outputs: any[], params: any[]}} Node */

/** Words for what a node does, with a shape for each. */
const STATES = { waiting: "\u25cb", fired: "\u25cf" };

export class GraphList {
  /** @param {HTMLElement} holder */
  constructor(holder) {
    this.holder = holder;
    /** @type {Map<string, {state: HTMLElement, numbers: HTMLElement}>} */
    this.nodes = new Map();
    /** @type {Record<string, [number, number, number]>} */
    this.sums = {};
    this.isDirty = false;
  }

  /** @param {{nodes: Node[]}} graph */
  show({ nodes }) {
    this.nodes.clear();
    this.holder.replaceChildren(
      ...nodes.map((node) => {
        const row = document.createElement("details");
        const head = document.createElement("summary");
        const [state, name, numbers] = ["i", "b", "span"].map((tag) => document.createElement(tag));
        name.textContent = node.name;
        head.append(state, name, numbers);
        row.append(head, details(node));
        this.nodes.set(node.name, { state, numbers });
        return row;
      }),
    );
    this.isDirty = true;
  }

  /** @param {Record<string, [number, number, number]>} sums firings, ms, drops of each node */
  count(sums) {
    this.sums = sums;
    this.isDirty = true;
  }

  draw() {
    if (!this.isDirty) return;
    this.isDirty = false;
    for (const [name, { state, numbers }] of this.nodes) {
      const [n, ms, drops] = this.sums[name] ?? [0, 0, 0];
      state.textContent = n > 0 ? STATES.fired : STATES.waiting;
      state.title = n > 0 ? "has fired" : "has not fired";
      const mean = n > 0 ? `${n} \u00d7 ${(ms / n).toPrecision(2)} ms` : "";
      numbers.textContent = drops > 0 ? `${mean}, ${drops} dropped` : mean;
    }
  }
}

/** @param {Node} node */
function details(node) {
  const holder = document.createElement("div");
  const line = (/** @type {string} */ tag, /** @type {string} */ text) => {
    const part = document.createElement(tag);
    part.textContent = text;
    holder.append(part);
    return part;
  };
  line("code", node.kind);
  if (node.summary) line("p", node.summary);
  for (const { name, from } of node.inputs) if (from) line("p", `${name} \u2190 ${from}`);
  for (const { name, payload } of node.outputs) line("p", `${name} \u2192 ${payload}`);
  for (const { name, value, default: usual, doc } of node.params) {
    const isUsual = JSON.stringify(value) === JSON.stringify(usual);
    const part = line("p", `${name} = ${JSON.stringify(value)}${isUsual ? "" : " *"}`);
    if (doc) part.title = doc;
  }
  return holder;
}

// The nodes of the graph: how often each has fired, how long it took, what it is for, and its parameters, which may be changed.

import { may, post } from "./request.js";
import { duration } from "./times.js";

/**
 * @typedef {{name: string, value: any, default: any, doc: string | null, minimum: number | null, maximum: number | null, words: string[]}} Param
 * @typedef {{name: string, kind: string, kinds: string[], role: string, summary: string | null, inputs: any[], outputs: any[], params: Param[]}} Node
 */

/** Words for what a node does, with a shape for each. */
const STATES = { waiting: "\u25cb", fired: "\u25cf" };

export class GraphList {
  /** @param {HTMLElement} holder */
  constructor(holder) {
    this.holder = holder;
    /** @type {Map<string, {row: HTMLDetailsElement, state: HTMLElement, numbers: HTMLElement}>} */
    this.nodes = new Map();
    /** @type {Node[]} */
    this.all = [];
    /** @type {Record<string, [number, number, number]>} */
    this.sums = {};
    this.isDirty = false;
    this.mayChange = false;
    this.shown = "";
  }

  /** Whether parameters are fields. @param {boolean} mayChange */
  allow(mayChange) {
    if (mayChange === this.mayChange) return;
    this.mayChange = mayChange;
    this.shown = "";
    this.show({ nodes: this.all });
  }

  /** @param {{nodes: Node[]}} graph */
  show({ nodes }) {
    this.all = nodes;
    // A run of the same graph leaves what is being typed.
    const shown = JSON.stringify(nodes);
    if (shown === this.shown) return;
    this.shown = shown;
    const open = new Set([...this.nodes].filter(([, { row }]) => row.open).map(([name]) => name));
    const focused = document.activeElement?.id;
    this.nodes.clear();
    this.holder.replaceChildren(
      ...nodes.map((node) => {
        const row = document.createElement("details");
        row.open = open.has(node.name);
        const head = document.createElement("summary");
        const [state, name, numbers] = ["i", "b", "span"].map((tag) => document.createElement(tag));
        name.textContent = node.name;
        head.append(state, name, numbers);
        row.append(head, this.details(node));
        this.nodes.set(node.name, { row, state, numbers });
        return row;
      }),
    );
    if (focused) document.getElementById(focused)?.focus();
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
      const mean = n > 0 ? n > 1 ? `${n} \u00d7 ${duration(ms / n)}` : duration(ms) : "";
      numbers.textContent = drops > 0 ? `${mean}, ${drops} dropped` : mean;
    }
  }

  /** @param {Node} node */
  details(node) {
    const holder = document.createElement("div");
    const line = (/** @type {string} */ tag, /** @type {string} */ text) => {
      const part = document.createElement(tag);
      part.textContent = text;
      holder.append(part);
      return part;
    };
    if (this.mayChange && node.kinds.length > 1) {
      const kind = { name: "kind", value: node.kind, default: node.kind, doc: null, minimum: null, maximum: null, words: node.kinds };
      holder.append(field(node.name, kind));
    } else line("code", node.kind);
    if (node.summary) line("p", node.summary);
    for (const { name, from } of node.inputs) if (from) line("p", `${name} \u2190 ${from}`);
    for (const { name, payload } of node.outputs) line("p", `${name} \u2192 ${payload}`);
    for (const param of node.params) {
      if (this.mayChange) {
        holder.append(field(node.name, param));
        continue;
      }
      const part = line("p", `${param.name} = ${JSON.stringify(param.value)}${isUsual(param) ? "" : " *"}`);
      if (param.doc) part.title = param.doc;
    }
    return holder;
  }
}

/** @param {Param} param */
function isUsual({ value, default: usual }) {
  return JSON.stringify(value) === JSON.stringify(usual);
}

/** Sets a key of the graph, which is then run again. @param {string} key @param {unknown} value null takes the change back */
export function change(key, value) {
  return post("set", { values: { [key]: value } });
}

/**
 * A field for a parameter; a value that the graph refuses is put back, with the reason.
 * @param {string} node
 * @param {Param} param
 */
function field(node, param) {
  const { name, value, doc, minimum, maximum, words } = param;
  const key = `${node}.${name}`;
  const holder = document.createElement("div");
  holder.className = "field";
  const label = document.createElement("label");
  label.textContent = name + (isUsual(param) ? "" : " *");
  const input = document.createElement(words.length > 0 ? "select" : "input");
  input.id = `field-${key}`;
  label.htmlFor = input.id;
  const fault = document.createElement("small");
  fault.className = "fault";
  fault.setAttribute("role", "alert");
  const put = () => {
    if (input instanceof HTMLInputElement && input.type === "checkbox") input.checked = value === true;
    else input.value = typeof value === "number" || typeof value === "string" ? String(value) : JSON.stringify(value);
  };
  if (input instanceof HTMLSelectElement) input.append(...words.map((word) => new Option(word)));
  else if (typeof value === "boolean") input.type = "checkbox";
  else if (typeof value === "number") {
    input.type = "number";
    input.step = "any";
    if (minimum !== null) input.min = String(minimum);
    if (maximum !== null) input.max = String(maximum);
  }
  put();
  // A free text may be a path.
  input.disabled = !may("write") && !(words.length > 0 || typeof value === "number" || typeof value === "boolean");
  input.onchange = async () => {
    fault.textContent = "";
    try {
      await change(key, read(input, value));
    } catch (error) {
      fault.textContent = error instanceof Error ? error.message : String(error);
      put();
    }
  };
  holder.append(label, input);
  if (!isUsual(param) && param.default !== null) {
    const usual = document.createElement("button");
    usual.textContent = `default ${JSON.stringify(param.default)}`;
    usual.onclick = () => change(key, param.default).catch((error) => { fault.textContent = error.message; });
    holder.append(usual);
  }
  if (doc) {
    const words = document.createElement("small");
    words.textContent = doc.replaceAll("\n", " ");
    holder.append(words);
  }
  holder.append(fault);
  return holder;
}

/** @param {HTMLInputElement | HTMLSelectElement} input @param {unknown} before */
function read(input, before) {
  if (input instanceof HTMLSelectElement) return input.value;
  if (input.type === "checkbox") return input.checked;
  if (input.type === "number") {
    if (input.value === "") throw new Error("a number is needed");
    return Number(input.value);
  }
  if (typeof before === "string") return input.value;
  try {
    return JSON.parse(input.value);
  } catch {
    // A value that was none may become a text.
    if (before === null) return input.value;
    throw new Error("this is no value in the form of JSON");
  }
}

/**
 * The clouds that nodes make of each cloud, directly or through others, by their wires.
 * @param {Node[]} nodes
 * @returns {Map<string, Set<string>>}
 */
export function derivedClouds(nodes) {
  const isCloud = (/** @type {{payload: string}} */ { payload }) => payload === "geometry/Cloud";
  /** @type {Map<string, Set<string>>} */
  const derived = new Map();
  // A graph has its nodes in an order in which each takes from those before it: from the last on, what is made of an output is known.
  for (const { name, inputs, outputs } of [...nodes].reverse()) {
    const made = outputs.filter(isCloud).map((output) => `${name}.${output.name}`);
    const further = made.flatMap((wire) => [wire, ...(derived.get(wire) ?? [])]);
    for (const wire of inputs.flatMap(({ from }) => (from ?? "").split(", "))) {
      if (wire !== "") derived.set(wire, new Set([...(derived.get(wire) ?? []), ...further]));
    }
  }
  return derived;
}

/**
 * How old what a wire carries may be where the graph says so, ms: what feeds such an input, and what its node makes of it.
 * @param {Node[]} nodes
 * @returns {Map<string, number>}
 */
export function allowedAges(nodes) {
  /** @type {Map<string, number>} */
  const allowed = new Map();
  const allow = (/** @type {string} */ wire, /** @type {number} */ ms) => allowed.set(wire, Math.min(ms, allowed.get(wire) ?? ms));
  for (const { name, inputs, outputs } of nodes) {
    for (const { from, max_age_ms: ms } of inputs) {
      if (typeof ms !== "number") continue;
      (from ?? "").split(", ").filter((/** @type {string} */ wire) => wire !== "").forEach((/** @type {string} */ wire) => allow(wire, ms));
      outputs.forEach((output) => allow(`${name}.${output.name}`, ms));
    }
  }
  return allowed;
}

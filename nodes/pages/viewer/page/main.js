// The page: one connection, one view, the verdict and the numbers.

import { Beside } from "./beside.js";
import { showChanges } from "./changes.js";
import { Connection } from "./connection.js";
import { Devices } from "./devices.js";
import { GraphList, allowedAges, derivedClouds } from "./graph.js";
import { Frames } from "./frames.js";
import { LayerList, showItem } from "./layers.js";
import { payloadOf, readItem, readTransform } from "./message.js";
import { nextStep, showNext, showReasons } from "./next.js";
import { Picking } from "./pick.js";
import { RegionTool } from "./region.js";
import { may, setRole, whatNot } from "./request.js";
import { Scene, rendererIn } from "./scene.js";
import { clock, duration } from "./times.js";
import { errorsOf, showErrors, showVerdict } from "./verdict.js";

/** @typedef {import("./connection.js").Channel} Channel */

const EXACT = "/exact/";
const VIEW = "/view/";
const STATE = "/viewer/state";
const LOG = "/run/log";
const GRAPH = "/viewer/graph";
const NODES = "/viewer/nodes";
/** Time without an item of a stream after which what it places is not drawn any more, ms. */
const STALE_MS = 2000;
/** What is said of the verdict of a run before the graph got a fault. */
const OUTDATED = "of the last run, not of the graph as it is now:";
/** Messages that the list shows. */
const MAX_MESSAGES = 50;

/** @param {string} id */
const element = (id) => /** @type {HTMLElement} */ (document.getElementById(id));

const frames = new Frames();
const scene = new Scene(element("view"), {
  worker: new Worker("residual.js", { type: "module" }), isOrthographic: false, renderer: rendererIn(element("view")),
});
const layers = new LayerList(element("shown"), scene, ageOf);
const graph = new GraphList(element("graph"));
const devices = new Devices(scene);
const beside = new Beside(scene, element("beside"));
const picking = new Picking(scene, beside, element("picking"));

const region = new RegionTool(scene, element("region"), log, (isOpen) => {
  // One tool at a time.
  if (isOpen) picking.enter(null);
  element("picking").inert = isOpen;
});

/** What the server said of itself: how it ended, where its data come from. @type {any} */
let state = { state: "connecting" };
/** The verdicts by wire. @type {Map<string, any>} */
const verdicts = new Map();
/** Whether a recording was played to its end. */
let isAtEnd = false;
/** Whether the stream is open; null before it was. @type {boolean | null} */
let isOpen = null;
/** How old what a wire carries may be, ms. @type {Map<string, number>} */
let allowed = new Map();
/** Time of the last item of each stream, ms. @type {Map<string, {at: number, n: number}>} */
const heard = new Map();

const SEVERITY = ["trusted", "doubtful", "refused"];

/** The verdict: that of the run where it has ended, else of the wire of the results, else the worst. */
function verdict() {
  // A recording has ended where it was played to its end, a run by its own word.
  const hasEnded = state.state === "recorded" ? isAtEnd : state.state !== "running";
  // A page that hears nothing any more says so, and draws no planes.
  if (!isOpen && !hasEnded) return null;
  if (hasEnded && state.verdict) return state.verdict;
  const all = state.verdict_wire ? [verdicts.get(state.verdict_wire)] : [...verdicts.values()];
  const known = all.filter(Boolean);
  return known.sort((a, b) => SEVERITY.indexOf(b.answer) - SEVERITY.indexOf(a.answer))[0] ?? null;
}

function judge() {
  const isUnderWay = state.state === "recorded" ? !isAtEnd : ["connecting", "running"].includes(state.state);
  const waiting = !isOpen ? "not connected" : isUnderWay ? "not judged yet" : "not judged";
  const now = verdict();
  // What the last run gave is no answer of a graph that has a fault since.
  showVerdict(element("verdict"), now, waiting, state.outdated ? OUTDATED : null, true);
  showReasons(element("why"), element("reasons"), now);
  const errors = state.outdated ? null : errorsOf(now, targets());
  showErrors(element("errors"), errors);
  scene.judge(state.outdated ? null : now?.answer ?? null, errors);
}

/** The wire of the points at which the verdict predicts the error: of several verdicts that of the results. */
function targets() {
  const from = graph.all.filter(({ kind }) => kind.startsWith("verdict.")).map(({ name, inputs }) => ({ name, wire: inputs.find((input) => input.name === "assessment")?.from ?? null }));
  const ofResults = from.find(({ name }) => `${name}.verdict` === state.verdict_wire);
  return (ofResults ?? from.find(({ wire }) => wire !== null))?.wire ?? null;
}

function showState() {
  const words = [state.simulated ? "simulated" : "", state.origin === "live" ? "" : state.origin ?? ""].filter(Boolean);
  for (const id of ["origin", "watermark"]) {
    element(id).hidden = words.length === 0;
    element(id).textContent = words.join(" · ");
  }
  document.title = state.name ? `${state.name} · Osteoflow` : "Osteoflow";
  // A refusal by the verdict is at the top with its reasons.
  const problem = state.problem ?? (state.verdict ? null : state.refusal) ?? "";
  element("problem").hidden = problem === "";
  element("problem").textContent = problem;
  graph.allow(Boolean(state.changes) && !state.changes.fixed && may("steer"));
  showChanges(element("changes"), state.changes ?? null, log);
  showRegionButton();
  showNumbers();
  judge();
}

/** What this page may not do is said, and its buttons are disabled. @param {string | undefined} role */
function showRole(role) {
  setRole(role);
  element("role").textContent = whatNot();
  element("role").hidden = may("write");
  for (const id of ["play", "time", "speed"]) /** @type {HTMLButtonElement} */ (element(id)).disabled = !may("steer");
  picking.changed();
  showState();
}

/** The crops of the graph and their clouds. */
function crops() {
  const of = graph.all.filter(({ kind }) => kind.startsWith("crop."));
  return of.map(({ name, inputs }) => ({ node: name, wire: inputs.find((input) => input.name === "cloud")?.from ?? null }));
}

/** What to do first. */
function showWhatNext() {
  const tool = region.isOpen ? "region" : picking.mode;
  const hasScan = [...scene.drawn.values()].some(({ payload }) => payload === "geometry/Cloud");
  const isDrawn = crops().some(({ wire }) => wire !== null && scene.drawn.has(wire));
  const hasPair = may("write") && picking.clouds().length > 0 && picking.bone() !== null;
  /** @type {import("./next.js").Action[]} */
  const can = [];
  if (isDrawn && !element("draw").hidden) can.push("region");
  if (hasPair) can.push("pairs");
  if (range && may("steer")) can.push("play");
  const nDone = tool === "region" ? region.shapes.length : picking.nPairs();
  const saves = picking.panel.save.textContent;
  const next = nextStep({ isOpen, state, verdict: verdict(), hasScan, isAtEnd, plays, tool, nDone, saves, can });
  showNext(element("next"), next, { region: () => element("draw").click(), pairs: () => picking.enter("pairs"), play: () => element("play").click() });
}

function showRegionButton() {
  element("draw").hidden = !graph.mayChange || !may("write") || crops().length === 0;
}

function showNumbers() {
  const text = (/** @type {unknown} */ value) => (typeof value === "number" && !Number.isInteger(value) ? value.toPrecision(3) : String(value ?? "none"));
  const rows = Object.entries(state.numbers ?? {}).map(([name, value]) => [name, value, state.was?.numbers?.[name]]);
  const [is, was] = [state.verdict?.answer, state.was?.verdict?.answer];
  if (state.was && is !== was) rows.unshift(["verdict", is, was]);
  element("numbers").replaceChildren(
    ...rows.flatMap(([name, value, before]) => {
      const [term, number] = [document.createElement("dt"), document.createElement("dd")];
      term.textContent = String(name);
      number.textContent = text(value);
      if (state.was && text(before) !== text(value)) {
        const old = document.createElement("small");
        old.textContent = ` was ${text(before)}`;
        number.append(old);
      }
      return [term, number];
    }),
  );
}

/** @param {string} text */
function log(text) {
  const entry = document.createElement("li");
  entry.textContent = text;
  const list = element("log");
  list.prepend(entry);
  while (list.childElementCount > MAX_MESSAGES) list.lastElementChild?.remove();
}

/** Payloads of which only the last item of a wire is drawn. */
const LAST_COUNTS = new Set(["geometry/Cloud", "geometry/Mesh", "geometry/Planes"]);
/** What waits to be drawn, by wire. @type {Map<string, {payload: string, data: DataView}>} */
const pending = new Map();

function drawPending() {
  for (const [wire, { payload, data }] of pending) {
    attempt(wire, () => {
      const item = readItem(data);
      scene.update(wire, payload, item);
      beside.item(wire, payload, item);
      picking.item(wire, payload, item);
      devices.item(payload, item);
    });
  }
  pending.clear();
}

/** Does something with a message; a message that is damaged is named, and the page goes on. @param {string} what @param {() => void} work */
function attempt(what, work) {
  try {
    work();
  } catch (error) {
    log(`${what}: ${error instanceof Error ? error.message : error}`);
  }
}

/** @param {Channel} channel @param {DataView} data */
function receive(channel, data) {
  if (channel.topic === STATE) {
    // What a wire said of the simulation stays known.
    const before = state.state;
    state = { simulated: state.simulated, ...JSON.parse(new TextDecoder().decode(data)) };
    // Where a run has ended the bone is where it was followed to.
    if (before === "running" && state.state !== before && !scene.isTurned) scene.isLookedAt = false;
    showState();
    return;
  }
  if (channel.topic === GRAPH || channel.topic === NODES) {
    const message = JSON.parse(new TextDecoder().decode(data));
    if (channel.topic === GRAPH) {
      graph.show(message);
      scene.takeDerived(derivedClouds(message.nodes));
      allowed = allowedAges(message.nodes);
      picking.graph(message);
      showRegionButton();
      judge();
    } else graph.count(message);
    return;
  }
  if (channel.topic === LOG) {
    const { name, message } = JSON.parse(new TextDecoder().decode(data));
    log(`${name}: ${message}`);
    return;
  }
  if (channel.topic.startsWith(VIEW)) {
    frames.origin = channel.origin ?? null;
    frames.place(channel.topic.slice(VIEW.length), readTransform(data));
    scene.redraw();
    return;
  }
  const wire = channel.topic.slice(EXACT.length);
  heard.set(wire, { at: performance.now(), n: (heard.get(wire)?.n ?? 0) + 1 });
  const named = payloadOf(channel.schemaName);
  if (LAST_COUNTS.has(named)) {
    // Read when it is drawn: of a stream that is faster than the screen only the last.
    pending.set(wire, { payload: named, data });
    return;
  }
  const item = readItem(data);
  const payload = item.payload ?? named;
  picking.item(wire, payload, item);
  if (payload === "report/Verdict") {
    verdicts.set(wire, item.empty ? null : JSON.parse(String(item.fields.json)));
    judge();
  } else if (payload === "report/Flag" && wire.endsWith(".simulated") && !item.empty) {
    state.simulated = Object.values(item.fields)[0] === true;
    showState();
  } else {
    showItem({ scene, frames }, wire, payload, item);
  }
}

/** The time of a recording has jumped: what comes next is all that is known. */
function forget() {
  frames.clear();
  scene.clear();
  beside.clear();
  devices.clear();
  picking.forget();
  pending.clear();
  verdicts.clear();
  heard.clear();
  graph.count({});
}

function isLive() {
  return state.origin === "live" && state.state === "running";
}

/** How old what is shown of a wire is, where the graph limits it. @param {string} wire */
function ageOf(wire) {
  const [ms, last] = [allowed.get(wire), heard.get(wire)];
  if (!isLive() || ms === undefined || last === undefined) return null;
  return `${duration(performance.now() - last.at)} old, ${duration(ms)} allowed`;
}

/** In a live run, what a stream placed is not drawn once the stream is silent. */
function noticeSilence() {
  if (!isLive()) return;
  const now = performance.now();
  for (const [wire, { at, n }] of heard) {
    // A wire that gave one item is a constant.
    if (n < 2) continue;
    const silentMs = now - at;
    const most = allowed.get(wire);
    const reason = most === undefined ? `nothing for ${(silentMs / 1000).toFixed(0)} s` : `older than ${duration(most)}`;
    const drawn = scene.drawn.get(wire);
    if (silentMs > (most ?? STALE_MS)) {
      if ([...frames.edges.values()].some((edge) => edge.wire === wire)) frames.unknown.set(wire, reason);
      if (drawn && drawn.payload === "geometry/Planes") drawn.unknown = reason;
      scene.redraw();
    }
  }
}

const address = new URL(".", location.href);
address.protocol = address.protocol === "https:" ? "wss:" : "ws:";
address.search = "playback";
const connection = new Connection(address.href, {
  info: (info) => {
    showRole(info.metadata?.role);
    setRange(info);
  },
  wants: ({ topic, schemaName }) =>
    [STATE, LOG, GRAPH, NODES].includes(topic) || topic.startsWith(EXACT) ||
    (topic.startsWith(VIEW) && schemaName === "foxglove.FrameTransform"),
  message: (channel, _time, data) => {
    const began = performance.now();
    attempt(channel.topic, () => receive(channel, data));
    measure(performance.now() - began);
  },
  restart: forget,
  playback: showPlayback,
  status: log,
  open: (open) => {
    isOpen = open;
    if (!open) log("the connection is closed; what is shown is old");
    document.body.classList.toggle("closed", !open);
    judge();
  },
});

// Time of this script between two frames, for the tests.
let frameMs = 0;
/** @type {number[]} */
const frameTimes = [];

/** @param {number} ms */
function measure(ms) { frameMs += ms; }

/** When to draw next: a renderer without a graphics card gets half of the time at most, so that messages are read. */
let drawsAt = 0;

function animate() {
  const began = performance.now();
  let drawMs = 0;
  if (began >= drawsAt) {
    drawPending();
    noticeSilence();
    picking.draw();
    devices.draw(frames);
    beside.prepare(frames);
    drawMs = scene.draw(frames) + beside.draw(frames);
    showViewButtons();
    showWhatNext();
    drawsAt = performance.now() + drawMs;
  }
  layers.draw();
  graph.draw();
  // The renderer's own time depends on the graphics card, of which some machines have none.
  measure(performance.now() - began - drawMs);
  if (frameTimes.push(frameMs) > 2000) frameTimes.shift();
  frameMs = 0;
  requestAnimationFrame(animate);
}

// The player of a recording.
/** @type {{start: bigint, end: bigint} | null} */
let range = null;
let plays = false;
/** @type {bigint} */
let atNs = 0n;

/** @param {any} info */
function setRange(info) {
  const time = (/** @type {any} */ t) => BigInt(t.sec) * 1000000000n + BigInt(t.nsec);
  if (!info.dataStartTime || !info.dataEndTime) return;
  range = { start: time(info.dataStartTime), end: time(info.dataEndTime) };
  atNs = range.start;
  element("player").hidden = false;
}

/** @param {import("./connection.js").Playback} playback */
function showPlayback(playback) {
  plays = playback.status === "playing";
  isAtEnd = playback.status === "ended";
  if (playback.didSeek) forget();
  judge();
  element("play").textContent = plays ? "pause" : "play";
  atNs = playback.atNs;
  if (!range) return;
  const length = Number(range.end - range.start);
  /** @type {HTMLInputElement} */ (element("time")).value = String(length > 0 ? (1000 * Number(atNs - range.start)) / length : 0);
  element("clock").textContent = `${clock(Number(atNs - range.start) / 1e9)} of ${clock(length / 1e9)}`;
}

const speed = () => Number(/** @type {HTMLSelectElement} */ (element("speed")).value);
element("play").onclick = () => connection.play(!plays, speed(), null);
element("speed").onchange = () => connection.play(plays, speed(), null);
element("time").onchange = () => {
  if (!range) return;
  const share = Number(/** @type {HTMLInputElement} */ (element("time")).value);
  connection.play(plays, speed(), range.start + ((range.end - range.start) * BigInt(share)) / 1000n);
};

const sides = /** @type {const} */ (["scan", "lateral", "anterior", "along"]);

/** @param {typeof sides[number]} side */
function lookFrom(side) {
  scene.isTurned = true;
  scene.look(side, frames);
}

for (const side of sides) {
  const button = /** @type {HTMLButtonElement} */ (document.querySelector(`[data-side=${side}]`));
  button.onclick = () => lookFrom(side);
}
element("glass").onclick = () => {
  scene.glass(!scene.isGlass);
  element("glass").setAttribute("aria-pressed", String(scene.isGlass));
};
element("draw").onclick = () => {
  // The first crop that has a cloud here; a graph has one, as a rule.
  const all = crops();
  const { node, wire } = all.find((crop) => crop.wire !== null && scene.drawn.has(crop.wire)) ?? all[0];
  if (region.isOpen) region.close();
  else region.open(node, String(wire));
};
element("full").onclick = () => (document.fullscreenElement ? document.exitFullscreen() : document.documentElement.requestFullscreen());
element("own").onclick = () => {
  scene.colours.choose(!scene.colours.isOwn);
};

/** What the buttons of the view say: without a plan nobody knows which side of a bone is lateral. */
function showViewButtons() {
  const words = scene.axes ? { lateral: "lateral", anterior: "anterior" } : { lateral: "from one side", anterior: "a quarter turn on" };
  for (const [side, text] of Object.entries(words)) {
    const button = /** @type {HTMLElement} */ (document.querySelector(`[data-side=${side}]`));
    if (button.textContent !== text) button.textContent = text;
  }
  const own = element("own");
  const isHidden = !scene.colours.hasOwn;
  if (own.hidden !== isHidden) own.hidden = isHidden;
  own.setAttribute("aria-pressed", String(scene.colours.isOwn));
  const isScaled = !scene.colours.isOwn || isHidden;
  if (element("scale").hidden === isScaled) element("scale").hidden = !isScaled;
}

/** What a key turns by, radians; moves by, pixels; zooms by. */
const TURN = Math.PI / 24, MOVE_PX = 30, NEARER = 0.85;

/** Keys in a view, for those who have no mouse. @param {HTMLElement} holder @param {() => Scene} of @param {() => void} all shows all */
function steer(holder, of, all) {
  holder.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const { controls } = of();
    const go = (/** @type {number} */ right, /** @type {number} */ down) => (event.shiftKey ? controls.pan(right * MOVE_PX, down * MOVE_PX) : controls.turn(right * TURN, down * TURN));
    /** @type {Record<string, () => void>} */
    const does = {
      ArrowLeft: () => go(-1, 0), ArrowRight: () => go(1, 0), ArrowUp: () => go(0, -1), ArrowDown: () => go(0, 1),
      "+": () => controls.zoom(NEARER), "=": () => controls.zoom(NEARER), "-": () => controls.zoom(1 / NEARER), 0: all,
    };
    if (!does[event.key]) return;
    event.preventDefault();
    of().isTurned = true;
    does[event.key]();
  });
}
steer(element("view"), () => scene, () => scene.look("scan", frames));
steer(beside.view, () => beside.scene, () => beside.look());

document.addEventListener("keydown", (event) => {
  if (event.target instanceof HTMLInputElement || event.target instanceof HTMLSelectElement || event.ctrlKey || event.metaKey || event.altKey) return;
  const side = sides[Number(event.key) - 1];
  if (side) lookFrom(side);
  if (event.key === "f") element("full").click();
  if (event.key === "g") element("glass").click();
  if (event.key === "c" && !element("own").hidden) element("own").click();
  // A button or the head of a node has the space bar for itself.
  const isPressed = event.target instanceof HTMLElement && event.target.matches("button, summary");
  if (event.key === " " && range && may("steer") && !isPressed) {
    event.preventDefault();
    element("play").click();
  }
});

judge();
animate();
// For tests, and for the browser's console.
Object.assign(window, { osteoflow: { scene, beside, frames, region, picking, devices, frameTimes, get state() { return state; }, get verdict() { return verdict(); } } });

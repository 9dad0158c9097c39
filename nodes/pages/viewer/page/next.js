// What to do first: one line for each state of the page, with the button of what it names; and the reasons of a verdict, all of them on demand.

/**
 * @typedef {{rule: string, answer: string, reason: string, remedy: string}} Reason
 * @typedef {"region" | "pairs" | "play"} Action
 * @typedef {{name: string, text: string, action: Action | null}} Step
 */

/**
 * What the line depends on.
 * @typedef {object} Facts
 * @property {boolean | null} isOpen whether the page is connected; null before it was
 * @property {any} state what the server said of the run
 * @property {any} verdict as in results.json, or null
 * @property {boolean} hasScan
 * @property {boolean} isAtEnd whether a recording was played to its end
 * @property {boolean} plays
 * @property {"region" | "pairs" | "plan" | null} tool the one that is open
 * @property {number} nDone shapes of the region, or pairs
 * @property {string} saves what the button that saves the pairs says
 * @property {Action[]} can what has a button here
 */

const N_PAIRS = 3;
/** Length of a remedy that is more than a line, characters. */
const LONG = 90;
/** How a remedy begins if surroundings are in the scan, and which remedies name a crop or picked points. */
const CROP = "crop the scan to the bone", NAMES_CROP = /\bcrop\b/, NAMES_POINTS = /\b(start from|locate)( four)? landmarks\b/;
/** Reasons of the engine: the run gave no answer. */
const NO_ANSWER = ["failure", "interrupted"];
/** @type {Record<Action, string>} */
const BUTTONS = { region: "Region", pairs: "Pick pairs", play: "Play" };

/** What speaks against an answer, the first for it first. @param {any} verdict @returns {Reason[]} */
function against(verdict) {
  const all = (verdict?.reasons ?? []).filter((/** @type {Reason} */ { answer }) => answer !== "trusted");
  const first = all.find((/** @type {Reason} */ { answer }) => answer === verdict.answer);
  return first ? [first, ...all.filter((/** @type {Reason} */ reason) => reason !== first)] : all;
}

/** The line for a state of the page. @param {Facts} facts @returns {Step} */
export function nextStep({ isOpen, state, verdict, hasScan, isAtEnd, plays, tool, nDone, saves, can }) {
  /** @returns {Step} */
  const step = (/** @type {string} */ name, /** @type {string} */ text, /** @type {Action | null} */ action = null) =>
    ({ name, text, action: action !== null && can.includes(action) ? action : null });
  if (isOpen === false) return step("closed", "The command has ended: start it again, and open the address that it prints");
  if (state.state === "connecting") return step("connecting", "Wait: the page connects to its run");
  if (tool === "region") return step("region", nDone === 0 ? "Draw around the bone on the scan" : "Press save and run below the scan, or draw more");
  if (tool === "pairs") {
    const next = nDone < N_PAIRS ? `Click a place on the bone, then the same place on the scan: ${nDone} of ${N_PAIRS} pairs` : `Press ${saves}, or pick more pairs`;
    return step("pairs", next);
  }
  if (tool === "plan") return step("plan", "Set the points of the plan on the bone, then save the plan");
  if (state.problem && state.state === "recorded") {
    return step("damaged", "Look at what is left of the recording; osteoflow recover FILE NEW saves it", "play");
  }
  if (state.problem && state.state !== "failed") return step("fault", "Mend the graph as the red line says; it is run again once it is saved");
  if (state.state === "recorded" && !isAtEnd) {
    return step("playback", plays ? "Wait for the end of the recording: the verdict comes there" : "Press Play, or drag the time to its end, for the verdict", plays ? null : "play");
  }
  if (verdict === null && state.state === "running") {
    if (hasScan) return step("registering", "Wait: the scan is being registered onto the bone");
    return step("no_scan", state.origin === "live" ? "Show the bone to the camera: no scan has come yet" : "Wait: the bone and its scan are being read");
  }
  const reasons = against(verdict);
  const first = reasons.find(({ rule, remedy }) => rule !== "require" && remedy !== "");
  if (state.state === "failed" || (first && NO_ANSWER.includes(first.rule))) {
    const isCrop = first?.reason.includes(CROP) && can.includes("region");
    const cause = `what the ${state.problem ? "red line" : "line above"} says, and run again`;
    return isCrop ? step("failed", `Crop the scan to the bone if skin or drape is in it; else mend ${cause}`, "region") : step("failed", `Mend ${cause}`);
  }
  if (verdict === null) return step("unjudged", "Look at the scan on the bone yourself: nothing in this graph gives a verdict");
  if (verdict.answer === "trusted") return step("trusted", "Touch one landmark with a stylus, or scan a check piece, before you use this answer");
  if (!first) return step(verdict.answer, "Mend what the line above says, and run again");
  if (first.remedy.startsWith(CROP)) {
    return step("surroundings", can.includes("region") ? "Crop the scan to the bone: skin or drape is in it" : "Crop the scan to the bone, and register it again: skin or drape is in it", "region");
  }
  if (first.rule === "start" && can.includes("pairs")) {
    return step("place", "Show where the scan lies: pick three places on the bone, and the same on the scan", "pairs");
  }
  // Of a long remedy the names of options are in the list of reasons alone.
  const remedy = first.remedy.length > LONG ? first.remedy.replace(/ \([^)]*\)/g, "") : first.remedy;
  const action = NAMES_CROP.test(remedy) ? "region" : NAMES_POINTS.test(remedy) ? "pairs" : null;
  return step(verdict.answer, remedy[0].toUpperCase() + remedy.slice(1), action);
}

/** Shows the line, if it is another one. @param {HTMLElement} holder @param {Step} next @param {Record<Action, () => void>} does */
export function showNext(holder, next, does) {
  const [line, button] = /** @type {[HTMLElement, HTMLButtonElement]} */ ([...holder.children]);
  if (line.textContent === next.text && button.value === (next.action ?? "")) return;
  holder.dataset.step = next.name;
  line.textContent = next.text;
  button.value = next.action ?? "";
  button.hidden = next.action === null;
  if (next.action === null) return;
  button.textContent = BUTTONS[next.action];
  button.onclick = does[next.action];
}

/** The reasons that are listed, which a run tells again and again. */
let listed = "";

/** The button that shows all reasons of a verdict, with what to do about each. @param {HTMLElement} button @param {HTMLElement} panel @param {any} verdict */
export function showReasons(button, panel, verdict) {
  const reasons = against(verdict);
  if (JSON.stringify(reasons) === listed) return;
  listed = JSON.stringify(reasons);
  const [heading, list] = /** @type {[HTMLElement, HTMLElement]} */ ([...panel.children]);
  const show = (/** @type {boolean} */ isShown) => {
    button.hidden = reasons.length === 0;
    button.setAttribute("aria-expanded", String(isShown));
    panel.hidden = !isShown || button.hidden;
    const scrolls = list.scrollHeight > list.clientHeight ? ", scroll for the rest" : "";
    heading.textContent = reasons.length === 1 ? "The reason, and what to do:" : `${reasons.length} reasons, each with what to do${scrolls}:`;
  };
  button.textContent = reasons.length === 1 ? "what to do" : `all ${reasons.length} reasons`;
  button.onclick = () => show(panel.hidden);
  window.onresize = () => show(!panel.hidden);
  list.replaceChildren(...reasons.map(({ reason, remedy }) => {
    const entry = document.createElement("li");
    entry.textContent = remedy ? `${reason}; ${remedy}` : reason;
    return entry;
  }));
  show(!panel.hidden);
}

// The verdict at the top: in words, colour and shape; and the errors that it predicts.

/**
 * @typedef {{name: string, tre_mm: number, interval_mm: number[], semi_axes_mm: number[], directions: number[][]}} PredictedPoint
 * @typedef {{wire: string, points: PredictedPoint[]}} Errors of the points of a wire
 */

/**
 * The errors that a verdict predicts; none if it is refused.
 * @param {any} verdict as in results.json, or null
 * @param {string | null} wire of its assessment points
 * @returns {Errors | null}
 */
export function errorsOf(verdict, wire) {
  const points = verdict?.predicted?.points ?? [];
  return wire === null || verdict?.answer === "refused" || points.length === 0 ? null : { wire, points };
}

/** A row for each point: its error, the interval and the semi-axes of the ellipsoid. @param {HTMLElement} holder @param {Errors | null} errors */
export function showErrors(holder, errors) {
  holder.hidden = errors === null;
  const rows = (errors?.points ?? []).map(({ name, tre_mm, interval_mm, semi_axes_mm }) => {
    const row = document.createElement("tr");
    const mm = (/** @type {number | null} */ value) => value?.toFixed(2) ?? "unknown";
    for (const text of [name, mm(tre_mm), interval_mm.map(mm).join(" to "), semi_axes_mm.map(mm).join(" \u00d7 ")]) {
      row.append(Object.assign(document.createElement("td"), { textContent: text }));
    }
    return row;
  });
  holder.querySelector("tbody")?.replaceChildren(...rows);
}

/** Circle, triangle, octagon; a dashed circle where nothing is judged. */
const SHAPES = {
  trusted: '<circle cx="16" cy="16" r="14"/><path class="mark" d="M9 17l5 5 9-11"/>',
  doubtful: '<path d="M16 2 31 29H1z"/><path class="mark" d="M16 11v9M16 23.5v2"/>',
  refused: '<path d="M10 2h12l8 8v12l-8 8H10l-8-8V10z"/><path class="mark" d="M10 10l12 12M22 10 10 22"/>',
  unknown: '<circle class="open" cx="16" cy="16" r="13"/><path class="mark dark" d="M9 16h14"/>',
};

/** A long reason up to what explains it, which begins behind a colon or a semicolon outside of parentheses. @param {string} reason */
function firstClause(reason) {
  const depth = (/** @type {string} */ text) => text.split("(").length - text.split(")").length;
  const end = [...reason.matchAll(/[:;] /g)].find(({ index }) => index >= 40 && depth(reason.slice(0, index)) === 0);
  return end && reason.length > 160 ? reason.slice(0, end.index) : reason;
}

/**
 * @param {HTMLElement} holder
 * @param {any} verdict as in results.json, or null
 * @param {string} waiting what to say without one
 * @param {string | null} old why it is not that of the graph now
 * @param {boolean} isShort the first clause of the first reason alone
 */
export function showVerdict(holder, verdict, waiting, old = null, isShort = false) {
  const answer = verdict?.answer ?? null;
  const kind = answer !== null && Object.hasOwn(SHAPES, answer) ? answer : "unknown";
  holder.className = old === null ? `verdict ${kind}` : "verdict old";
  const shape = document.createElementNS("http://www.w3.org/2000/svg", "svg");
  shape.setAttribute("viewBox", "0 0 32 32");
  shape.setAttribute("aria-hidden", "true");
  shape.innerHTML = SHAPES[/** @type {keyof typeof SHAPES} */ (kind)];
  const words = document.createElement("div");
  const head = document.createElement("strong");
  head.textContent = answer === null ? waiting : answer;
  if (old !== null && answer !== null) {
    const of = document.createElement("span");
    of.className = "of";
    of.textContent = old;
    words.append(of);
  }
  words.append(head);
  /** @type {{answer: string, reason: string, remedy: string}[]} */
  const reasons = (verdict?.reasons ?? []).filter((/** @type {any} */ reason) => reason.answer !== "trusted");
  const whole = (/** @type {{reason: string, remedy: string}} */ { reason, remedy }) => (remedy ? `${reason}; ${remedy}` : reason);
  // A sentence that is made of the first reason gives way to the reason with its remedy.
  const worst = reasons.find((reason) => reason.answer === answer) ?? reasons[0];
  const first = worst && verdict.sentence?.startsWith(worst.reason) ? worst : null;
  if (isShort && worst) words.append(` ${worst.rule === "failure" ? worst.reason : firstClause(worst.reason)}`);
  else if (first || verdict?.sentence) words.append(` ${first ? whole(first) : verdict.sentence}`);
  const others = reasons.filter((reason) => reason !== first);
  if (others.length > 0 && !isShort) {
    const list = document.createElement("ul");
    for (const reason of others) {
      const entry = document.createElement("li");
      entry.textContent = whole(reason);
      list.append(entry);
    }
    words.append(list);
  }
  holder.replaceChildren(shape, words);
}

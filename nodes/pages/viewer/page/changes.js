// What was changed on the page and is not in the graph file yet.

import { change } from "./graph.js";
import { may, post } from "./request.js";

/**
 * @typedef {{values: [string, unknown][], removed: string[], settings: string, fixed: string | null, no_file: string | null, file: string | null}} Made
 */

/**
 * @param {HTMLElement} holder
 * @param {Made | null} made
 * @param {(text: string) => void} say
 */
export function showChanges(holder, made, say) {
  const section = /** @type {HTMLElement} */ (holder.closest("section"));
  section.hidden = !made || (made.values.length === 0 && !made.fixed);
  if (!made || section.hidden) return;
  const act = (/** @type {Promise<unknown>} */ done) => done.catch((error) => say(error.message));
  const button = (/** @type {string} */ text, /** @type {() => void} */ onclick, needs = "steer") => {
    const made = document.createElement("button");
    made.textContent = text;
    made.disabled = !may(needs);
    made.onclick = onclick;
    return made;
  };
  const list = document.createElement("ul");
  for (const [key, value] of made.values) {
    const entry = document.createElement("li");
    const code = document.createElement("code");
    code.textContent = `${key} = ${JSON.stringify(value)}`;
    entry.append(code, " ", button("take back", () => act(change(key, null))));
    list.append(entry);
  }
  /** @type {HTMLElement[]} */
  const parts = [list];
  const line = (/** @type {string} */ text) => {
    const part = document.createElement("small");
    part.textContent = text;
    parts.push(part);
  };
  if (made.removed.length > 0) line(`without ${made.removed.join(", ")}, which the new kind does not have`);
  if (made.fixed) line(made.fixed);
  if (made.values.length > 0) {
    const buttons = document.createElement("div");
    // A graph that is built in has no file of the user's.
    if (made.no_file === null) {
      const write = button(`write into ${made.file}`, () => act(post("write", {}).then(() => say(`written into ${made.file}`))), "write");
      write.id = "write";
      buttons.append(write, " ");
    }
    buttons.append(button("take all back", () => act(post("revert", {}))));
    parts.push(buttons);
    line(`the same from the command line: ${made.settings}`);
  }
  holder.replaceChildren(...parts);
}

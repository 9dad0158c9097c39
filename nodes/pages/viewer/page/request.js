// Requests of the page that change or save something, and what its address may do.

/** The roles of addresses; each may do what those before it may. */
const ROLES = ["see", "steer", "write"];
let role = "write";

/** @param {string | undefined} of the role that the server says this page has */
export function setRole(of) { role = of ?? "write"; }

/** Whether this page may do what needs a role. @param {string} needs */
export const may = (needs) => ROLES.indexOf(role) >= ROLES.indexOf(needs);

/** What this page may not do, and how to get an address that may; nothing if it may all. */
export function whatNot() {
  if (may("write")) return "";
  const what = may("steer") ? "this page may see and steer, not set texts or save" : "this page may see, not change, play or save";
  return `${what}; start the command again with --role ${may("steer") ? "write" : "steer or --role write"} for an address that may`;
}

/**
 * Posts a value as JSON to the server that the page came from.
 * @param {string} path below the page's address
 * @param {unknown} body
 * @returns {Promise<any>} the answer
 * @throws {Error} with the server's sentence for the user
 */
export async function post(path, body) {
  const answer = await fetch(new URL(path, new URL(".", location.href)), { method: "POST", body: JSON.stringify(body) });
  const text = await answer.text();
  if (!answer.ok) throw new Error(text.trim());
  return JSON.parse(text);
}

// Requests of the page that change or save something.

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

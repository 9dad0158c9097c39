// Beside the page's stream: what the server says of its run is held back, or said otherwise, on the page's own way from the socket.
(() => {
  const stream = { holds: false, ids: new Map(), take: () => {} };
  const Socket = WebSocket;
  window.stream = stream;
  window.WebSocket = class extends Socket {
    set onmessage(take) {
      stream.take = take;
      super.onmessage = (event) => {
        const isText = typeof event.data === "string";
        const { op, channels } = isText ? JSON.parse(event.data) : {};
        if (op === "advertise") for (const { id, topic } of channels) stream.ids.set(topic, id);
        if (isText || !stream.holds) take(event);
      };
    }
  };
  stream.say = (state) => {
    const text = new TextEncoder().encode(JSON.stringify(state));
    const view = new DataView(new ArrayBuffer(13 + text.length));
    view.setUint8(0, 1);
    view.setUint32(1, stream.ids.get("/viewer/state"), true);
    new Uint8Array(view.buffer).set(text, 13);
    stream.take({ data: view.buffer });
  };
  // What of the text beside the list of the page cannot be read: a list of sentences.
  stream.faults = () => {
    const faults = new Set();
    const seen = [];
    const name = (element) => `${element.id || element.tagName.toLowerCase()} "${element.textContent.trim().slice(0, 40)}"`;
    const says = (element) => element.tabIndex === 0 && /scroll/.test(element.parentElement.innerText);
    const pageScrolls = document.documentElement.scrollHeight > innerHeight;
    if (pageScrolls && innerWidth > 720) faults.add(`the page is ${document.documentElement.scrollHeight} of ${innerHeight} pixels high`);
    const texts = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
    while (texts.nextNode()) {
      const element = texts.currentNode.parentElement;
      if (!texts.currentNode.textContent.trim() || !element.checkVisibility() || element.closest("aside, footer, script, option, [aria-hidden=true]")) continue;
      const range = document.createRange();
      range.selectNodeContents(texts.currentNode);
      for (const line of range.getClientRects()) {
        if (line.width < 1) continue;
        let isSeen = true;
        for (let at = element; at !== document.body; at = at.parentElement) {
          const style = getComputedStyle(at);
          if (style.overflowX === "visible" && style.overflowY === "visible") continue;
          const box = at.getBoundingClientRect();
          const [left, top] = [box.left + at.clientLeft, box.top + at.clientTop];
          if (line.left < left - 1 || line.right > left + at.clientWidth + 1) faults.add(`${name(element)} is cut at its side`);
          const isOut = line.bottom <= top + 1 || line.top >= top + at.clientHeight - 1;
          if (!isOut && (line.top < top - 1 || line.bottom > top + at.clientHeight + 1)) faults.add(`${name(element)} is cut through a line`);
          if (isOut && !(/auto|scroll/.test(style.overflowY) && says(at))) faults.add(`${name(element)} is out of sight, and nothing says that it scrolls`);
          isSeen &&= !isOut;
        }
        if (isSeen) seen.push({ element, line });
      }
    }
    for (const [k, { element, line }] of seen.entries()) {
      if (line.left < -1 || line.right > innerWidth + 1 || line.top < -1 || (line.bottom > innerHeight + 1 && !pageScrolls)) faults.add(`${name(element)} is outside of the window`);
      const over = seen.slice(0, k).find((other) => !other.element.contains(element) && !element.contains(other.element) &&
        Math.min(line.right, other.line.right) - Math.max(line.left, other.line.left) > 1 && Math.min(line.bottom, other.line.bottom) - Math.max(line.top, other.line.top) > 1);
      if (over) faults.add(`${name(element)} is on ${name(over.element)}`);
      const top = document.elementFromPoint((line.left + line.right) / 2, (line.top + line.bottom) / 2);
      // The player stays at the foot of a page that scrolls.
      const isBelow = pageScrolls && top?.closest("footer");
      if (top && !isBelow && !top.contains(element) && !element.contains(top)) faults.add(`${name(element)} is behind ${name(top)}`);
    }
    return [...faults];
  };
})();

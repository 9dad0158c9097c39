"use strict";
// Loads the modules of the page: their texts are in it, compressed, because a module opened from disk cannot import a file beside it.
(async () => {
  const unpack = async (id) => {
    const bytes = Uint8Array.from(atob(document.getElementById(id).textContent), (c) => c.charCodeAt(0));
    const text = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
    return JSON.parse(await new Response(text).text());
  };
  try {
    const { modules } = await unpack("modules");
    const addresses = new Map();
    for (const [name, text] of modules) {
      const folder = name.slice(0, name.lastIndexOf("/") + 1);
      const addressed = text.replace(/(\bfrom\s*)(["'])(three|\.\/[\w./]+)\2/g, (whole, from, quote, of) => {
        const address = addresses.get(of === "three" ? "three/three.module.min.js" : folder + of.slice(2));
        return address ? `${from}"${address}"` : whole;
      });
      addresses.set(name, URL.createObjectURL(new Blob([addressed], { type: "text/javascript" })));
    }
    const { showViews } = await import(addresses.get("views.js"));
    showViews(await unpack("data"));
  } catch (error) {
    for (const box of document.querySelectorAll(".view")) {
      const fallback = box.querySelector(".fallback");
      fallback.textContent = `This browser cannot run the view (${error.message}). ${fallback.dataset.instead}`;
      fallback.hidden = false;
      for (const part of box.querySelectorAll(".bar, .scale")) part.hidden = true;
    }
  }
  document.documentElement.dataset.loaded = "";
})();

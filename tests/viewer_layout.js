// What of a page cannot be read, hit or reached: a list of sentences.
(() => {
  const said = [];
  const parse = (text) => {
    const [, kind, inside] = text.match(/^(rgba?|color)\((?:srgb )?([^)]+)\)$/) ?? [];
    if (!kind) return null;
    const numbers = inside.split(/[,/ ]+/).filter(Boolean).map(Number);
    const scale = kind === "color" ? 255 : 1;
    return [...numbers.slice(0, 3).map((c) => c * scale), numbers[3] ?? 1];
  };
  const over = (a, b) => [0, 1, 2].map((k) => a[k] * a[3] + b[k] * (1 - a[3])).concat(1);
  // WCAG 2.2, relative luminance.
  const luminance = (rgb) => {
    const [r, g, b] = rgb.slice(0, 3).map((c) => (c / 255 <= 0.04045 ? c / 255 / 12.92 : ((c / 255 + 0.055) / 1.055) ** 2.4));
    return 0.2126 * r + 0.7152 * g + 0.0722 * b;
  };
  const chain = (element) => {
    const all = [];
    for (let at = element; at; at = at.parentElement) all.push(at);
    return all;
  };
  const ground = (element) => chain(element).reverse().reduce((below, at) => over(parse(getComputedStyle(at).backgroundColor) ?? [0, 0, 0, 0], below), [255, 255, 255, 1]);
  const name = (element) => `${element.tagName.toLowerCase()} "${(element.textContent.trim() || element.id).slice(0, 30)}"`;
  for (const element of document.querySelectorAll("body *")) {
    const [style, box] = [getComputedStyle(element), element.getBoundingClientRect()];
    if (box.width === 0 || box.height === 0 || style.visibility === "hidden" || element.closest("[aria-hidden=true], svg, :disabled, noscript")) continue;
    if ([...element.childNodes].some((node) => node.nodeType === 3 && node.textContent.trim())) {
      const below = ground(element);
      const ink = parse(style.color);
      const opacity = chain(element).reduce((product, at) => product * Number(getComputedStyle(at).opacity), 1);
      const [a, b] = [luminance(over([...ink.slice(0, 3), ink[3] * opacity], below)), luminance(below)];
      const contrast = (Math.max(a, b) + 0.05) / (Math.min(a, b) + 0.05);
      if (contrast < 4.5) said.push(`${name(element)} has a contrast of ${contrast.toFixed(2)}`);
    }
    // A label has the box that it names.
    if (element.matches("button, select, summary, label:has(input), input:not([type=checkbox])") && (box.width < 24 || box.height < 24) && !element.closest("label:has(input) input")) {
      said.push(`${name(element)} is ${box.width.toFixed(0)} x ${box.height.toFixed(0)} pixels`);
    }
    const isScrolled = chain(element.parentElement).some((at) => getComputedStyle(at).overflowX !== "visible" && at !== document.documentElement && at !== document.body);
    if (box.right > innerWidth + 1 && !isScrolled) said.push(`${name(element)} ends at ${box.right.toFixed(0)} of ${innerWidth} pixels`);
    if (element.matches("button, select, input, summary, [tabindex]") && !element.labels?.length && !element.getAttribute("aria-label") && !element.textContent.trim()) {
      said.push(`${element.outerHTML.slice(0, 80)} has no name`);
    }
  }
  if (document.documentElement.scrollWidth > innerWidth) said.push(`the page is ${document.documentElement.scrollWidth} of ${innerWidth} pixels wide`);
  return [...new Set(said)];
})()

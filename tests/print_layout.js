// What a print of this page shows: { faults, pictures } of a PDF in base64, read as the browser writes it.
// faults are sentences about what a reader would see; pictures show each page as rows of letters, '.' for nothing.
(async (base64) => {
  const pdf = atob(base64);
  const objects = new Map([...pdf.matchAll(/(?:^|\n)(\d+) 0 obj\s([^]*?)\nendobj/g)].map(([, number, body]) => [Number(number), body]));
  const reference = (body, name) => Number(body?.match(new RegExp(`/${name} \\[?(\\d+) 0 R`))?.[1]);
  const named = (body, kind) => new Map([...(body.match(new RegExp(`/${kind} <<([^>]*)>>`))?.[1] ?? "").matchAll(/\/(\w+) (\d+) 0 R/g)].map((of) => [of[1], Number(of[2])]));
  const stream = async (body) => {
    const bytes = Uint8Array.from(body.slice(body.indexOf("stream\n") + 7, body.lastIndexOf("\nendstream")), (c) => c.charCodeAt(0));
    const inflated = new Response(new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate")));
    return new TextDecoder("latin1").decode(await inflated.arrayBuffer());
  };
  const times = ([a, b, c, d, e, f], [g, h, i, j, k, l]) => [a * g + b * i, a * h + b * j, c * g + d * i, c * h + d * j, e * g + f * i + k, e * h + f * j + l];
  const at = ([a, b, c, d, e, f], [x, y]) => [a * x + c * y + e, b * x + d * y + f];
  const around = (points) => [Math.min(...points.map((p) => p[0])), Math.min(...points.map((p) => p[1])), Math.max(...points.map((p) => p[0])), Math.max(...points.map((p) => p[1]))];
  const common = (a, b) => [Math.max(a[0], b[0]), Math.max(a[1], b[1]), Math.min(a[2], b[2]), Math.min(a[3], b[3])];
  const corners = ([x0, y0, x1, y1]) => [[x0, y0], [x1, y0], [x0, y1], [x1, y1]];

  /** The letters and widths of a font, by glyph. */
  const fonts = new Map();
  const font = async (number) => {
    if (fonts.has(number)) return fonts.get(number);
    const [letters, widths, body] = [new Map(), new Map(), objects.get(number)];
    const text = (hex) => String.fromCharCode(...hex.match(/.{4}/g).map((code) => parseInt(code, 16)));
    const map = await stream(objects.get(reference(body, "ToUnicode")));
    for (const [, kind, block] of map.matchAll(/beginbf(char|range)([^]*?)endbf/g)) {
      for (const line of block.matchAll(/<(\w+)> <(\w+)>(?: <(\w+)>)?/g)) {
        const [first, last] = [parseInt(line[1], 16), parseInt(line[kind === "char" ? 1 : 2], 16)];
        const to = line[kind === "char" ? 2 : 3];
        for (let glyph = first; glyph <= last; glyph++) letters.set(glyph, to.length > 4 ? text(to) : String.fromCharCode(parseInt(to, 16) + glyph - first));
      }
    }
    const list = objects.get(reference(body, "DescendantFonts"))?.match(/\/W \[((?:[^[\]]|\[[^\]]*\])*)\]/)?.[1] ?? "";
    for (const [, first, each, last, all] of list.matchAll(/([\d.]+) (?:\[([^\]]*)\]|([\d.]+) ([\d.]+))/g)) {
      if (each !== undefined) each.trim().split(/\s+/).forEach((width, k) => widths.set(Number(first) + k, Number(width)));
      else for (let glyph = Number(first); glyph <= Number(last); glyph++) widths.set(glyph, Number(all));
    }
    fonts.set(number, { letters, widths });
    return fonts.get(number);
  };

  /** Adds what a content stream draws to `texts` and `shapes`, each with its box on the page. */
  const draw = async (body, matrix, clip, page) => {
    const [own, forms] = [named(body, "Font"), named(body, "XObject")];
    const contents = body.includes("stream\n") ? body : objects.get(reference(body, "Contents"));
    const stack = [];
    let [arguments_, path, clips, state] = [[], [], false, { matrix, clip }];
    let [text, line, box, size, used] = [[1, 0, 0, 1, 0, 0], "", [], 1, null];
    const show = (hex) => {
      let x = 0;
      for (const code of hex.match(/.{4}/g) ?? []) {
        const glyph = parseInt(code, 16);
        line += used.letters.get(glyph) ?? "";
        x += ((used.widths.get(glyph) ?? 600) / 1000) * size;
      }
      // From the descenders to the height of a capital.
      box.push(...corners([0, -0.2 * size, x, 0.75 * size]).map((corner) => at(times(text, state.matrix), corner)));
    };
    for (const [token] of (await stream(contents)).matchAll(/<<.*?>>|<\w*>|\[[^\]]*\]|\/[^\s/<>[\]()]+|[-+]?[\d.]+|\((?:\\.|[^\\)])*\)|[A-Za-z*'"]+/g)) {
      if (!/^[A-Za-z*'"]/.test(token)) {
        arguments_.push(token);
        continue;
      }
      const n = arguments_.map(Number);
      const to = (...points) => path.push(...points.map((point) => at(state.matrix, point)));
      if (token === "q") stack.push({ ...state });
      else if (token === "Q") state = stack.pop();
      else if (token === "cm") state.matrix = times(n, state.matrix);
      else if (token === "m" || token === "l") to([n[0], n[1]]);
      else if (token === "c") to([n[0], n[1]], [n[2], n[3]], [n[4], n[5]]);
      else if (token === "re") to(...corners([n[0], n[1], n[0] + n[2], n[1] + n[3]]));
      else if (token === "W") clips = true;
      else if (["f", "f*", "S", "s", "B", "n"].includes(token)) {
        if (clips) state.clip = common(state.clip, around(path));
        else if (token !== "n" && path.length > 0) page.shapes.push(common(around(path), state.clip));
        [path, clips] = [[], false];
      } else if (token === "BT") [text, line, box] = [[1, 0, 0, 1, 0, 0], "", []];
      else if (token === "Tf") [used, size] = [await font(own.get(arguments_[0].slice(1))), n[1]];
      else if (token === "Tm") text = n;
      else if (token === "Td") text = times([1, 0, 0, 1, n[0], n[1]], text);
      else if (token === "Tj") show(arguments_[0].slice(1, -1));
      else if (token === "ET" && box.length > 0) {
        const whole = around(box);
        const [a, b, c, d] = times(text, state.matrix);
        const part = common(whole, state.clip);
        // The browser leaves out letters beyond the page; of a line at its edge only the half that is on it is printed.
        const middle = (whole[1] + whole[3]) / 2;
        if (part[0] < part[2] && part[1] <= middle && middle <= part[3]) page.texts.push({ line, box: whole, isAslant: Math.abs(a * b) + Math.abs(c * d) > 1e-6 });
      } else if (token === "Do") {
        const form = objects.get(forms.get(arguments_[0].slice(1)));
        const inner = form.match(/\/Matrix \[([^\]]*)\]/)?.[1].trim().split(/\s+/).map(Number) ?? [1, 0, 0, 1, 0, 0];
        if (form.includes("/Subtype /Form")) await draw(form, times(inner, state.matrix), state.clip, page);
        else page.shapes.push(common(around(corners([0, 0, 1, 1]).map((corner) => at(state.matrix, corner))), state.clip));
      }
      arguments_ = [];
    }
  };

  const pages = [];
  for (const body of [...objects.values()].filter((body) => /\/Type \/Page\s/.test(body))) {
    const [width, height] = body.match(/\/MediaBox \[0 0 ([\d.]+) ([\d.]+)\]/).slice(1).map(Number);
    const page = { width, height, texts: [], shapes: [] };
    await draw(body, [1, 0, 0, 1, 0, 0], [0, 0, width, height], page);
    pages.push(page);
  }
  const faults = [];
  // Without spaces and hyphens that come and go with wrapping, and with ligatures as letters.
  const bare = (text) => text.normalize("NFKC").replace(/[\s\u200b\u00ad]/g, "");
  const isFooter = (text) => text.box[3] < (14 / 25.4) * 72;
  for (const [k, page] of pages.entries()) {
    page.footer = bare(page.texts.filter((text) => isFooter(text)).map((text) => text.line).join(""));
    page.texts = page.texts.filter((text) => !isFooter(text));
    page.words = bare(page.texts.map((text) => text.line).join(""));
    const name = `page ${k + 1} of ${pages.length}`;
    if (page.footer !== bare(`research use only \u00b7 ${name}`)) faults.push(`${name} ends with "${page.footer}"`);
    if (page.words === "") faults.push(`${name} is empty`);
    const straight = page.texts.filter((text) => !text.isAslant && text.line.trim() !== "");
    for (const [i, a] of straight.entries()) {
      for (const b of straight.slice(i + 1)) {
        const [x0, y0, x1, y1] = common(a.box, b.box);
        const low = Math.min(a.box[3] - a.box[1], b.box[3] - b.box[1]);
        if (x1 - x0 > 1 && y1 - y0 > 0.15 * low) faults.push(`${name}: "${a.line}" lies over "${b.line}"`);
      }
    }
  }
  const onOnePage = (words) => pages.some((page) => page.words.includes(words));
  const printed = (element) => element.checkVisibility({ contentVisibilityAuto: false }) || element.closest("details:not(.layers)") !== null;
  for (const row of [...document.querySelectorAll("tr")].filter(printed)) {
    const words = bare(row.textContent);
    if (!onOnePage(words)) faults.push(`a row is not on one page: ${words.slice(0, 80)}`);
  }
  for (const figure of document.querySelectorAll("figure")) {
    const texts = [...figure.querySelectorAll(".drawing svg text, .legend, figcaption")];
    const parts = texts.map((text) => {
      const copy = text.cloneNode(true);
      copy.querySelectorAll(".how, title").forEach((hidden) => hidden.remove());
      return bare(copy.textContent);
    });
    const holds = (page) => parts.every((part) => page.words.includes(part));
    const name = bare(figure.querySelector("figcaption").textContent).slice(0, 40);
    if (!pages.some(holds)) faults.push(`a figure is not on one page: ${name}`);
  }

  const pictures = pages.map((page) => {
    const [columns, rows] = page.width < page.height ? [64, 90] : [90, 64];
    const picture = Array.from({ length: rows }, () => Array(columns).fill("."));
    const fill = ([x0, y0, x1, y1], letter) => {
      for (let row = Math.max(0, Math.floor((1 - y1 / page.height) * rows)); row <= (1 - y0 / page.height) * rows && row < rows; row++) {
        for (let column = Math.max(0, Math.floor((x0 / page.width) * columns)); column <= (x1 / page.width) * columns && column < columns; column++) picture[row][column] = letter;
      }
    };
    page.shapes.filter(([x0, y0, x1, y1]) => x0 <= x1 && y0 <= y1).forEach((shape) => fill(shape, "+"));
    page.texts.forEach((text) => fill(text.box, "#"));
    return picture.map((row) => row.join("")).join("\n");
  });
  return { faults, pictures };
})

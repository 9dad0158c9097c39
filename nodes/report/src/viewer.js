"use strict";
// Draws the views of the page with WebGL: orthographic, so that lengths on the screen are lengths on the bone.
(() => {
  const shared = JSON.parse(document.getElementById("data").textContent);
  const bytes = (text) => Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
  const rgb = (hex) => [1, 3, 5].map((k) => parseInt(hex.slice(k, k + 2), 16) / 255);

  const positions = (data, centre) => {
    const raw = new Uint16Array(bytes(data.positions).buffer);
    return Float32Array.from(raw, (c, k) => c * data.step + (data.low[k % 3] - centre[k % 3]));
  };

  const colours = (part, data, n) => {
    const out = new Float32Array(3 * n);
    if (!data.values) {
      const [r, g, b] = rgb(part.colour);
      for (let k = 0; k < n; k++) out.set([r, g, b], 3 * k);
      return out;
    }
    const stops = part.ramp.map(rgb), levels = bytes(data.values);
    for (let k = 0; k < n; k++) {
      const at = (levels[k] / 255) * (stops.length - 1);
      const low = Math.min(Math.floor(at), stops.length - 2), share = at - low;
      for (let c = 0; c < 3; c++) out[3 * k + c] = stops[low][c] * (1 - share) + stops[low + 1][c] * share;
    }
    return out;
  };

  const normals = (points, faces) => {
    const out = new Float32Array(points.length);
    for (let f = 0; f < faces.length; f += 3) {
      const [a, b, c] = [3 * faces[f], 3 * faces[f + 1], 3 * faces[f + 2]];
      const [u, v] = [b, c].map((to) => [0, 1, 2].map((k) => points[to + k] - points[a + k]));
      const n = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]];
      for (const i of [a, b, c]) for (let k = 0; k < 3; k++) out[i + k] += n[k];
    }
    return out;
  };

  const SHAPED = [`
    attribute vec3 at, colour, normal; uniform mat3 turn; uniform vec3 shift, scale;
    varying vec3 tint, facing;
    void main() {
      gl_Position = vec4((turn * at + shift) * scale, 1.0); tint = colour; facing = turn * normal;
    }`, `
    precision mediump float; varying vec3 tint; varying vec3 facing; uniform float opacity; uniform float flat_;
    void main() {
      float light = flat_ > 0.5 ? 1.0 : 0.38 + 0.62 * abs(normalize(facing).z);
      gl_FragColor = vec4(tint * light * opacity, opacity);
    }`];
  const BALLS = [`
    attribute vec3 at, colour; uniform mat3 turn; uniform vec3 shift, scale; uniform float size; varying vec3 tint;
    void main() { gl_Position = vec4((turn * at + shift) * scale, 1.0); gl_PointSize = size; tint = colour; }`, `
    precision mediump float; varying vec3 tint;
    void main() {
      vec2 p = 2.0 * gl_PointCoord - 1.0; float r = dot(p, p); if (r > 1.0) discard;
      gl_FragColor = vec4(tint * (0.72 + 0.28 * sqrt(1.0 - r)), 1.0);
    }`];

  const program = (gl, [vertex, fragment]) => {
    const made = gl.createProgram();
    for (const [type, source] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
      const shader = gl.createShader(type);
      gl.shaderSource(shader, source);
      gl.compileShader(shader);
      if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(shader));
      gl.attachShader(made, shader);
    }
    gl.linkProgram(made);
    return made;
  };

  const rotation = (axis, angle) => {
    const [c, s] = [Math.cos(angle), Math.sin(angle)];
    return axis === 0 ? [1, 0, 0, 0, c, s, 0, -s, c] : [c, 0, -s, 0, 1, 0, s, 0, c];
  };
  // Both by columns, as WebGL takes them.
  const times = (a, b) => Array.from({ length: 9 }, (_, i) =>
    [0, 1, 2].reduce((sum, k) => sum + a[3 * k + (i % 3)] * b[3 * Math.floor(i / 3) + k], 0));

  const view = (box) => {
    const canvas = box.querySelector("canvas");
    const gl = canvas.getContext("webgl", { antialias: true, preserveDrawingBuffer: true, alpha: true });
    if (!gl) {
      box.querySelector(".fallback").hidden = false;
      for (const part of box.querySelectorAll(".bar, .scale")) part.hidden = true;
      return;
    }
    const scene = JSON.parse(document.getElementById(box.dataset.scene).textContent);
    gl.getExtension("OES_element_index_uint");
    const shaped = program(gl, SHAPED), balls = program(gl, BALLS);
    const buffer = (target, data) => {
      const made = gl.createBuffer();
      gl.bindBuffer(target, made);
      gl.bufferData(target, data, gl.STATIC_DRAW);
      return made;
    };
    const parts = [], tags = [];
    let reach = 1;
    for (const part of scene.parts) {
      if (part.type === "tag") {
        const word = document.createElement("span");
        word.className = "tag";
        word.textContent = part.word;
        box.append(word);
        tags.push({ word, at: part.at.map((c, k) => c - scene.centre[k]) });
        continue;
      }
      const data = part.own || shared[part.data];
      const points = positions(data, scene.centre);
      for (const c of points) reach = Math.max(reach, Math.abs(c));
      const made = { ...part, n: points.length / 3, at: buffer(gl.ARRAY_BUFFER, points) };
      made.colours = buffer(gl.ARRAY_BUFFER, colours(part, data, made.n));
      if (part.type === "mesh") {
        const faces = new Uint32Array(bytes(data.faces).buffer);
        made.normals = buffer(gl.ARRAY_BUFFER, normals(points, faces));
        made.faces = buffer(gl.ELEMENT_ARRAY_BUFFER, faces);
        made.n = faces.length;
      }
      parts.push(made);
    }
    // What is seen through comes last.
    parts.sort((a, b) => (b.opacity || 1) - (a.opacity || 1));

    const first = () => ({ turn: scene.turn.slice(), half: scene.halfWidth, shift: [0, 0] });
    let now = first(), asked = false;

    const attribute = (which, name, data) => {
      const place = gl.getAttribLocation(which, name);
      if (place < 0) return;
      gl.bindBuffer(gl.ARRAY_BUFFER, data);
      gl.enableVertexAttribArray(place);
      gl.vertexAttribPointer(place, 3, gl.FLOAT, false, 0, 0);
    };

    const draw = () => {
      asked = false;
      const ratio = window.devicePixelRatio || 1;
      const [width, height] = [canvas.clientWidth, canvas.clientHeight];
      if (!width || !height) return;
      [canvas.width, canvas.height] = [Math.round(width * ratio), Math.round(height * ratio)];
      gl.viewport(0, 0, canvas.width, canvas.height);
      gl.clearColor(0, 0, 0, 0);
      gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
      gl.enable(gl.DEPTH_TEST);
      gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
      const scale = [1 / now.half, width / height / now.half, -1 / (4 * reach)];
      const pixels = (width * ratio) / (2 * now.half);
      for (const part of parts) {
        const which = part.type === "points" ? balls : shaped;
        gl.useProgram(which);
        for (const name of ["at", "colour", "normal"]) {
          const place = gl.getAttribLocation(which, name);
          if (place >= 0) gl.disableVertexAttribArray(place);
        }
        const uniform = (name) => gl.getUniformLocation(which, name);
        gl.uniformMatrix3fv(uniform("turn"), false, now.turn);
        // What lies on a surface, or just under it, is brought forth so far, mm, and seen.
        const forth = part.type === "points" ? 1 : part.type === "lines" ? 0.3 : 0;
        gl.uniform3f(uniform("shift"), now.shift[0], now.shift[1], forth);
        gl.uniform3fv(uniform("scale"), scale);
        attribute(which, "at", part.at);
        attribute(which, "colour", part.colours);
        if (part.type === "points") {
          gl.uniform1f(uniform("size"), Math.max(2 * part.radius * pixels, 2.5 * ratio));
          gl.drawArrays(gl.POINTS, 0, part.n);
          continue;
        }
        const through = part.opacity < 1;
        gl.uniform1f(uniform("opacity"), part.opacity === undefined ? 1 : part.opacity);
        gl.uniform1f(uniform("flat_"), part.type === "lines" || through ? 1 : 0);
        if (part.type === "lines") {
          gl.drawArrays(gl.LINES, 0, part.n);
          continue;
        }
        attribute(which, "normal", part.normals);
        gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, part.faces);
        if (through) { gl.enable(gl.BLEND); gl.depthMask(false); }
        gl.drawElements(gl.TRIANGLES, part.n, gl.UNSIGNED_INT, 0);
        if (through) { gl.disable(gl.BLEND); gl.depthMask(true); }
      }
      for (const { word, at } of tags) {
        const along = (row) => [0, 1, 2].reduce((sum, k) => sum + now.turn[3 * k + row] * at[k], now.shift[row]);
        const seen = [along(0), along(1)];
        word.style.left = `${width / 2 + (seen[0] / now.half) * (width / 2) + 7}px`;
        word.style.top = `${height / 2 - (seen[1] / now.half) * (width / 2) - 7}px`;
      }
      const wish = now.half / 3, power = 10 ** Math.floor(Math.log10(wish));
      const length = [5, 2, 1].find((m) => m * power <= wish) * power;
      const bar = box.querySelector(".scale");
      bar.querySelector("i").style.width = `${(length / (2 * now.half)) * width}px`;
      bar.querySelector("span").textContent = `${length} mm`;
    };
    const ask = () => { if (!asked) { asked = true; requestAnimationFrame(draw); } };

    const turn = (dx, dy) => { now.turn = times(rotation(0, dy), times(rotation(1, dx), now.turn)); ask(); };
    const zoom = (factor) => { now.half = Math.min(Math.max(now.half * factor, 0.5), 20 * scene.halfWidth); ask(); };
    const move = (dx, dy) => {
      const mm = (2 * now.half) / canvas.clientWidth;
      now.shift = [now.shift[0] + dx * mm, now.shift[1] - dy * mm];
      ask();
    };

    const held = new Map();
    canvas.addEventListener("pointerdown", (e) => {
      canvas.setPointerCapture(e.pointerId);
      held.set(e.pointerId, [e.clientX, e.clientY]);
      canvas.focus({ preventScroll: true });
    });
    canvas.addEventListener("pointermove", (e) => {
      const before = held.get(e.pointerId);
      if (!before) return;
      const [dx, dy] = [e.clientX - before[0], e.clientY - before[1]];
      if (held.size === 2) {
        const [other] = [...held].filter(([id]) => id !== e.pointerId).map(([, at]) => at);
        const apart = (at) => Math.hypot(at[0] - other[0], at[1] - other[1]);
        zoom(apart(before) / Math.max(apart([e.clientX, e.clientY]), 1));
      } else if (e.shiftKey || e.buttons === 4) move(dx, dy);
      else turn(dx * 0.008, dy * 0.008);
      held.set(e.pointerId, [e.clientX, e.clientY]);
    });
    for (const end of ["pointerup", "pointercancel"]) canvas.addEventListener(end, (e) => held.delete(e.pointerId));
    // The page scrolls over a view that was not clicked.
    canvas.addEventListener("wheel", (e) => {
      if (document.activeElement !== canvas) return;
      e.preventDefault();
      zoom(Math.exp(Math.max(-60, Math.min(60, e.deltaY)) * 0.003));
    }, { passive: false });
    canvas.addEventListener("keydown", (e) => {
      const keys = {
        ArrowLeft: () => turn(-0.1, 0), ArrowRight: () => turn(0.1, 0),
        ArrowUp: () => turn(0, -0.1), ArrowDown: () => turn(0, 0.1),
        "+": () => zoom(0.85), "=": () => zoom(0.85), "-": () => zoom(1 / 0.85), 0: () => { now = first(); ask(); },
      };
      if (keys[e.key]) { e.preventDefault(); keys[e.key](); }
    });
    box.querySelector(".bar").addEventListener("click", (e) => {
      const what = e.target.dataset.do;
      if (what === "in") zoom(0.75);
      if (what === "out") zoom(1 / 0.75);
      if (what === "reset") { now = first(); ask(); }
    });
    canvas.addEventListener("dblclick", () => { now = first(); ask(); });
    new ResizeObserver(ask).observe(box);
    draw();
  };

  // A browser holds few drawings at a time, so each view begins when it comes into sight; all do before printing.
  const waiting = new Set(document.querySelectorAll(".view"));
  const begin = (box) => { if (waiting.delete(box)) view(box); };
  const come = (seen) => seen.filter((s) => s.isIntersecting).forEach((s) => begin(s.target));
  const sight = new IntersectionObserver(come, { rootMargin: "400px" });
  waiting.forEach((box) => sight.observe(box));
  window.addEventListener("beforeprint", () => [...waiting].forEach(begin));
})();

// The views of the report: each draws with the scene of the live page, orthographic, so that lengths on the screen are lengths on the bone.

import * as THREE from "three";
import { Devices } from "./devices.js";
import { Frames } from "./frames.js";
import { LayerList } from "./layers.js";
import { Scene } from "./scene.js";
import { showParts, showPicture } from "./shown.js";
import { errorsOf, showVerdict } from "./verdict.js";

/** What a key or a button does: radians to the right and down, or a factor of what is seen. */
const TURN = 0.1, NEARER = 0.8;

class View {
  /** @param {HTMLElement} box @param {any} content @param {any} data of the page */
  constructor(box, content, data) {
    this.box = box;
    this.look = content.look ?? null;
    const holder = /** @type {HTMLElement} */ (box.querySelector(".holder"));
    this.scene = new Scene(holder, { worker: null, isOrthographic: true });
    this.frames = new Frames();
    this.devices = new Devices(this.scene);
    this.list = new LayerList(/** @type {HTMLElement} */ (box.parentElement?.querySelector(".layers ul")), this.scene);
    this.scene.judge(content.answer ?? data.verdict?.answer ?? null, errorsOf(data.verdict, content.picture?.targets ?? null));
    if (content.picture) showPicture(this, content.picture, data.shared);
    showParts(this, content.layers ?? [], data.shared);
    const judged = /** @type {HTMLElement | null} */ (box.parentElement?.querySelector(".judged") ?? null);
    if (judged) {
      const place = document.createElement("div");
      judged.replaceChildren(place);
      showVerdict(place, data.verdict, "not judged");
    }
    this.canvas = this.scene.renderer.domElement;
    this.canvas.tabIndex = 0;
    this.canvas.setAttribute("role", "img");
    this.canvas.setAttribute("aria-label", holder.dataset.about ?? "");
    this.isAsked = false;
    this.scene.asks = () => this.ask();
    this.listen();
    this.reset();
    this.draw();
  }

  ask() {
    if (this.isAsked) return;
    this.isAsked = true;
    requestAnimationFrame(() => this.draw());
  }

  draw() {
    this.isAsked = false;
    this.devices.draw(this.frames);
    this.scene.draw(this.frames);
    this.list.draw();
    const { clientWidth: width, clientHeight: height } = this.scene.holder;
    const halfMm = 1000 * this.scene.eye.half(this.scene.controls.target);
    const wish = (halfMm * width) / height / 3;
    const power = 10 ** Math.floor(Math.log10(wish));
    const length = ([5, 2, 1].find((m) => m * power <= wish) ?? 1) * power;
    const bar = /** @type {HTMLElement} */ (this.box.querySelector(".scale"));
    /** @type {HTMLElement} */ (bar.querySelector("i")).style.width = `${(length / (2 * halfMm)) * height}px`;
    /** @type {HTMLElement} */ (bar.querySelector("span")).textContent = `${length} mm`;
  }

  /** As at first. */
  reset() {
    const { scene, look } = this;
    if (look) {
      const [centre, from, up] = [look.centre, look.from, look.up].map((c) => new THREE.Vector3(...c));
      centre.multiplyScalar(0.001);
      // The view shows the whole width that it was made for.
      const half = (look.halfWidth / scene.eye.aspect) * 0.001;
      scene.eye.look(centre, from, up, half, Math.max(1, 4 * half));
      scene.controls.target.copy(centre);
      scene.controls.update();
    } else scene.look("scan", this.frames);
    scene.isLookedAt = scene.isTurned = look !== null;
    scene.redraw();
  }

  /** @param {number} right @param {number} down radians */
  turn(right, down) {
    this.scene.controls.turn(right, down);
    this.scene.isTurned = true;
  }

  /** @param {number} factor */
  zoom(factor) {
    this.scene.controls.zoom(factor);
    this.scene.isTurned = true;
  }

  listen() {
    const { canvas, scene } = this;
    // The page scrolls over a view that was not clicked.
    scene.controls.enableZoom = false;
    canvas.addEventListener("focus", () => { scene.controls.enableZoom = true; });
    canvas.addEventListener("blur", () => { scene.controls.enableZoom = false; });
    canvas.addEventListener("pointerdown", () => canvas.focus({ preventScroll: true }));
    canvas.addEventListener("dblclick", () => this.reset());
    /** @type {Record<string, () => void>} */
    const does = {
      ArrowLeft: () => this.turn(-TURN, 0), ArrowRight: () => this.turn(TURN, 0),
      ArrowUp: () => this.turn(0, -TURN), ArrowDown: () => this.turn(0, TURN),
      "+": () => this.zoom(NEARER), "=": () => this.zoom(NEARER), "-": () => this.zoom(1 / NEARER), 0: () => this.reset(),
      g: () => {
        scene.glass(!scene.isGlass);
        this.box.querySelector("[data-do=g]")?.setAttribute("aria-pressed", String(scene.isGlass));
      },
    };
    for (const [k, side] of /** @type {const} */ (["scan", "lateral", "anterior", "along"]).entries()) {
      does[k + 1] = () => {
        scene.isTurned = true;
        scene.look(side, this.frames);
      };
    }
    canvas.addEventListener("keydown", (event) => {
      if (!does[event.key]) return;
      event.preventDefault();
      does[event.key]();
    });
    this.box.querySelector(".bar")?.addEventListener("click", (event) => does[/** @type {HTMLElement} */ (event.target).dataset.do ?? ""]?.());
  }
}

/** Makes the views of the page. @param {any} data */
export function showViews(data) {
  /** @type {View[]} */
  const views = [];
  // A browser holds few drawings at a time, so each view begins when it comes into sight; all do before printing.
  const waiting = new Set(/** @type {NodeListOf<HTMLElement>} */ (document.querySelectorAll(".view")));
  const begin = (/** @type {HTMLElement} */ box) => {
    if (!waiting.delete(box)) return;
    const n = Number(box.dataset.scene);
    try {
      views[n] = new View(box, data.views[n], data);
    } catch (error) {
      const fallback = /** @type {HTMLElement} */ (box.querySelector(".fallback"));
      const why = hasWebGl() ? `This view failed (${error instanceof Error ? error.message : error}).` : "This browser has no WebGL.";
      fallback.textContent = `${why} ${fallback.dataset.instead}`;
      fallback.hidden = false;
      for (const part of box.querySelectorAll(".bar, .scale, canvas")) /** @type {HTMLElement} */ (part).hidden = true;
    }
  };
  const sight = new IntersectionObserver((seen) => seen.filter((one) => one.isIntersecting).forEach((one) => begin(/** @type {HTMLElement} */ (one.target))), { rootMargin: "400px" });
  waiting.forEach((box) => sight.observe(box));
  window.addEventListener("beforeprint", () => [...waiting].forEach(begin));
  // For tests, and for the browser's console.
  Object.assign(window, { osteoflow: { views, verdict: data.verdict } });
}

function hasWebGl() {
  return document.createElement("canvas").getContext("webgl2") !== null;
}

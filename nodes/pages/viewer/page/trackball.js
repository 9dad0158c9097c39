// The hand on the camera: a drag turns what is shown about the point under the pointer, the wheel zooms to it, a double click puts it in the middle
// (docs/decisions/0044).

import * as THREE from "three";

/** A drag over the whole height of the view turns by half a turn. */
const TURN_PER_HEIGHT = Math.PI;
/** What a notch of the wheel changes the distance by. */
const NOTCH = 0.88;
/** Pixels of a notch, of a line and of a page, as browsers count the wheel. */
const NOTCH_PX = 100, LINE_PX = 33, PAGE_PX = 800;
/** Gestures of a touchpad that browsers give as a wheel with Ctrl come in small steps. */
const PINCH_GAIN = 8;
/** A wheel that turns on within this time and this far from where it began stays with the point that it began at, ms and pixels. */
const WHEEL_MS = 400, WHEEL_PX = 6;
/** Two clicks within this time and distance are a double click, ms and pixels. */
const DOUBLE_MS = 400, DOUBLE_PX = { mouse: 6, touch: 30 };
/** Pointers that move less have clicked. */
const CLICK_PX = 4;
/** Limits of the distance, in the scene's metres, and of the zoom of an orthographic camera. */
const NEAREST = 0.003, FARTHEST = 10, LEAST_ZOOM = 0.05, MOST_ZOOM = 200;

/** @typedef {{x: number, y: number}} Place in the window, pixels */

/** @extends {THREE.EventDispatcher<{start: {}, change: {}}>} */
export class Trackball extends THREE.EventDispatcher {
  /**
   * @param {THREE.PerspectiveCamera | THREE.OrthographicCamera} camera
   * @param {HTMLElement} element that the pointers are over
   * @param {(place: Place) => THREE.Vector3 | null} under what is under a place of the window
   */
  constructor(camera, element, under) {
    super();
    this.camera = camera;
    this.element = element;
    this.under = under;
    this.enabled = true;
    this.enableZoom = true;
    /** What is looked at; what is drawn beside it is turned about it. */
    this.target = new THREE.Vector3();
    /** The point that is held. */
    this.pivot = new THREE.Vector3();
    /** Pointers that are down, and where. @type {Map<number, Place>} */
    this.pointers = new Map();
    /** @type {"turn" | "pan" | null} */
    this.does = null;
    /** Where the pointer went down, and whether it has left that place. @type {{at: Place, moved: boolean} | null} */
    this.press = null;
    /** The last click. @type {{at: Place, ms: number} | null} */
    this.click = null;
    /** The last turn of the wheel. @type {{at: Place, ms: number} | null} */
    this.wheel = null;
    element.style.touchAction = "none";
    element.addEventListener("pointerdown", (event) => this.down(event));
    element.addEventListener("pointermove", (event) => this.move(event));
    for (const end of /** @type {const} */ (["pointerup", "pointercancel"])) element.addEventListener(end, (event) => this.up(event));
    element.addEventListener("wheel", (event) => this.roll(event), { passive: false });
    element.addEventListener("contextmenu", (event) => event.preventDefault());
  }

  /** Looks at the target from where the camera is, its `up` upwards. */
  update() {
    const { camera, target } = this;
    camera.lookAt(target);
    // The vertical of the screen, however the view was turned.
    camera.up.set(0, 1, 0).applyQuaternion(camera.quaternion);
    if (camera instanceof THREE.PerspectiveCamera) {
      const distance = camera.position.distanceTo(target);
      camera.near = distance / 100;
      camera.far = Math.max(camera.far, 4 * distance);
      camera.updateProjectionMatrix();
    }
    camera.updateMatrixWorld();
    this.dispatchEvent({ type: "change" });
  }

  /**
   * Turns what is shown with the hand: about the screen's vertical by what goes right, about its horizontal by what goes down.
   * @param {number} right radians
   * @param {number} down radians
   * @param {THREE.Vector3} about
   */
  turn(right, down, about = this.target) {
    const { camera, target } = this;
    const angle = Math.hypot(right, down);
    if (angle === 0) return;
    // The camera goes the other way.
    const axis = new THREE.Vector3(-down, -right, 0).divideScalar(angle).applyQuaternion(camera.quaternion);
    const turn = new THREE.Quaternion().setFromAxisAngle(axis, angle);
    const centre = about.clone();
    for (const place of [camera.position, target]) place.sub(centre).applyQuaternion(turn).add(centre);
    camera.up.applyQuaternion(turn);
    this.update();
  }

  /** Zooms; the point stays where it is on the screen. @param {number} factor of the distance @param {THREE.Vector3} to */
  zoom(factor, to = this.target) {
    const { camera, target } = this;
    if (camera instanceof THREE.OrthographicCamera) {
      const zoom = Math.min(Math.max(camera.zoom / factor, LEAST_ZOOM), MOST_ZOOM);
      const towards = new THREE.Vector3().setFromMatrixColumn(camera.matrixWorld, 2);
      const shift = to.clone().sub(camera.position).projectOnPlane(towards).multiplyScalar(1 - camera.zoom / zoom);
      camera.zoom = zoom;
      camera.updateProjectionMatrix();
      for (const place of [camera.position, target]) place.add(shift);
    } else {
      const distance = camera.position.distanceTo(target);
      const centre = to.clone();
      const limited = Math.min(Math.max(distance * factor, NEAREST), FARTHEST) / distance;
      for (const place of [camera.position, target]) place.sub(centre).multiplyScalar(limited).add(centre);
    }
    this.update();
  }

  /** Moves what is shown with the hand, at the depth of a point. @param {number} right pixels @param {number} down pixels @param {THREE.Vector3} at */
  pan(right, down, at = this.target) {
    const { camera, target } = this;
    const height = this.element.clientHeight || 1;
    const half = camera instanceof THREE.OrthographicCamera ? camera.top / camera.zoom : this.depth(at) * Math.tan((camera.fov * Math.PI) / 360);
    const shift = new THREE.Vector3(-right, down, 0).multiplyScalar((2 * half) / height).applyQuaternion(camera.quaternion);
    for (const place of [camera.position, target]) place.add(shift);
    this.update();
  }

  /** Puts a point in the middle of the view, as far away as what is looked at was. @param {THREE.Vector3} point */
  centre(point) {
    this.camera.position.add(point).sub(this.target);
    this.target.copy(point);
    this.update();
  }

  /** How far in front of the camera a point is. @param {THREE.Vector3} point */
  depth(point) {
    const { camera } = this;
    const forward = new THREE.Vector3(0, 0, -1).applyQuaternion(camera.quaternion);
    return Math.max(point.clone().sub(camera.position).dot(forward), NEAREST);
  }

  /** Takes hold of the point under a place; where there is none, of what is looked at. @param {Place} place */
  hold(place) {
    this.pivot.copy(this.under(place) ?? this.target);
  }

  /** The middle of the pointers, and how far apart they are. */
  spread() {
    const all = [...this.pointers.values()];
    const middle = { x: all.reduce((sum, { x }) => sum + x, 0) / all.length, y: all.reduce((sum, { y }) => sum + y, 0) / all.length };
    return { middle, apart: all.length < 2 ? 0 : Math.hypot(all[1].x - all[0].x, all[1].y - all[0].y) };
  }

  /** @param {PointerEvent} event */
  down(event) {
    if (!this.enabled || this.pointers.size > 1) return;
    const place = { x: event.clientX, y: event.clientY };
    this.pointers.set(event.pointerId, place);
    this.element.setPointerCapture(event.pointerId);
    const isSide = event.button !== 0 || event.shiftKey || event.ctrlKey || event.metaKey;
    this.does = this.pointers.size > 1 || isSide ? "pan" : "turn";
    this.press = this.pointers.size === 1 && !isSide ? { at: place, moved: false } : null;
    this.hold(this.spread().middle);
    this.dispatchEvent({ type: "start" });
  }

  /** @param {PointerEvent} event */
  move(event) {
    const known = this.pointers.get(event.pointerId);
    if (!known) return;
    if (!this.enabled) return this.release();
    const before = this.spread();
    this.pointers.set(event.pointerId, { x: event.clientX, y: event.clientY });
    const { middle, apart } = this.spread();
    const [right, down] = [middle.x - before.middle.x, middle.y - before.middle.y];
    if (this.press && Math.hypot(middle.x - this.press.at.x, middle.y - this.press.at.y) > CLICK_PX) this.press.moved = true;
    const perPixel = TURN_PER_HEIGHT / (this.element.clientHeight || 1);
    if (this.does === "turn") this.turn(right * perPixel, down * perPixel, this.pivot);
    else this.pan(right, down, this.pivot);
    if (apart > 0 && before.apart > 0) this.zoom(before.apart / apart, this.pivot);
  }

  /** @param {PointerEvent} event */
  up(event) {
    if (!this.pointers.delete(event.pointerId)) return;
    // A finger that stays down goes on as one.
    if (this.pointers.size === 1) {
      this.does = "turn";
      this.hold(this.spread().middle);
    }
    const press = this.press;
    this.press = null;
    if (!press || press.moved || event.type !== "pointerup") return;
    const px = event.pointerType === "mouse" ? DOUBLE_PX.mouse : DOUBLE_PX.touch;
    const { click } = this;
    const isDouble = click && event.timeStamp - click.ms < DOUBLE_MS && Math.hypot(click.at.x - press.at.x, click.at.y - press.at.y) < px;
    this.click = isDouble ? null : { at: press.at, ms: event.timeStamp };
    const point = isDouble ? this.under(press.at) : null;
    if (point) this.centre(point);
  }

  /** Lets go of everything. */
  release() {
    this.pointers.clear();
    this.press = null;
  }

  /** @param {WheelEvent} event */
  roll(event) {
    if (!this.enabled || !this.enableZoom) return;
    event.preventDefault();
    const place = { x: event.clientX, y: event.clientY };
    const { wheel } = this;
    const goesOn = wheel && event.timeStamp - wheel.ms < WHEEL_MS && Math.hypot(place.x - wheel.at.x, place.y - wheel.at.y) < WHEEL_PX;
    if (!goesOn) this.hold(place);
    this.wheel = { at: goesOn ? wheel.at : place, ms: event.timeStamp };
    const px = event.deltaY * [1, LINE_PX, PAGE_PX][event.deltaMode] * (event.ctrlKey ? PINCH_GAIN : 1);
    this.dispatchEvent({ type: "start" });
    this.zoom(NOTCH ** (-px / NOTCH_PX), this.pivot);
  }
}

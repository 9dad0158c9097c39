// The hands: pointer and keys in the view, and what they ask of the picking.

/** @typedef {import("./picks.js").Group} Group */
/** @typedef {import("./picks.js").Picked} Picked */

/** Distance from a mark, in pixels, at which a mouse or a finger takes it, and within which points of a scan are picked. */
const REACH_PX = { mouse: 11, touch: 24 };
/** A press that moves less is a click, pixels. */
const CLICK_PX = 4;
/** Steps of the arrow keys, mm. */
const STEP_MM = 0.5, FINE_MM = 0.1;

export class Gestures {
  /**
   * @param {import("./pick.js").Picking} picking
   * @param {"bone" | "scan"} side what the view is of
   * @param {HTMLElement} view
   */
  constructor(picking, side, view) {
    this.picking = picking;
    this.side = side;
    this.view = view;
    /** @type {{from: Picked, offset: number[], group: Group, name: string, pointer: number, at: number[]} | null} */
    this.drag = null;
    /** @type {{x: number, y: number, pointer: number} | null} */
    this.press = null;
    // Before the controls of the view, which listen inside.
    view.addEventListener("pointerdown", (event) => this.down(event), true);
    view.addEventListener("pointermove", (event) => this.move(event), true);
    view.addEventListener("pointerup", (event) => this.up(event), true);
    view.addEventListener("pointercancel", () => this.cancel(), true);
    if (side === "bone") document.addEventListener("keydown", (event) => this.key(event), true);
  }

  /** @param {PointerEvent} event */
  down(event) {
    if (this.picking.mode === null || !(event.target instanceof HTMLCanvasElement)) return;
    // A second finger turns the view.
    if (!event.isPrimary) return this.cancel();
    if (event.button !== 0) return;
    const [x, y] = [event.clientX, event.clientY];
    this.press = { x, y, pointer: event.pointerId };
    const found = this.picking.markAt(this.side, x, y, REACH_PX[event.pointerType === "mouse" ? "mouse" : "touch"]);
    if (!found) return;
    const { group, pick, at } = found;
    this.picking.select(group, pick.name);
    this.picking.sceneOf(group).controls.enabled = false;
    this.view.setPointerCapture(event.pointerId);
    this.drag = { from: this.picking.history.now, offset: [at[0] - x, at[1] - y], group, name: pick.name, pointer: event.pointerId, at: [x, y] };
  }

  /** @param {PointerEvent} event */
  move(event) {
    const { drag } = this;
    if (!drag || event.pointerId !== drag.pointer) return;
    const [x, y] = [event.clientX, event.clientY];
    if (drag.at.length === 2 && Math.hypot(x - drag.at[0], y - drag.at[1]) < 1) return;
    drag.at = [];
    const aimed = this.picking.aimOf(drag.group).at(drag.group, x + drag.offset[0], y + drag.offset[1], REACH_PX.touch);
    if ("why" in aimed) return this.picking.say(aimed.why);
    this.picking.say("");
    this.picking.history.now = this.picking.moved(drag.group, drag.name, aimed.position);
    this.picking.changed();
  }

  /** @param {PointerEvent} event */
  up(event) {
    const { drag, press } = this;
    if (drag && event.pointerId === drag.pointer) {
      this.picking.history.settle(drag.from, this.picking.history.now);
      this.endDrag();
      this.picking.changed();
      return;
    }
    this.press = null;
    if (!press || this.picking.mode === null || event.pointerId !== press.pointer) return;
    if (Math.hypot(event.clientX - press.x, event.clientY - press.y) > CLICK_PX) return;
    this.click(press.x, press.y, REACH_PX[event.pointerType === "mouse" ? "mouse" : "touch"]);
  }

  /** Ends a drag without a change. */
  cancel() {
    if (this.drag) this.picking.history.now = this.drag.from;
    this.endDrag();
  }

  endDrag() {
    if (this.drag) this.picking.sceneOf(this.drag.group).controls.enabled = true;
    this.drag = null;
    this.press = null;
  }

  /** @param {number} x @param {number} y @param {number} px */
  click(x, y, px) {
    const group = this.picking.takes(this.side);
    if (group === null) {
      this.picking.select(null, "");
      return;
    }
    const aimed = this.picking.aimOf(group).at(group, x, y, px);
    if ("why" in aimed) return this.picking.say(aimed.why);
    this.picking.say("");
    this.picking.add(group, aimed.position);
  }

  /** @param {KeyboardEvent} event */
  key(event) {
    const { target } = event;
    if (target instanceof HTMLInputElement || target instanceof HTMLSelectElement) return;
    const done = () => {
      event.preventDefault();
      event.stopPropagation();
    };
    const isCommand = event.ctrlKey || event.metaKey;
    if (event.key === "p" && !isCommand && !this.picking.isBlocked()) {
      done();
      return this.picking.enter(this.picking.mode ? null : "plan");
    }
    if (this.picking.mode === null) return;
    // Without a point the arrows turn the view.
    if (event.key.startsWith("Arrow") && this.picking.selected === null) return;
    const mm = event.shiftKey ? FINE_MM : STEP_MM;
    /** @type {Record<string, () => void>} */
    const keys = {
      ArrowLeft: () => this.picking.nudge(-1, 0, mm),
      ArrowRight: () => this.picking.nudge(1, 0, mm),
      ArrowUp: () => this.picking.nudge(0, 1, mm),
      ArrowDown: () => this.picking.nudge(0, -1, mm),
      Delete: () => this.picking.remove(),
      Backspace: () => this.picking.remove(),
      Escape: () => {
        this.picking.cancel();
        this.picking.armed = null;
        this.picking.select(null, "");
      },
    };
    const act = isCommand && event.key.toLowerCase() === "z" ? () => (event.shiftKey ? this.picking.redo() : this.picking.undo())
      : isCommand && event.key.toLowerCase() === "y" ? () => this.picking.redo()
      : isCommand ? undefined : keys[event.key];
    if (!act) return;
    done();
    act();
  }
}

// Pointer gestures on the image: drags orbit, pan and look; wheels and pinches zoom; taps pick.

const STILL = 5; // CSS pixels of movement within a click
const LONGEST_TAP = 500;
const DOUBLE = 280;

export class Gestures {
  /**
   * Handlers receive shifts in image heights, and positions as fractions of the image: orbit(dx,
   * dy), pan(dx, dy), look(dx, dy), zoom(factor, x, y), tap(x, y), doubleTap(x, y);
   * looking() decides whether a plain drag looks around instead of orbiting.
   */
  constructor(element, handlers) {
    this.element = element;
    this.handlers = handlers;
    this.pointers = new Map();
    this.press = null;
    this.lastTap = null;
    const on = (name, handler, options) => element.addEventListener(name, handler, options);
    on("pointerdown", event => this.down(event));
    on("pointermove", event => this.move(event));
    on("pointerup", event => this.up(event, true));
    on("pointercancel", event => this.up(event, false));
    on("wheel", event => this.wheel(event), {passive: false});
    on("contextmenu", event => event.preventDefault());
  }

  place(event) {
    const box = this.element.getBoundingClientRect();
    return [(event.clientX - box.left) / box.width, (event.clientY - box.top) / box.height];
  }

  down(event) {
    if (event.button > 2) return;
    if (event.button === 1) event.preventDefault();
    this.element.setPointerCapture(event.pointerId);
    this.pointers.set(event.pointerId, [event.clientX, event.clientY]);
    const alone = this.pointers.size === 1;
    this.press = alone && event.button === 0
      ? {at: [event.clientX, event.clientY], time: event.timeStamp} : null;
    if (alone) this.kind = this.kindOf(event);
  }

  kindOf(event) {
    if (event.button !== 0 || event.shiftKey) return "pan";
    if (event.altKey || event.ctrlKey || this.handlers.looking()) return "look";
    return "orbit";
  }

  move(event) {
    const before = this.pointers.get(event.pointerId);
    if (!before) return;
    const now = [event.clientX, event.clientY];
    if (this.press) {
      const [x, y] = this.press.at;
      if (Math.hypot(now[0] - x, now[1] - y) < STILL) return;
      this.press = null;
    }
    const height = this.element.clientHeight;
    if (this.pointers.size === 1) {
      this.pointers.set(event.pointerId, now);
      this.handlers[this.kind]((now[0] - before[0]) / height, (now[1] - before[1]) / height);
      return;
    }
    this.pinch(event.pointerId, now, height);
  }

  /** Two fingers: keep the points below them fixed. */
  pinch(id, now, height) {
    const [first, second] = [...this.pointers.keys()];
    if (id !== first && id !== second) return;
    const ends = () => [this.pointers.get(first), this.pointers.get(second)];
    const measure = ([a, b]) => ({
      middle: [(a[0] + b[0]) / 2, (a[1] + b[1]) / 2],
      apart: Math.max(Math.hypot(a[0] - b[0], a[1] - b[1]), 1),
    });
    const old = measure(ends());
    this.pointers.set(id, now);
    const moved = measure(ends());
    this.handlers.pan(
      (moved.middle[0] - old.middle[0]) / height, (moved.middle[1] - old.middle[1]) / height);
    const [x, y] = this.place({clientX: moved.middle[0], clientY: moved.middle[1]});
    if (moved.apart !== old.apart) this.handlers.zoom(old.apart / moved.apart, x, y);
  }

  up(event, meant) {
    if (!this.pointers.delete(event.pointerId)) return;
    const press = this.press;
    this.press = null;
    if (!meant || !press || event.timeStamp - press.time > LONGEST_TAP) return;
    this.tap(...this.place(event), event.timeStamp);
  }

  /** Delay a tap, in case a second one follows. */
  tap(x, y, time) {
    const last = this.lastTap;
    this.lastTap = null;
    const near = last && Math.abs(last.x - x) < 0.05 && Math.abs(last.y - y) < 0.05;
    if (last) clearTimeout(last.timer);
    if (near && time - last.time < 2 * DOUBLE) {
      this.handlers.doubleTap(x, y);
      return;
    }
    const timer = setTimeout(() => {
      this.lastTap = null;
      this.handlers.tap(x, y);
    }, DOUBLE);
    this.lastTap = {x, y, time, timer};
  }

  wheel(event) {
    event.preventDefault();
    const unit = [1, 16, 400][event.deltaMode] || 1;
    const amount = Math.max(-240, Math.min(event.deltaY * unit, 240));
    // A touchpad pinch arrives as a wheel event with ctrl, in small amounts.
    const factor = Math.exp(amount * (event.ctrlKey ? 0.01 : 0.0015));
    this.handlers.zoom(factor, ...this.place(event));
  }
}

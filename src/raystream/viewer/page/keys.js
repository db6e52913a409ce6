// Keyboard: some keys are held to walk, turn and zoom; others trigger an action.

// Right, up and forward; then rotations of the view and of the orbit, in image heights per second.
const HELD = {
  KeyW: {go: [0, 0, 1]}, KeyS: {go: [0, 0, -1]},
  KeyA: {go: [-1, 0, 0]}, KeyD: {go: [1, 0, 0]},
  KeyQ: {go: [0, -1, 0]}, KeyE: {go: [0, 1, 0]},
  ArrowUp: {go: [0, 0, 1]}, ArrowDown: {go: [0, 0, -1]},
  ArrowLeft: {look: [1, 0]}, ArrowRight: {look: [-1, 0]},
  KeyJ: {orbit: [0.3, 0]}, KeyL: {orbit: [-0.3, 0]},
  KeyI: {orbit: [0, 0.3]}, KeyK: {orbit: [0, -0.3]},
};

const TYPED = "input, select, textarea, [contenteditable]";

export class Keys {
  /**
   * Handlers: walk(going, fast), orbit(dx, dy), look(dx, dy), and press(key), which returns
   * whether it handled the key; arrow keys move the crosshair while arrow(code) returns true.
   */
  constructor(handlers) {
    this.handlers = handlers;
    this.held = new Set();
    this.isTurning = false;
    addEventListener("keydown", event => this.down(event));
    addEventListener("keyup", event => this.up(event));
    addEventListener("blur", () => this.release());
    document.addEventListener("visibilitychange", () => this.release());
  }

  /** Whether a key is meant for the image, not for an input field or an open dialog. */
  isForUs(event) {
    if (event.ctrlKey || event.metaKey || event.altKey || event.isComposing) return false;
    const target = event.target instanceof Element ? event.target : document.body;
    return !target.closest(TYPED) && !document.querySelector("dialog[open]");
  }

  down(event) {
    if (!this.isForUs(event)) return;
    const arrow = /^Arrow/.test(event.code);
    if (arrow && this.handlers.arrow(event.code, event.shiftKey)) {
      event.preventDefault();
      return;
    }
    // Elsewhere arrow keys scroll or select, as usual.
    const atImage = event.target === document.body || event.target.id === "picture";
    if (event.code in HELD && (!arrow || atImage)) {
      event.preventDefault();
      this.fast = event.shiftKey;
      this.held.add(event.code);
      this.tell();
      return;
    }
    if (event.key === "Shift" && this.held.size) {
      this.fast = true;
      this.tell();
      return;
    }
    const onButton = event.target !== document.body && event.target.closest("button, a, summary");
    if (onButton && (event.key === "Enter" || event.key === " ")) return;
    if (!event.repeat && this.handlers.press(event.key)) event.preventDefault();
  }

  up(event) {
    if (event.key === "Shift") this.fast = false;
    if (this.held.delete(event.code) || event.key === "Shift") this.tell();
  }

  release() {
    this.held.clear();
    this.tell();
  }

  sum(kind, size) {
    const total = Array(size).fill(0);
    for (const code of this.held) {
      const part = HELD[code][kind];
      if (part) part.forEach((value, axis) => { total[axis] += value; });
    }
    return total.map(value => Math.max(-1, Math.min(value, 1)));
  }

  tell() {
    this.handlers.walk(this.sum("go", 3), this.fast);
    if (this.isTurning || !this.turns.length) return;
    this.isTurning = true;
    this.before = performance.now();
    requestAnimationFrame(now => this.turn(now));
  }

  get turns() {
    return ["orbit", "look"]
      .map(kind => [kind, this.sum(kind, 2)])
      .filter(([, amount]) => amount.some(part => part !== 0));
  }

  turn(now) {
    const seconds = Math.min(Math.max(now - this.before, 0), 100) / 1000 * (this.fast ? 3 : 1);
    this.before = now;
    const turns = this.turns;
    this.isTurning = turns.length > 0;
    for (const [kind, [dx, dy]] of turns) this.handlers[kind](dx * seconds, dy * seconds);
    if (this.isTurning) requestAnimationFrame(later => this.turn(later));
  }
}

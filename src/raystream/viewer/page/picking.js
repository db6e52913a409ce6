// Picking: requests the ray through a pixel, marks its first hit, and moves the crosshair.

import {byId} from "./elements.js";
import {add, length, scale} from "./vector.js";
import {place} from "./view.js";

const STEP = 0.01;
const LONG_STEP = 0.05;

export class Picking {
  /**
   * Handlers: ask(message), picked(message, place) for the panel, centre(point), and
   * missed() if there is nothing to orbit around.
   */
  constructor(handlers) {
    this.handlers = handlers;
    this.number = 0;
    this.asked = new Map();
    this.point = null;
    this.view = null;
    this.aim = [0.5, 0.5];
    this.crosshair = byId("crosshair");
    this.marker = byId("marker");
    this.canvas = byId("picture");
  }

  /** Request the ray through a point of the image: for its hits, or for a new orbit centre. */
  pick(x, y, forCentre = false) {
    if (!(x >= 0 && x <= 1 && y >= 0 && y <= 1)) return;
    this.number += 1;
    this.asked.set(this.number, {place: [x, y], forCentre});
    this.handlers.ask({type: "pick", number: this.number, x, y});
  }

  /** Handle the response. */
  take(message) {
    const asked = this.asked.get(message.number);
    this.asked.delete(message.number);
    if (!asked) return;
    const first = message.hits[0];
    if (asked.forCentre) {
      if (first) this.handlers.centre(first.position);
      else this.handlers.missed();
      return;
    }
    if (message.number !== this.number) return; // a newer one is pending
    this.point = first ? first.position : this.farPoint(message);
    this.marker.classList.toggle("empty", !first);
    this.mark();
    this.handlers.picked(message, asked.place);
  }

  farPoint({origin, direction}) {
    const size = this.view ? this.view.world.size : 1;
    return add(origin, scale(direction, 10 * size / (length(direction) || 1)));
  }

  /** Set the view of the frame on the canvas. */
  follow(view) {
    this.view = view;
    this.mark();
  }

  clear() {
    this.point = null;
    this.mark();
  }

  mark() {
    const at = this.point && this.view ? place(this.view, this.point) : null;
    const inside = at && at.every(part => part >= 0 && part <= 1);
    this.marker.hidden = !inside;
    if (inside) this.put(this.marker, at);
  }

  put(element, [x, y]) {
    const {offsetLeft, offsetTop, clientWidth, clientHeight} = this.canvas;
    element.style.transform =
      `translate(${offsetLeft + x * clientWidth}px, ${offsetTop + y * clientHeight}px)`;
  }

  get isAiming() {
    return !this.crosshair.hidden;
  }

  showCrosshair(shown) {
    this.crosshair.hidden = !shown;
    byId("aim").setAttribute("aria-pressed", String(shown));
    if (shown) this.put(this.crosshair, this.aim);
  }

  /** Move the crosshair with an arrow key; false if it is hidden. */
  arrow(code, isLong) {
    if (!this.isAiming) return false;
    const step = isLong ? LONG_STEP : STEP;
    const shift = {
      ArrowLeft: [-step, 0], ArrowRight: [step, 0], ArrowUp: [0, -step], ArrowDown: [0, step],
    }[code];
    this.aim = this.aim.map((part, axis) => Math.min(Math.max(part + shift[axis], 0), 1));
    this.put(this.crosshair, this.aim);
    return true;
  }
}

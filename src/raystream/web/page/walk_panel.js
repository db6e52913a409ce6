// The steps of a picked ray through a structure: a list, and their boxes over the image.

import {byId, make} from "./elements.js";
import {add, dot, length, scale, subtract, unit} from "./vector.js";
import {basisOf} from "./view_uniform.js";

const NEAR = 1e-3; // of a box's distance: lines are cut off before the eye

const ACTIONS = {
  split: ({name}, next) => `${name}: its plane is tested; on to ${next}`,
  up: ({name}) => `${name}: up to its parent`,
  restart: ({name}) => `restart at ${name}`,
  node: ({name}) => `${name}: the boxes of its children are tested`,
};

/** A step in words. */
function textOf(step, before, next) {
  const action = ACTIONS[step.kind];
  if (action) return action(step, next?.name ?? "the end");
  const tested = step.tests === 1 ? "1 triangle tested" : `${step.tests || "no"} triangles tested`;
  const isNew = step.primId >= 0 && step.primId !== before?.primId;
  const found = `; triangle ${step.primId} is hit at ${step.distance.toPrecision(6)}`;
  return `${step.name}: ${tested}${isNew ? found : ""}`;
}

export class WalkPanel {
  constructor(canvas) {
    this.canvas = canvas;
    this.steps = [];
    byId("walk-back").addEventListener("click", () => this.go(this.at - 1));
    byId("walk-forward").addEventListener("click", () => this.go(this.at + 1));
  }

  /** Show the first steps of a ray: visits and their boxes; and the number of all. */
  show(ray, steps, count) {
    this.ray = ray;
    this.steps = steps;
    if (!count) return this.hide();
    this.texts = this.steps.map((step, k) => textOf(step, this.steps[k - 1], this.steps[k + 1]));
    byId("walk").hidden = false;
    const more = count > this.steps.length ? `, of which the first ${this.steps.length} are listed` : "";
    byId("walk-title").textContent = count === 1 ? "1 step" : `${count.toLocaleString()} steps${more}`;
    byId("walk-list").replaceChildren(...this.texts.map((text, k) => {
      const item = make("li", "", text);
      item.addEventListener("click", () => this.go(k));
      return item;
    }));
    this.go(0);
  }

  hide() {
    this.steps = [];
    byId("walk").hidden = true;
    this.clear();
  }

  /** Show a step. */
  go(at) {
    const last = this.steps.length - 1;
    this.at = Math.min(Math.max(at, 0), last);
    byId("walk-back").disabled = this.at <= 0;
    byId("walk-forward").disabled = this.at >= last;
    byId("walk-text").textContent = `${this.at + 1} of ${last + 1}: ${this.texts[this.at]}`;
    [...byId("walk-list").children].forEach((item, k) => {
      if (k === this.at) item.setAttribute("aria-current", "step");
      else item.removeAttribute("aria-current");
    });
    byId("walk-list").children[this.at]?.scrollIntoView({block: "nearest"});
    if (this.camera) this.draw(this.camera, this.size);
  }

  clear() {
    this.canvas.width = 1;
    this.canvas.height = 1;
  }

  /** Draw the ray and the boxes up to the step that is shown, seen by a camera. */
  draw(camera, size) {
    [this.camera, this.size] = [camera, size];
    if (!this.steps.length) return this.clear();
    [this.canvas.width, this.canvas.height] = size;
    const context = this.canvas.getContext("2d");
    const lines = new Lines(context, camera, size);
    const [width, color] = [Math.max(size[1] / 300, 1), getComputedStyle(this.canvas).color];
    const steps = this.steps.slice(0, this.at + 1);
    Object.assign(context, {strokeStyle: color, lineWidth: width, globalAlpha: 0.25});
    steps.slice(0, -1).forEach(step => lines.box(step));
    context.globalAlpha = 1;
    lines.ray(this.ray, this.steps);
    context.lineWidth = 2 * width;
    lines.box(steps.at(-1));
  }
}

/** Lines of world space on a canvas. */
class Lines {
  constructor(context, camera, [width, height]) {
    Object.assign(this, {context, eye: camera.eye, axes: basisOf(camera), width, height});
    this.scale = height / 2 / Math.tan(camera.fov * Math.PI / 360);
  }

  line(from, to) {
    const ends = [from, to].map(point => this.axes.map(axis => dot(subtract(point, this.eye), axis)));
    const near = NEAR * Math.max(ends[0][2], ends[1][2]);
    if (near <= 0) return; // behind the eye
    const places = ends.map((end, k) => {
      const other = ends[1 - k];
      const share = end[2] < near ? (near - end[2]) / (other[2] - end[2]) : 0;
      const [x, y, z] = add(end, scale(subtract(other, end), share));
      return [this.width / 2 + this.scale * x / z, this.height / 2 - this.scale * y / z];
    });
    this.context.beginPath();
    this.context.moveTo(...places[0]);
    this.context.lineTo(...places[1]);
    this.context.stroke();
  }

  /** The twelve edges of a box. */
  box({low, high}) {
    const corner = bits => low.map((value, axis) => (bits >> axis & 1 ? high[axis] : value));
    for (let bits = 0; bits < 8; bits++) {
      for (let axis = 0; axis < 3; axis++) {
        if (!(bits >> axis & 1)) this.line(corner(bits), corner(bits | 1 << axis));
      }
    }
  }

  /** A ray to its hit, or as far as the boxes that it visits. */
  ray(ray, steps) {
    const [origin, direction] = [ray.slice(0, 3), unit(ray.slice(3))];
    const {distance} = steps.at(-1);
    const corners = steps.flatMap(({low, high}) => [low, high]);
    const reach = Math.max(...corners.map(corner => length(subtract(corner, origin))));
    const end = Number.isFinite(distance) ? distance : reach;
    this.line(origin, add(origin, scale(direction, end)));
  }
}

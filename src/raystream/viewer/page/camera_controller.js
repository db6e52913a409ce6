// The camera: holds the view, and sends it to the server at the screen's rate and at rest.

import {between, toShapedCamera, walk} from "./view.js";

const REST = 150; // ms without a change
const GLIDE = 260; // ms
const PACE = 0.16; // scene sizes per second
const FAST = 4;

const calm = matchMedia("(prefers-reduced-motion: reduce)");

export class CameraController {
  /** `send(camera message)` and `changed(view)` are called at the screen's frame rate. */
  constructor({send, changed}) {
    this.send = send;
    this.changed = changed;
    this.view = null;
    this.number = 0;
    this.going = [0, 0, 0];
    this.fast = false;
    this.glide = null;
    this.isDirty = false;
    this.isScheduled = false;
    this.timer = null;
  }

  /** Change the view by user input: `how` maps the current view to a new one. */
  change(how) {
    if (!this.view) return;
    this.glide = null;
    this.apply(how(this.view));
  }

  apply(view) {
    this.view = view;
    this.isDirty = true;
    this.schedule();
  }

  /** Move to another view, animated unless reduced motion is preferred. */
  go(view) {
    if (!this.view || calm.matches) {
      this.set(view);
      return;
    }
    this.glide = {from: this.view, to: view, start: performance.now()};
    this.schedule();
  }

  /** Jump to another view, at rest. */
  set(view) {
    this.glide = null;
    this.view = view;
    this.rest();
  }

  /** Walk right, up and forward, each from -1 to 1; zeros stop. */
  walk(going, fast) {
    if (!this.isWalking) this.before = performance.now();
    this.going = going;
    this.fast = fast;
    if (this.isWalking) this.schedule();
  }

  get isWalking() {
    return this.going.some(part => part !== 0);
  }

  schedule() {
    if (this.isScheduled) return;
    this.isScheduled = true;
    requestAnimationFrame(now => this.tick(now));
  }

  tick(now) {
    this.isScheduled = false;
    if (!this.view) return;
    if (this.glide) this.glideOn(now);
    if (this.isWalking) this.walkOn(now);
    if (!this.isDirty) return;
    this.isDirty = false;
    this.tell(true);
    clearTimeout(this.timer);
    this.timer = setTimeout(() => this.rest(), REST);
  }

  glideOn(now) {
    const {from, to, start} = this.glide;
    const time = Math.min(Math.max((now - start) / GLIDE, 0), 1);
    const share = time * time * (3 - 2 * time);
    if (time === 1) this.glide = null;
    this.apply(time === 1 ? to : between(from, to, share));
  }

  walkOn(now) {
    const seconds = Math.min(Math.max(now - this.before, 0), 100) / 1000;
    this.before = now;
    const pace = seconds * PACE * this.view.world.size * (this.fast ? FAST : 1);
    this.glide = null;
    this.apply(walk(this.view, ...this.going.map(part => part * pace)));
  }

  /** Send the view as resting. */
  rest() {
    clearTimeout(this.timer);
    this.isDirty = false;
    if (this.view) this.tell(false);
  }

  tell(moving) {
    this.number += 1;
    this.send({type: "camera", number: this.number, ...toShapedCamera(this.view), moving});
    this.changed(this.view);
  }
}

// An image of the viewer that this browser's GPU traces.

import {PageError, unpack} from "./pack.js";
import {TracedImage} from "./traced_image.js";
import {toShapedCamera} from "./view.js";

const STILL = 150; // ms without another view, after which the camera rests

export class BrowserImage extends TracedImage {
  /** Open the GPU for a packed scene. Handlers: say(text), stopped(text), and drawn(header, view). */
  static async make(bytes, canvas, handlers) {
    const made = new BrowserImage(await unpack(bytes), canvas);
    made.handlers = handlers;
    await made.open();
    return made;
  }

  constructor(unpacked, canvas) {
    super(unpacked, canvas);
    this.wanted = null; // the view and the size to trace
    this.traced = null; // those of the image in progress
    this.exposure = 1;
    this.movedAt = -Infinity;
    this.choice = "";
    this.drawing = Promise.resolve(); // a sample
  }

  async open() {
    await super.open();
    this.display.expose(this.exposure);
  }

  get size() {
    return this.traced.size;
  }

  get camera() {
    return toShapedCamera(this.traced.view);
  }

  /** Whether the packed scene, of one structure, has that one and the bounces of settings. */
  fits({structure, traversal, mode, max_bounces: bounces}) {
    const {traversals, modes} = this.scene;
    return traversals[structure] === traversal && modes[mode].max_bounces === bounces;
  }

  /** Trace what settings say: from the first sample on, if the image is another one than before. */
  follow({mode, samples, exposure}, view, size) {
    this.expose(exposure);
    const seen = JSON.stringify([toShapedCamera(view), size]);
    const choice = JSON.stringify([seen, mode, samples]);
    this.wanted = {view, size, seen};
    if (choice === this.choice) return;
    this.choice = choice;
    if (seen !== this.traced?.seen) this.movedAt = performance.now();
    this.mode = mode;
    this.take(samples);
    this.canvas.dataset.samples = 0;
    this.change();
  }

  /** Stop until `follow`. */
  halt() {
    this.isStopped = true;
    this.choice = "";
  }

  expose(exposure) {
    if (exposure === this.exposure) return;
    this.exposure = exposure;
    this.display.expose(exposure);
    if (!this.isRunning && this.sample && !this.gpu.isLost) this.display.show();
  }

  /** Take a number of samples of each pixel; a single one is at its centre, as the server's. */
  take(samples) {
    this.scene.samples = samples;
    const spreads = samples > 1 ? 1 : 0;
    for (const {constants} of Object.values(this.scene.modes)) {
      if (constants.SPREADS !== spreads) this.renderers = new Map();
      constants.SPREADS = spreads;
    }
  }

  /** The image on the canvas as a PNG: {file, width, height}. */
  async toFile() {
    // Until a sample is finished, pixels may be of two views.
    const isDrawn = await this.drawing.then(() => true, () => false);
    if (!isDrawn || this.gpu.isLost || !this.display.sums) {
      throw new PageError("There is no image to save yet.");
    }
    // A canvas has its content until the end of the task that draws it.
    const shown = this.display.show();
    const {width, height} = this.canvas;
    const file = await new Promise(done => this.canvas.toBlob(done, "image/png"));
    await shown;
    if (!file) throw new PageError("This browser could not make a file of the image.");
    return {file, width, height};
  }

  begins() {
    this.traced = this.wanted;
  }

  async frame() {
    this.drawing = super.frame();
    await this.drawing;
    this.canvas.dataset.samples = this.sample;
  }

  say(text) {
    this.said = text;
    if (text && !this.isStopped) this.handlers.say(text);
  }

  hide() {
    this.handlers.stopped(this.said);
  }

  shown(sample, milliseconds) {
    const [width, height] = this.size;
    const rays = width * height;
    const moving = performance.now() - this.movedAt < STILL;
    this.handlers.drawn({
      width, height, rays, moving, samples: sample + 1, target_samples: this.scene.samples,
      done: sample + 1 === this.scene.samples, render_ms: milliseconds, fps: 1000 / milliseconds,
      mrays_per_second: rays / milliseconds / 1000,
    }, this.traced.view);
  }
}

// An image that is traced on this computer's GPU, sample after sample, and again after every change.

import {Gpu, cached} from "./device.js";
import {Display} from "./display.js";
import {cornersOf} from "./geometry.js";
import {ImageRenderer} from "./images.js";
import {PageError} from "./pack.js";
import {StructureOnGpu} from "./queries.js";
import {SceneOnGpu} from "./scene_on_gpu.js";

const MOST_LOSSES = 2; // of the GPU, without a sample between
const LOST = "The GPU stopped; this page starts it again.";
const STOPPED = "The GPU stopped again. Another mode or structure may take it less time; choosing one "
  + "starts it again.";

/**
 * Derived classes have `size` and `camera`, say(text) for the visitor, shown(sample, milliseconds) after
 * a sample is on the canvas, and hide() once none will be.
 */
export class TracedImage {
  constructor(unpacked, canvas) {
    this.page = unpacked;
    this.scene = unpacked.manifest;
    this.corners = cornersOf(unpacked.arrays.vertices, unpacked.arrays.faces);
    this.mode = Object.keys(this.scene.modes)[0];
    this.structure = Object.keys(this.scene.structures)[0];
    this.canvas = canvas;
    this.sample = 0;
    this.changes = 0;
    this.losses = 0;
    this.errorCount = 0; // reported by the GPU
    this.isRunning = false;
    this.isStopped = false;
    this.isClosed = false;
  }

  async open() {
    const gpu = await Gpu.open();
    gpu.device.onuncapturederror = ({error}) => {
      this.errorCount += 1;
      if (gpu === this.gpu) this.stop(new PageError(`The GPU reported an error: ${error.message}`));
    };
    this.display = await Display.make(gpu, this.scene.shaders, this.canvas);
    this.surfaces = new SceneOnGpu(gpu, this.page, this.corners);
    this.structures = new Map();
    this.renderers = new Map();
    this.gpu = gpu;
    gpu.loss.then(() => this.change());
  }

  /** Give the GPU back. */
  close() {
    this.isClosed = this.isStopped = true;
    this.gpu?.device.destroy();
  }

  async reopen() {
    this.losses += 1;
    if (this.losses >= MOST_LOSSES) throw new PageError(STOPPED);
    this.say(LOST);
    await this.open();
    this.sample = 0;
  }

  /** Stop, and show nothing, until something is changed. */
  stop(error) {
    if (this.isClosed) return;
    if (!(error instanceof PageError)) console.error(error);
    this.isStopped = true;
    this.losses = 0;
    this.say(error.message);
    this.hide();
  }

  onGpu(name) {
    return cached(this.structures, name,
      () => new StructureOnGpu(this.gpu, this.page, this.corners, name));
  }

  rendererOf(structure, mode) {
    return cached(this.renderers, `${structure} ${mode}`,
      () => ImageRenderer.make(this.gpu, this.page, this.surfaces, this.onGpu(structure), mode));
  }

  /** Begin the image again: the view, the size or a choice has changed. */
  change() {
    if (this.isClosed) return;
    this.changes += 1;
    this.sample = 0;
    this.isStopped = false;
    if (!this.isRunning) this.run();
  }

  async run() {
    this.isRunning = true;
    while (this.sample < this.scene.samples && !this.isStopped) {
      try {
        if (this.gpu.isLost) await this.reopen();
      } catch (error) {
        this.stop(error);
        break;
      }
      try {
        await this.frame();
      } catch (error) {
        if (!(await this.gpu.wasLost())) this.stop(error);
      }
    }
    this.isRunning = false;
  }

  /** Add one sample to the image, or begin it. */
  async frame() {
    const began = performance.now();
    const {display, structure, mode} = this;
    const renderer = await this.rendererOf(structure, mode);
    if (structure !== this.structure || mode !== this.mode) return;
    const {changes, sample, size} = this;
    if (sample === 0) {
      display.begin(size);
      renderer.begin(this.camera, size);
    }
    for (let first = 0; first < renderer.pixelCount;) {
      const band = await renderer.trace(sample, first);
      display.add(band, sample, first);
      first += band.count;
      // A first sample is finished, so that there is an image while the camera moves.
      if (this.isStopped || (sample && changes !== this.changes)) return;
    }
    await display.show();
    if (this.isStopped) return;
    if (sample === 0) this.say("");
    this.losses = 0;
    this.shown(sample, performance.now() - began);
    if (changes === this.changes) this.sample += 1;
  }
}

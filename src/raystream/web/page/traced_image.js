// An image that is traced on this computer's GPU, sample after sample, and again after every change.

import {Gpu, cached} from "./device.js";
import {Display} from "./display.js";
import {cornersOf} from "./geometry.js";
import {ImageRenderer} from "./images.js";
import {PageError} from "./pack.js";
import {StructureOnGpu} from "./queries.js";
import {SceneOnGpu} from "./scene_on_gpu.js";

const MOST_LOSSES = 2; // of the GPU, without a sample between
export const LOST = "The GPU stopped; this page starts it again.";
const STOPPED = "The GPU stopped again. Another mode or structure may take it less time; choosing one "
  + "starts it again.";

/** Renderers, by machine. */
const MACHINES = {compute: ImageRenderer};

/**
 * Derived classes have `size` and `camera`, say(text) for the visitor, shown(sample, milliseconds,
 * renderer) after a sample is on the canvas, and hide() once none will be.
 */
export class TracedImage {
  constructor(unpacked, canvas) {
    this.page = unpacked;
    this.scene = unpacked.manifest;
    this.corners = cornersOf(unpacked.arrays.vertices, unpacked.arrays.faces);
    this.mode = Object.keys(this.scene.modes)[0];
    this.structure = Object.keys(this.scene.structures)[0];
    this.machine = "compute";
    this.machines = MACHINES;
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
    try {
      await this.use(gpu);
    } catch (error) {
      gpu.device.destroy();
      throw error;
    }
    if (gpu !== this.gpu) gpu.device.destroy(); // the image was closed meanwhile
  }

  async use(gpu) {
    if (this.isClosed) return;
    gpu.device.onuncapturederror = ({error}) => {
      this.errorCount += 1;
      if (gpu === this.gpu) this.stop(new PageError(`The GPU reported an error: ${error.message}`));
    };
    const display = await Display.make(gpu, this.scene.shaders, this.canvas);
    if (this.isClosed) return;
    const surfaces = new SceneOnGpu(gpu, this.page, this.corners);
    display.configure();
    this.display = display;
    this.surfaces = surfaces;
    this.structures = new Map();
    this.renderers = new Map();
    this.begun = null; // the change that the image began with
    this.gpu = gpu;
    gpu.loss.then(() => this.change());
  }

  /** Give the GPU back. */
  close() {
    this.isClosed = this.isStopped = true;
    this.gpu?.device.destroy();
  }

  /** Open another GPU; false if the image was closed meanwhile. */
  async reopen() {
    this.losses += 1;
    if (this.losses >= MOST_LOSSES) throw new PageError(STOPPED);
    this.say(LOST);
    await this.open();
    this.sample = 0;
    return !this.isClosed;
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

  rendererOf(structure, mode, machine = this.machine) {
    return cached(this.renderers, `${structure} ${mode} ${machine}`, () => this.machines[machine].make(
      this.gpu, this.page, this.surfaces, this.onGpu(structure), mode));
  }

  /** Begin the image again: the view, the size or a choice has changed. */
  change() {
    if (this.isClosed) return;
    this.changes += 1;
    this.sample = 0;
    this.isStopped = false;
    this.goOn();
  }

  goOn() {
    if (!this.isRunning) this.running = this.run();
  }

  /** Whether the image is not traced by itself, but one part after another on demand. */
  get isByStep() {
    return false;
  }

  async run() {
    this.isRunning = true;
    while (this.sample < this.scene.samples && !this.isStopped && !this.isByStep) {
      try {
        if (this.gpu.isLost && !(await this.reopen())) break;
      } catch (error) {
        this.stop(error);
        break;
      }
      const {changes} = this;
      try {
        await this.frame();
      } catch (error) {
        // What is chosen since may work.
        if (!(await this.gpu.wasLost()) && changes === this.changes) this.stop(error);
      }
    }
    this.isRunning = false;
  }

  /** The renderer of the image, which begins it if anything has changed; null if a choice has. */
  async beginImage() {
    const {structure, mode, machine} = this;
    const {renderers} = this;
    const renderer = await this.rendererOf(structure, mode, machine);
    if (structure !== this.structure || mode !== this.mode || machine !== this.machine) return null;
    if (renderers !== this.renderers) return null; // made with other constants
    if (this.sample === 0 && this.begun !== this.changes) {
      this.begins();
      this.display.begin(this.size);
      renderer.begin(this.camera, this.size);
      this.begun = this.changes;
    }
    return renderer;
  }

  /** Called before an image begins. */
  begins() {}

  /** Add one sample to the image, or begin it. */
  async frame() {
    const began = performance.now();
    const renderer = await this.beginImage();
    if (!renderer) return;
    const {changes, sample, structure, mode} = this;
    const goesOn = counts => {
      this.counted(counts);
      return !this.isStopped && !this.isByStep && !(sample && changes !== this.changes);
    };
    for (let first = 0; first < renderer.pixelCount;) {
      const band = await renderer.trace(sample, first, goesOn);
      if (!band) return;
      this.display.add(band, sample, first);
      first += band.count;
      // A first sample is finished, so that there is an image while the camera moves.
      if (this.isStopped || (sample && changes !== this.changes)) return;
    }
    await this.show(structure, mode);
    if (this.isStopped) return;
    if (sample === 0) this.say("");
    this.losses = 0;
    this.shown(sample, performance.now() - began, renderer);
    if (changes === this.changes) this.sample += 1;
  }

  /** Called with the counts of a machine that counts its rays, while a sample is traced. */
  counted() {}

  /** Show the samples so far on the canvas. */
  async show() {
    await this.display.show();
  }
}

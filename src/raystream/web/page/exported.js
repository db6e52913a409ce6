// An exported page: shows the scene, sample after sample, traced on this computer's GPU.

import {Display} from "./display.js";
import {chooseByAddress} from "./address.js";
import {byId, fillSelect, make} from "./elements.js";
import {Gpu, cached} from "./device.js";
import {cornersOf} from "./geometry.js";
import {Gestures} from "./gestures.js";
import {ImageRenderer} from "./images.js";
import {PageError, unpack} from "./pack.js";
import {dataOf} from "./page_data.js";
import {Queries, StructureOnGpu} from "./queries.js";
import {SceneOnGpu} from "./scene_on_gpu.js";
import {add, length, scale, subtract} from "./vector.js";
import {fromCamera, likelyUp, orbit, pan, toShapedCamera, worldOf, zoom} from "./view.js";
import {basisOf} from "./view_uniform.js";

const MOST_PIXELS = 1 << 20;
const MOST_LOSSES = 2; // of the GPU, without a sample between
const LOST = "The GPU stopped; this page starts it again.";
const STOPPED = "The GPU stopped again. Another mode or structure may take it less time; choosing one "
  + "starts it again.";
const STEP = 0.04; // of keys, in image heights

class Page {
  constructor(unpacked) {
    this.page = unpacked;
    this.scene = unpacked.manifest;
    this.corners = cornersOf(unpacked.arrays.vertices, unpacked.arrays.faces);
    this.mode = Object.keys(this.scene.modes)[0];
    this.structure = Object.keys(this.scene.structures)[0];
    this.canvas = byId("picture");
    this.sample = 0;
    this.changes = 0;
    this.picks = 0;
    this.losses = 0;
    this.errorCount = 0; // reported by the GPU
    this.isRunning = false;
    this.isStopped = false;
    const [lower, upper] = this.scene.bounds;
    const up = likelyUp(this.scene.camera.up);
    const world = worldOf(up, length(subtract(upper, lower)));
    this.home = fromCamera(this.scene.camera, world);
    this.view = this.home;
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
    this.queries = new Map();
    this.gpu = gpu;
    gpu.loss.then(() => this.change());
  }

  async reopen() {
    this.losses += 1;
    if (this.losses >= MOST_LOSSES) throw new PageError(STOPPED);
    say(LOST);
    await this.open();
    this.sample = 0;
  }

  /** Stop, and show the image that was rendered beforehand, until something is changed. */
  stop(error) {
    if (!(error instanceof PageError)) console.error(error);
    this.isStopped = true;
    this.losses = 0;
    say(error.message);
    byId("preview").hidden = false;
    this.canvas.hidden = true;
  }

  onGpu(name) {
    return cached(this.structures, name,
      () => new StructureOnGpu(this.gpu, this.page, this.corners, name));
  }

  queriesOf(name) {
    return cached(this.queries, name, () => new Queries(this.gpu, this.scene, this.onGpu(name)));
  }

  rendererOf(structure, mode) {
    return cached(this.renderers, `${structure} ${mode}`,
      () => ImageRenderer.make(this.gpu, this.page, this.surfaces, this.onGpu(structure), mode));
  }

  /** Begin the image again: the view, the size or a choice has changed. */
  change() {
    this.changes += 1;
    this.sample = 0;
    this.isStopped = false;
    if (!this.isRunning) this.run();
  }

  get size() {
    const box = this.canvas.parentElement.getBoundingClientRect();
    const ratio = Math.min(devicePixelRatio || 1, Math.sqrt(MOST_PIXELS / (box.width * box.height)));
    return [box.width, box.height].map(side => Math.max(Math.round(side * ratio), 1));
  }

  get camera() {
    const [width, height] = this.size;
    return toShapedCamera({...this.view, aspect: width / height});
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
    const {gpu, display, structure, mode} = this;
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
    if (sample === 0) say("");
    this.losses = 0;
    byId("preview").hidden = true;
    this.canvas.hidden = false;
    const milliseconds = (performance.now() - began).toFixed(0);
    byId("figures").textContent = `${sample + 1} of ${this.scene.samples} samples, `
      + `${milliseconds} ms, ${gpu.name}`;
    if (changes === this.changes) this.sample += 1;
  }

  /** The ray through a place of the image, fractions from its upper left corner. */
  rayThrough(x, y) {
    const {camera, size: [width, height]} = this;
    const [right, up, forward] = basisOf(camera);
    const slope = Math.tan(camera.fov * Math.PI / 360);
    const across = scale(right, (2 * x - 1) * slope * width / height);
    const direction = add(add(forward, across), scale(up, (1 - 2 * y) * slope));
    return [...camera.eye, ...direction];
  }

  /** List the hits of the ray through a place of the image. */
  async pick(x, y) {
    const {structure} = this;
    const number = ++this.picks;
    const ray = this.rayThrough(x, y);
    const hits = await this.queriesOf(structure).allHits(Float64Array.from(ray));
    if (number !== this.picks) return; // another was picked since
    const count = hits.primId.length;
    byId("hits").hidden = false;
    byId("hits-title").textContent = count
      ? `${count} ${count === 1 ? "hit" : "hits"} along the ray, by ${structure}`
      : "No hit along the ray";
    byId("hits-list").replaceChildren(...hits.primId.map((prim, i) => {
      const distance = hits.t[i] * length(ray.slice(3));
      return make("li", "", `triangle ${prim} at ${distance.toPrecision(6)}`);
    }));
  }
}

function say(text) {
  byId("message").textContent = text;
  byId("message").hidden = !text;
}

/** Call a function whenever an image pixel gets another size, as by the browser's zoom. */
function onPixelRatio(call) {
  matchMedia(`(resolution: ${devicePixelRatio}dppx)`).addEventListener("change", () => {
    call();
    onPixelRatio(call);
  }, {once: true});
}

function connect(page) {
  const move = how => {
    page.view = how(page.view);
    page.change();
  };
  const pick = (x, y) => page.pick(x, y).catch(error => say(error.message));
  new Gestures(byId("picture"), {
    orbit: (dx, dy) => move(view => orbit(view, dx, dy)),
    pan: (dx, dy) => move(view => pan(view, dx, dy)),
    look: (dx, dy) => move(view => orbit(view, dx, dy)),
    zoom: (factor, x, y) => move(view => zoom(view, factor, x, y)),
    tap: pick,
    doubleTap: () => move(() => page.home),
    looking: () => false,
  });
  const arrows = {
    ArrowLeft: [-STEP, 0], ArrowRight: [STEP, 0], ArrowUp: [0, -STEP], ArrowDown: [0, STEP],
  };
  const others = {
    "+": () => move(view => zoom(view, 0.9)), "-": () => move(view => zoom(view, 1 / 0.9)),
    h: () => move(() => page.home), Enter: () => pick(0.5, 0.5),
  };
  byId("picture").addEventListener("keydown", event => {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const shift = arrows[event.key];
    if (!shift && !others[event.key]) return;
    event.preventDefault();
    if (shift) move(view => (event.shiftKey ? pan : orbit)(view, ...shift));
    else others[event.key]();
  });
  for (const name of ["mode", "structure"]) {
    const choices = Object.keys(page.scene[`${name}s`]);
    fillSelect(byId(name), choices.map(one => [one, one]));
    byId(name).addEventListener("change", () => {
      page[name] = byId(name).value;
      page.change();
    });
  }
  byId("home").addEventListener("click", () => move(() => page.home));
  byId("hits-close").addEventListener("click", () => {
    byId("hits").hidden = true;
    byId("picture").focus();
  });
  onPixelRatio(() => page.change());
  new ResizeObserver(() => page.change()).observe(byId("stage"));
}

async function start() {
  const page = new Page(await unpack(await dataOf(byId("data"))));
  await page.open();
  connect(page);
  chooseByAddress(page);
  page.change();
  return page;
}

const opened = start();
opened.catch(error => {
  say(error instanceof PageError ? error.message : `This page does not work here: ${error.message}`);
  byId("controls").hidden = true;
});
globalThis.raystream = {opened};

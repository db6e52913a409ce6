// An exported page: shows the scene, sample after sample, traced on this computer's GPU.

import {byId, fillSelect, make} from "./elements.js";
import {Gpu, dispatchSize} from "./device.js";
import {cornersOf} from "./geometry.js";
import {Gestures} from "./gestures.js";
import {ImageRenderer} from "./images.js";
import {PageError, unpack} from "./pack.js";
import {Queries, StructureOnGpu} from "./queries.js";
import {shaderSource} from "./shaders.js";
import {add, length, scale, subtract} from "./vector.js";
import {fromCamera, likelyUp, orbit, pan, toShapedCamera, worldOf, zoom} from "./view.js";
import {basisOf} from "./view_uniform.js";

const GROUP_SIZE = 64;
const MOST_PIXELS = 1 << 20;
const LOST = "The GPU stopped; this page starts it again.";
const STEP = 0.04; // of keys, in image heights

class Page {
  constructor(unpacked) {
    this.page = unpacked;
    this.scene = unpacked.manifest;
    this.corners = cornersOf(unpacked.arrays.vertices, unpacked.arrays.faces);
    this.structures = new Map();
    this.mode = Object.keys(this.scene.modes)[0];
    this.structure = Object.keys(this.scene.structures)[0];
    this.sample = 0;
    this.changes = 0;
    this.isRunning = false;
    const [lower, upper] = this.scene.bounds;
    const up = likelyUp(this.scene.camera.up);
    const world = worldOf(up, length(subtract(upper, lower)));
    this.home = fromCamera(this.scene.camera, world);
    this.view = this.home;
  }

  async open() {
    this.gpu = await Gpu.open();
    this.structures.clear();
    this.renderers = new Map();
    this.queries = new Map();
    this.canvas = byId("picture");
    this.context = this.canvas.getContext("webgpu");
    this.format = navigator.gpu.getPreferredCanvasFormat();
    this.context.configure({device: this.gpu.device, format: this.format});
    this.display = await this.makeDisplay();
    this.gpu.device.lost.then(({reason}) => {
      if (reason !== "destroyed" || this.isTested) this.reopen();
    });
  }

  async reopen() {
    say(LOST);
    try {
      await this.open();
      say("");
      this.change();
    } catch (error) {
      say(error.message);
      byId("preview").hidden = false;
      this.canvas.hidden = true;
    }
  }

  async makeDisplay() {
    const {gpu} = this;
    const kinds = ["uniform", "gather", "scatter"];
    const adding = await gpu.pipeline({
      source: shaderSource(this.scene.shaders, ["page/accumulate.wgsl"]),
      entry: "accumulate", layouts: [kinds], constants: {},
    });
    const module = gpu.device.createShaderModule({
      code: shaderSource(this.scene.shaders, ["page/show.wgsl"]),
    });
    const showing = await gpu.device.createRenderPipelineAsync({
      layout: "auto", vertex: {module, entryPoint: "cover"},
      fragment: {module, entryPoint: "show", targets: [{format: this.format}]},
    });
    return {
      kinds, adding, showing, sums: null,
      sample: gpu.buffer("sample", 16, GPUBufferUsage.UNIFORM),
      picture: gpu.buffer("picture", 16, GPUBufferUsage.UNIFORM),
    };
  }

  onGpu(name) {
    if (!this.structures.has(name)) {
      this.structures.set(name, new StructureOnGpu(this.gpu, this.page, this.corners, name));
    }
    return this.structures.get(name);
  }

  queriesOf(name) {
    if (!this.queries.has(name)) {
      this.queries.set(name, new Queries(this.gpu, this.scene, this.onGpu(name)));
    }
    return this.queries.get(name);
  }

  rendererOf(structure, mode) {
    const key = `${structure} ${mode}`;
    if (!this.renderers.has(key)) {
      this.renderers.set(key,
        ImageRenderer.make(this.gpu, this.page, this.onGpu(structure), this.corners, mode));
    }
    return this.renderers.get(key);
  }

  /** Begin the image again: the view, the size or a choice has changed. */
  change() {
    this.changes += 1;
    this.sample = 0;
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
    try {
      while (this.sample < this.scene.samples) await this.frame();
    } catch (error) {
      if (!(error instanceof PageError)) console.error(error);
      say(error.message);
    }
    this.isRunning = false;
  }

  async frame() {
    const began = performance.now();
    const changes = this.changes;
    const renderer = await this.rendererOf(this.structure, this.mode);
    const size = this.size;
    if (this.sample === 0) renderer.begin(this.camera, size);
    await renderer.trace(this.sample);
    this.show(renderer, this.sample, size);
    await this.gpu.device.queue.onSubmittedWorkDone();
    byId("preview").hidden = true;
    this.canvas.hidden = false;
    const seconds = (performance.now() - began) / 1000;
    this.latest = {sample: this.sample, seconds, size};
    byId("figures").textContent = `${this.sample + 1} of ${this.scene.samples} samples, `
      + `${(1000 * seconds).toFixed(0)} ms, ${this.gpu.name}`;
    if (changes === this.changes) this.sample += 1;
  }

  show(renderer, number, [width, height]) {
    const {gpu, display} = this;
    const count = width * height;
    if (display.sums?.size !== Math.max(16 * count, 64)) {
      display.sums?.destroy();
      display.sums = gpu.buffer("sums of samples", 16 * count);
    }
    const {columns, rows, rowSize} = dispatchSize(count, GROUP_SIZE);
    gpu.write(display.sample, Uint32Array.of(count, rowSize, number, 0));
    const picture = new Uint32Array(4);
    picture.set([width, height]);
    new Float32Array(picture.buffer)[2] = 1;
    gpu.write(display.picture, picture);
    [this.canvas.width, this.canvas.height] = [width, height];
    const encoder = gpu.device.createCommandEncoder();
    const adding = encoder.beginComputePass();
    adding.setPipeline(display.adding);
    adding.setBindGroup(0,
      gpu.bind(display.kinds, [display.sample, renderer.records, display.sums]));
    adding.dispatchWorkgroups(columns, rows);
    adding.end();
    const view = this.context.getCurrentTexture().createView();
    const showing = encoder.beginRenderPass({
      colorAttachments: [{view, loadOp: "clear", storeOp: "store"}],
    });
    showing.setPipeline(display.showing);
    showing.setBindGroup(0, gpu.device.createBindGroup({
      layout: display.showing.getBindGroupLayout(0),
      entries: [
        {binding: 0, resource: {buffer: display.picture}},
        {binding: 1, resource: {buffer: display.sums}},
      ],
    }));
    showing.draw(3);
    showing.end();
    gpu.device.queue.submit([encoder.finish()]);
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

  async pick(x, y) {
    const ray = this.rayThrough(x, y);
    const hits = await this.queriesOf(this.structure).allHits(Float64Array.from(ray));
    const count = hits.primId.length;
    byId("hits-title").textContent = count ? `${count} hits along the ray, by ${this.structure}`
      : "No hit along the ray";
    byId("hits-list").replaceChildren(...hits.primId.map((prim, i) => {
      const distance = hits.t[i] * length(ray.slice(3));
      return make("li", "", `triangle ${prim} at ${distance.toPrecision(6)}`);
    }));
    byId("hits").hidden = false;
    return hits;
  }
}

function say(text) {
  byId("message").textContent = text;
  byId("message").hidden = !text;
}

function connect(page) {
  const move = how => {
    page.view = how(page.view);
    page.change();
  };
  new Gestures(byId("picture"), {
    orbit: (dx, dy) => move(view => orbit(view, dx, dy)),
    pan: (dx, dy) => move(view => pan(view, dx, dy)),
    look: (dx, dy) => move(view => orbit(view, dx, dy)),
    zoom: (factor, x, y) => move(view => zoom(view, factor, x, y)),
    tap: (x, y) => page.pick(x, y).catch(error => say(error.message)),
    doubleTap: () => move(() => page.home),
    looking: () => false,
  });
  const keys = {
    ArrowLeft: view => orbit(view, -STEP, 0), ArrowRight: view => orbit(view, STEP, 0),
    ArrowUp: view => orbit(view, 0, -STEP), ArrowDown: view => orbit(view, 0, STEP),
    "+": view => zoom(view, 0.9), "-": view => zoom(view, 1 / 0.9), h: () => page.home,
  };
  byId("picture").addEventListener("keydown", event => {
    if (!keys[event.key]) return;
    event.preventDefault();
    move(keys[event.key]);
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
  byId("hits-close").addEventListener("click", () => { byId("hits").hidden = true; });
  new ResizeObserver(() => page.change()).observe(byId("stage"));
}

async function start() {
  const page = new Page(await unpack(byId("data").textContent));
  await page.open();
  connect(page);
  page.change();
  return page;
}

const opened = start();
opened.catch(error => {
  say(error instanceof PageError ? error.message : `This page does not work here: ${error.message}`);
  byId("controls").hidden = true;
});
globalThis.raystream = {opened};

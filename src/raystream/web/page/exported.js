// An exported page: shows the scene, sample after sample, traced on this computer's GPU.

import {boxesOf} from "./boxes.js";
import {meanCounts, raysOf, showCounts} from "./counts.js";
import {Display} from "./display.js";
import {byId, fillSelect, make} from "./elements.js";
import {Gpu, cached} from "./device.js";
import {cornersOf} from "./geometry.js";
import {Gestures} from "./gestures.js";
import {HeatmapDisplay, modeChoices, partsOf} from "./heatmaps.js";
import {ImageRenderer} from "./images.js";
import {PageError, unpack} from "./pack.js";
import {PassPanel} from "./pass_panel.js";
import {whyNoPasses} from "./pass_streams.js";
import {MOST_PIXELS_OF_PASSES, PassRenderer} from "./passes.js";
import {Queries, StructureOnGpu} from "./queries.js";
import {SceneOnGpu} from "./scene_on_gpu.js";
import {add, length, scale, subtract} from "./vector.js";
import {fromCamera, likelyUp, orbit, pan, toShapedCamera, worldOf, zoom} from "./view.js";
import {basisOf} from "./view_uniform.js";
import {recordWalk} from "./walk.js";
import {WalkPanel} from "./walk_panel.js";

const MOST_PIXELS = 1 << 20;
const MOST_STEPS = 500; // that are listed
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
    this.machine = "compute";
    this.panel = new PassPanel(this);
    this.canvas = byId("picture");
    this.sample = 0;
    this.changes = 0;
    this.picks = 0;
    this.picked = null; // a ray
    this.boxes = new Map();
    this.walk = new WalkPanel(byId("walk-picture"));
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
    this.begun = null;
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
    byId("legend").hidden = true;
    this.canvas.hidden = true;
  }

  onGpu(name) {
    return cached(this.structures, name,
      () => new StructureOnGpu(this.gpu, this.page, this.corners, name));
  }

  queriesOf(name) {
    return cached(this.queries, name, () => new Queries(this.gpu, this.scene, this.onGpu(name)));
  }

  rendererOf(structure, mode, machine) {
    const renderer = machine === "passes" ? PassRenderer : ImageRenderer;
    return cached(this.renderers, `${structure} ${mode} ${machine}`,
      () => renderer.make(this.gpu, this.page, this.surfaces, this.onGpu(structure), mode));
  }

  heatmaps() {
    return cached(this.renderers, "heat maps",
      () => HeatmapDisplay.make(this.gpu, this.page, this.display));
  }

  /** Begin the image again: the view, the size or a choice has changed. */
  change() {
    this.changes += 1;
    this.sample = 0;
    this.isStopped = false;
    this.walk.draw(this.camera, this.size);
    if (this.isByStep) this.panel.restart();
    else this.goOn();
  }

  goOn() {
    if (!this.isRunning) this.running = this.run();
  }

  /** Whether passes run one by one. */
  get isByStep() {
    return this.machine === "passes" && this.panel.isPaused;
  }

  /** Stop, unless the GPU was lost: then it is opened again. */
  async failed(error) {
    if (!(error instanceof PageError) && await this.gpu.wasLost()) this.change();
    else this.stop(error);
  }

  get size() {
    const box = this.canvas.parentElement.getBoundingClientRect();
    const most = this.machine === "passes" ? MOST_PIXELS_OF_PASSES : MOST_PIXELS;
    const ratio = Math.min(devicePixelRatio || 1, Math.sqrt(most / (box.width * box.height)));
    return [box.width, box.height].map(side => Math.max(Math.round(side * ratio), 1));
  }

  get camera() {
    const [width, height] = this.size;
    return toShapedCamera({...this.view, aspect: width / height});
  }

  async run() {
    this.isRunning = true;
    while (this.sample < this.scene.samples && !this.isStopped && !this.isByStep) {
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

  /** The renderer of the image, which begins it if anything has changed; null if a choice has. */
  async beginImage() {
    const {structure, mode, machine} = this;
    const renderer = await this.rendererOf(structure, partsOf(mode)[0], machine);
    if (structure !== this.structure || mode !== this.mode || machine !== this.machine) return null;
    const {changes, size} = this;
    if (this.sample === 0 && this.begun !== changes) {
      this.display.begin(size);
      renderer.begin(this.camera, size);
      this.begun = changes;
    }
    return renderer;
  }

  /** Add one sample to the image, or begin it. */
  async frame() {
    const began = performance.now();
    const {gpu, display} = this;
    const renderer = await this.beginImage();
    if (!renderer) return;
    const {changes, sample, structure} = this;
    const what = partsOf(this.mode)[1];
    const heatmaps = what && await this.heatmaps();
    const goesOn = counts => {
      this.panel.show(counts);
      return !this.isStopped && !this.isByStep && !(sample && changes !== this.changes);
    };
    for (let first = 0; first < renderer.pixelCount;) {
      const band = await renderer.trace(sample, first, goesOn);
      if (!band) return;
      display.add(band, sample, first);
      first += band.count;
      // A first sample is finished, so that there is an image while the camera moves.
      if (this.isStopped || (sample && changes !== this.changes)) return;
    }
    if (what) await heatmaps.show(this.scene.structures[structure].counts[what]);
    else await display.show();
    if (this.isStopped) return;
    if (sample === 0) say("");
    this.reveal();
    const milliseconds = (performance.now() - began).toFixed(0);
    byId("figures").textContent = `${sample + 1} of ${this.scene.samples} samples, `
      + `${milliseconds} ms, ${[renderer.clock, gpu.name].filter(String).join(", ")}`;
    if (changes === this.changes) this.sample += 1;
  }

  /** Show the canvas instead of the image that was rendered beforehand. */
  reveal() {
    this.losses = 0;
    byId("preview").hidden = true;
    byId("legend").hidden = !partsOf(this.mode)[1];
    this.canvas.hidden = false;
  }

  /** Choose a mode, structure or machine; passes run in some modes, on some structures. */
  choose(name, value) {
    const {modes, structures} = this.scene;
    const before = this.structure;
    const has = one => Boolean(structures[one].passes);
    const isHeatmap = () => partsOf(this.mode).length > 1;
    this[name] = value;
    if (this.machine === "passes" && name === "machine") {
      if (!has(this.structure)) this.structure = Object.keys(structures).find(has);
      if (isHeatmap()) this.mode = Object.keys(modes)[0];
    } else if (isHeatmap() || !has(this.structure)) {
      this.machine = "compute";
    }
    for (const one of ["mode", "structure", "machine"]) byId(one).value = this[one];
    byId("passes").hidden = this.machine !== "passes";
    this.change();
    if (before !== this.structure && this.picked) this.list().catch(error => say(error.message));
  }

  /** The ray through a place of the image, fractions from its upper left corner. */
  rayThrough(x, y, {camera, size: [width, height]} = this) {
    const [right, up, forward] = basisOf(camera);
    const slope = Math.tan(camera.fov * Math.PI / 360);
    const across = scale(right, (2 * x - 1) * slope * width / height);
    const direction = add(add(forward, across), scale(up, (1 - 2 * y) * slope));
    return [...camera.eye, ...direction];
  }

  /** Count the work per ray of all structures in this view. */
  async compare() {
    const {camera, size} = this;
    const rays = raysOf(size, (x, y) => this.rayThrough(x, y, {camera, size}));
    const means = {};
    byId("compare").disabled = true;
    try {
      for (const name of Object.keys(this.scene.structures)) {
        means[name] = await meanCounts(this.queriesOf(name), rays);
      }
    } finally {
      byId("compare").disabled = false;
    }
    showCounts(means, rays.length / 6);
  }

  /** List the hits of the ray through a place of the image, and its steps through the structure. */
  pick(x, y) {
    this.picked = this.rayThrough(x, y);
    return this.list();
  }

  async list() {
    const {structure, picked: ray} = this;
    const number = ++this.picks;
    const hits = await this.queriesOf(structure).allHits(Float64Array.from(ray));
    const walked = await this.walkOf(structure, ray);
    if (number !== this.picks) return; // another was picked since
    this.walk.show(ray, ...walked);
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

  /** The steps of a ray through a structure, and their number. */
  async walkOf(structure, ray) {
    const boxOf = cached(this.boxes, structure,
      () => boxesOf(this.onGpu(structure), this.scene));
    if (!boxOf) return [[], 0];
    const {visits, count} = await recordWalk(this.queriesOf(structure), Float64Array.from(ray));
    const steps = visits.slice(0, MOST_STEPS).map(visit => ({...visit, ...boxOf(visit)}));
    return [steps, count];
  }

  /** Forget the ray that was picked. */
  close() {
    this.picks += 1;
    this.picked = null;
    this.walk.hide();
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
  const choices = {
    mode: modeChoices(page.scene),
    structure: Object.keys(page.scene.structures).map(one => [one, one]),
  };
  for (const name of ["mode", "structure"]) {
    fillSelect(byId(name), choices[name]);
    byId(name).addEventListener("change", () => page.choose(name, byId(name).value));
  }
  const why = whyNoPasses(page.gpu);
  fillSelect(byId("machine"), [["compute", "compute"], ["passes", "passes"]]);
  byId("machine").options[1].disabled = Boolean(why);
  byId("machine").title = why ?? "";
  byId("machine").parentElement.hidden = Object.values(page.scene.structures).every(
    ({passes}) => !passes);
  byId("machine").addEventListener("change", () => page.choose("machine", byId("machine").value));
  byId("home").addEventListener("click", () => move(() => page.home));
  byId("compare").addEventListener("click",
    () => page.compare().catch(error => say(error.message)));
  for (const name of ["hits", "counts"]) {
    byId(`${name}-close`).addEventListener("click", () => {
      byId(name).hidden = true;
      if (name === "hits") page.close();
      byId("picture").focus();
    });
  }
  onPixelRatio(() => page.change());
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

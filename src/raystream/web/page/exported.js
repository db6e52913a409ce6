// An exported page: shows the scene, sample after sample, traced on this computer's GPU.

import {chooseByAddress} from "./address.js";
import {boxesOf} from "./boxes.js";
import {meanCounts, raysOf, showCounts} from "./counts.js";
import {byId, fillSelect, make} from "./elements.js";
import {cached} from "./device.js";
import {Gestures} from "./gestures.js";
import {HeatmapDisplay, modeChoices, partsOf} from "./heatmaps.js";
import {PageError, unpack} from "./pack.js";
import {dataOf} from "./page_data.js";
import {PassPanel} from "./pass_panel.js";
import {whyNoPasses} from "./pass_streams.js";
import {MOST_PIXELS_OF_PASSES, PassRenderer} from "./passes.js";
import {Queries} from "./queries.js";
import {LOST, TracedImage} from "./traced_image.js";
import {add, length, scale, subtract} from "./vector.js";
import {fromCamera, likelyUp, orbit, pan, toShapedCamera, worldOf, zoom} from "./view.js";
import {basisOf} from "./view_uniform.js";
import {recordWalk} from "./walk.js";
import {WalkPanel} from "./walk_panel.js";

const MOST_PIXELS = 1 << 20;
const MOST_STEPS = 500; // that are listed
const STEP = 0.04; // of keys, in image heights

class Page extends TracedImage {
  constructor(unpacked) {
    super(unpacked, byId("picture"));
    this.machines = {...this.machines, passes: PassRenderer};
    this.panel = new PassPanel(this);
    this.picks = 0;
    this.picked = null; // a ray
    this.boxes = new Map();
    this.walk = new WalkPanel(byId("walk-picture"));
    const [lower, upper] = this.scene.bounds;
    const up = likelyUp(this.scene.camera.up);
    const world = worldOf(up, length(subtract(upper, lower)));
    this.home = fromCamera(this.scene.camera, world);
    this.view = this.home;
  }

  async open() {
    await super.open();
    this.queries = new Map();
  }

  say(text) {
    say(text);
  }

  /** Show the image that was rendered beforehand. */
  hide() {
    byId("preview").hidden = false;
    byId("legend").hidden = true;
    this.showCanvas(false);
  }

  queriesOf(name) {
    return cached(this.queries, name, () => new Queries(this.gpu, this.scene, this.onGpu(name)));
  }

  rendererOf(structure, mode, machine) {
    return super.rendererOf(structure, partsOf(mode)[0], machine);
  }

  heatmaps() {
    return cached(this.renderers, "heat maps",
      () => HeatmapDisplay.make(this.gpu, this.page, this.display));
  }

  change() {
    super.change();
    this.walk.draw(this.camera, this.size);
    if (this.isByStep) this.panel.restart();
  }

  /** Whether passes run one by one. */
  get isByStep() {
    return this.machine === "passes" && this.panel.isPaused;
  }

  /**
   * Stop, unless something has been changed since the number of `changes`, or the GPU was lost: then
   * it is opened again.
   */
  async failed(error, changes) {
    const wasLost = !(error instanceof PageError) && await this.gpu.wasLost();
    if (changes !== this.changes) return;
    if (wasLost) this.change();
    else this.stop(error);
  }

  /** Do something beside the image; if it fails, say why, or repeat it once on another GPU. */
  async attempt(work, isRepeated = false) {
    const {gpu} = this;
    try {
      await work();
      if (!this.isStopped) this.say("");
    } catch (error) {
      if (error instanceof PageError) {
        this.say(error.message);
        return;
      }
      if (await gpu.wasLost()) {
        if (gpu !== this.gpu && !isRepeated) return this.attempt(work, true);
        if (!this.isStopped) this.say(LOST); // until its image is there again
        return;
      }
      console.error(error);
      this.say(error.message);
    }
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

  /** Images by compute need no streams of passes; the last step may still use them. */
  begins() {
    const {surfaces, machine, panel} = this;
    const {streams} = surfaces;
    if (machine === "passes" || !streams) return;
    surfaces.streams = null;
    panel.work.then(() => streams.destroy());
  }

  counted(counts) {
    this.panel.show(counts);
  }

  async show(structure, mode) {
    const what = partsOf(mode)[1];
    if (!what) return super.show();
    return (await this.heatmaps()).show(this.scene.structures[structure].counts[what]);
  }

  shown(sample, milliseconds, {clock}) {
    this.reveal();
    byId("figures").textContent = `${sample + 1} of ${this.scene.samples} samples, `
      + `${milliseconds.toFixed(0)} ms, ${[clock, this.gpu.name].filter(String).join(", ")}`;
  }

  /** Show the canvas instead of the image that was rendered beforehand. */
  reveal() {
    this.losses = 0;
    byId("preview").hidden = true;
    byId("legend").hidden = !partsOf(this.mode)[1];
    this.showCanvas(true);
  }

  /** With the boxes of the steps over it, which are those of its view. */
  showCanvas(isShown) {
    this.canvas.hidden = this.walk.canvas.hidden = !isShown;
  }

  /** Choose a mode, structure or machine; passes run in some modes, on some structures. */
  choose(name, value) {
    const {modes, structures} = this.scene;
    const before = this.structure;
    const has = one => Boolean(structures[one].passes);
    if (name === "machine" && value === "passes" && !Object.keys(structures).some(has)) return;
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
    if (before !== this.structure && this.picked) this.attempt(() => this.list());
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
        showCounts(means, rays.length / 6);
      }
    } finally {
      byId("compare").disabled = false;
    }
  }

  /** List the hits of the ray through a place of the image, and its steps through the structure. */
  pick(x, y) {
    this.picked = this.rayThrough(x, y);
    return this.attempt(() => this.list());
  }

  async list() {
    const {structure, picked: ray} = this;
    if (!ray) return; // it was forgotten since
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
  forget() {
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
  const pick = (x, y) => page.pick(x, y);
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
  const hasPasses = Object.values(page.scene.structures).some(({passes}) => passes);
  fillSelect(byId("machine"), [["compute", "compute"], ["passes", "passes"]]);
  byId("machine").options[1].disabled = Boolean(why) || !hasPasses;
  byId("machine").title = why ?? "";
  byId("machine").parentElement.hidden = !hasPasses;
  byId("machine").addEventListener("change", () => page.choose("machine", byId("machine").value));
  byId("home").addEventListener("click", () => move(() => page.home));
  byId("compare").addEventListener("click", () => page.attempt(() => page.compare()));
  for (const name of ["hits", "counts"]) {
    byId(`${name}-close`).addEventListener("click", () => {
      byId(name).hidden = true;
      if (name === "hits") page.forget();
      byId("picture").focus();
    });
  }
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
  const why = error instanceof PageError ? error.message
    : `This page does not work here: ${error.message}`;
  say(`${why} The image shown is pre-rendered.`);
  byId("controls").hidden = true;
});
globalThis.raystream = {opened};

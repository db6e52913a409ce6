// An exported page: shows the scene, sample after sample, traced on this computer's GPU.

import {byId, fillSelect, make} from "./elements.js";
import {cached} from "./device.js";
import {Gestures} from "./gestures.js";
import {PageError, unpack} from "./pack.js";
import {Queries} from "./queries.js";
import {TracedImage} from "./traced_image.js";
import {add, length, scale, subtract} from "./vector.js";
import {fromCamera, likelyUp, orbit, pan, toShapedCamera, worldOf, zoom} from "./view.js";
import {basisOf} from "./view_uniform.js";

const MOST_PIXELS = 1 << 20;
const STEP = 0.04; // of keys, in image heights

class Page extends TracedImage {
  constructor(unpacked) {
    super(unpacked, byId("picture"));
    this.picks = 0;
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
    this.canvas.hidden = true;
  }

  queriesOf(name) {
    return cached(this.queries, name, () => new Queries(this.gpu, this.scene, this.onGpu(name)));
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

  shown(sample, milliseconds) {
    byId("preview").hidden = true;
    this.canvas.hidden = false;
    byId("figures").textContent = `${sample + 1} of ${this.scene.samples} samples, `
      + `${milliseconds.toFixed(0)} ms, ${this.gpu.name}`;
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
  const page = new Page(await unpack(byId("data").textContent));
  await page.open();
  connect(page);
  page.change();
  return page;
}

const opened = start();
opened.catch(error => {
  const why = error instanceof PageError ? error.message
    : `This page does not work here: ${error.message}`;
  say(`${why} The image was rendered beforehand.`);
  byId("controls").hidden = true;
});
globalThis.raystream = {opened};

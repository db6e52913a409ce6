// The papers' machine in the page: its counts, steps of one pass, and rays' states as an image.

import {byId, make} from "./elements.js";
import {shaderSource} from "./shaders.js";

/** Colors of the states, by number, encoded as sRGB; distinct for the color blind (Okabe and Ito). */
export const STATE_COLORS = [
  "#000000", "#999999", "#0072b2", "#e69f00", "#009e73", "#f0e442", "#cc79a7", "#d55e00", "#ffffff",
];
const STATE_COUNT = 16;

/** Shows the states of rays on the canvas of a display. */
class StatesImage {
  constructor(gpu, shaders, display) {
    this.gpu = gpu;
    this.display = display;
    const module = gpu.module(shaderSource(shaders, ["page/states.wgsl"]));
    this.pipeline = gpu.device.createRenderPipeline({
      layout: "auto", vertex: {module, entryPoint: "cover"},
      fragment: {module, entryPoint: "show_states", targets: [{format: display.format}]},
    });
    const colors = new Float32Array(4 * STATE_COUNT);
    STATE_COLORS.forEach((color, state) => {
      const bits = parseInt(color.slice(1), 16);
      colors.set([bits >> 16, bits >> 8 & 255, bits & 255].map(one => one / 255), 4 * state);
      colors[4 * state + 3] = 1;
    });
    this.colors = gpu.buffer("colors of states", colors, GPUBufferUsage.UNIFORM);
  }

  show(streams) {
    const {gpu, display, pipeline} = this;
    const resources = [[0, {buffer: display.picture}], [2, streams.states],
      [3, streams.streams.light.createView()], [4, {buffer: this.colors}]];
    return display.present(pipeline, resources);
  }
}

export class PassPanel {
  constructor(page) {
    this.page = page;
    this.isPaused = false;
    this.work = Promise.resolve();
    this.isStarting = false;
    byId("step").addEventListener("click", () => this.press());
    byId("run").addEventListener("click", () => this.resume());
  }

  /** Run the next pass; at first, and after a stop, begin the image again. */
  press() {
    byId("run").disabled = false;
    if (this.isPaused && !this.page.isStopped) {
      this.do(() => this.step());
    } else {
      this.isPaused = true;
      this.page.change();
    }
  }

  /** Do one thing after another. */
  do(one) {
    let changes = null;
    this.work = this.work.then(() => this.page.running).then(() => {
      ({changes} = this.page);
      return one();
    }).catch(error => this.page.failed(error, changes));
  }

  /** Trace on; after a stop, from the beginning. */
  resume() {
    const {page} = this;
    this.isPaused = false;
    byId("run").disabled = true;
    this.work = this.work.then(() => (page.isStopped ? page.change() : page.goOn()));
  }

  /** Begin the image again, while it is traced pass by pass: the view or a choice has changed. */
  restart() {
    if (this.isStarting) return;
    this.isStarting = true;
    this.do(() => {
      this.isStarting = false;
      return this.step();
    });
  }

  /** Run one pass, and show the state of each ray. */
  async step() {
    const {page} = this;
    if (page.isStopped) return;
    if (page.gpu.isLost) await page.reopen();
    if (page.sample >= page.scene.samples) return;
    const {changes} = page;
    const isOutdated = () => changes !== page.changes || !page.isByStep;
    const renderer = await page.beginImage();
    if (isOutdated()) return;
    const band = await renderer.step(page.sample);
    if (isOutdated()) return;
    if (band) {
      page.display.add(band, page.sample, 0);
      page.sample += 1;
      await page.display.show();
    } else {
      await this.imageOf(page).show(renderer.streams);
    }
    page.say("");
    page.reveal();
    this.show(renderer);
    byId("figures").textContent = `Pass by pass, ${page.gpu.name}`;
  }

  imageOf({gpu, display, scene}) {
    if (this.image?.display !== display) {
      this.image = new StatesImage(gpu, scene.shaders, display);
    }
    return this.image;
  }

  /** Show the counts of a renderer. */
  show({kernels, passes, waiting, last, pixelCount, activeCount, states}) {
    byId("passes-last").textContent = last ? `Last pass: ${last.kernel}, on `
      + `${last.rays.toLocaleString()} of ${pixelCount.toLocaleString()} pixels` : "";
    const rows = [["eye rays", null, null], ...kernels.map(
      ({name, state}) => [name, state, waiting[state]])];
    const done = last ? pixelCount - activeCount : 0;
    const cells = [
      ...rows.map(([name, state, count]) => (
        [name, state, passes.get(name), count, last?.kernel === name])),
      ["done", states.done, null, done, false],
    ];
    byId("passes-rows").replaceChildren(...cells.map(([name, state, count, rays, isLast]) => {
      const dot = make("span", "dot");
      if (state === null || state === states.done) dot.classList.add("none");
      else dot.style.background = STATE_COLORS[state];
      const head = make("th", "", [dot, name]);
      head.scope = "row";
      const figures = [count, rays].map(one => make("td", "", one === null ? "" : one.toLocaleString()));
      return make("tr", isLast ? "last" : "", [head, ...figures]);
    }));
  }
}

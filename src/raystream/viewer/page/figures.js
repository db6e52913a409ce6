// Figures: measurements of the server and the page, and statistics of the structure.

import {byId, fillFigures} from "./elements.js";
import {bytes, capital, count, many, milliseconds, number, seconds, words} from "./format.js";

const PERIOD = 160; // ms between refreshes, so that figures stay readable
const WINDOW = 1000; // ms over which frames are counted

export class Figures {
  constructor() {
    this.times = [];
    this.header = null;
    this.rate = null; // measured by the page; the server reports that of its last moving frames
    this.serverRate = null;
    this.timer = null;
    this.built = null;
    this.titles = {}; // of heat maps, by name
  }

  /** Record a frame that was drawn or skipped. */
  drew(header, isDrawn) {
    if (isDrawn && header.moving) this.count();
    if (!header.moving) this.times = [];
    this.header = header;
    if (this.timer === null) this.timer = setTimeout(() => this.show(), PERIOD);
  }

  /** Count a frame of a moving camera. */
  count() {
    const now = performance.now();
    this.times.push(now);
    while (now - this.times[0] > WINDOW) this.times.shift();
    if (this.times.length < 3) return;
    this.rate = (this.times.length - 1) / (now - this.times[0]) * 1000;
  }

  show() {
    this.timer = null;
    const header = this.header;
    if (!header) return;
    const say = (name, text) => {
      const element = document.querySelector(`[data-figure="${name}"]`);
      element.hidden = text === "";
      if (element.textContent !== text) element.textContent = text;
    };
    const samples = header.target_samples > 1 && !header.moving
      ? `${count(header.samples)} / ${count(header.target_samples)} samples` : "";
    if (header.moving && header.fps > 0) this.serverRate = header.fps;
    say("fps", this.serverRate ? `${this.serverRate.toFixed(1)} fps` : "");
    say("progress", samples);
    const speed = header.mrays_per_second;
    say("rays", Number.isFinite(speed) ? `${many(speed * 1e6)} rays/s` : "");
    fillFigures(byId("figures"), this.rows(header));
    const counters = Object.entries(header.counters || {});
    const rows = counters.length
      ? counters.map(([name, mean]) => [words(name), number(mean)])
      : [["With a heat map", "–"]];
    fillFigures(byId("counters"), rows);
    this.showLegend(header.legend);
  }

  rows(header) {
    const rate = n => (n ? n.toFixed(1) : "–");
    const canvas = byId("picture");
    const rows = [
      ["Frames per second", this.serverRate ? `${rate(this.serverRate)} · page ${rate(this.rate)}` : "–", "Measured by the server, and by the page while the camera moves"],
      ["Render", milliseconds(header.render_ms)],
      ["Encode", milliseconds(header.encode_ms)],
      ["Rays", Number.isFinite(header.rays) ? many(header.rays) : "–"],
      ["Rays per second", Number.isFinite(header.mrays_per_second) ? many(header.mrays_per_second * 1e6) : "–"],
      ["Samples", `${count(header.samples)} of ${count(header.target_samples)}${header.done ? ", done" : ""}`],
      ["Noise", Number.isFinite(header.noise) ? `${number(100 * header.noise)} %` : "–", "Estimated relative error of the image"],
      ["Pixels", header.width === canvas.width ? `${header.width} × ${header.height}` : `${header.width} × ${header.height} of ${canvas.width} × ${canvas.height}`],
    ];
    if (this.built) rows.push(["Build", seconds(this.built.seconds)], ["Memory", bytes(this.built.bytes)]);
    return rows;
  }

  /** Show the statistics of a structure. */
  showStructure(message) {
    this.built = message;
    const rows = Object.entries(message.statistics || {})
      .map(([name, value]) => [words(name), typeof value === "number" ? number(value) : String(value)]);
    fillFigures(byId("statistics"), rows);
    this.show();
  }

  showScene(scene) {
    byId("scene-name").textContent = scene.name;
    byId("scene-name").title = scene.name;
    const some = (n, one, more) => `${count(n)} ${n === 1 ? one : more}`;
    const parts = [
      some(scene.triangles, "triangle", "triangles"), some(scene.meshes, "mesh", "meshes"),
    ];
    if (scene.lights) parts.push(some(scene.lights, "light", "lights"));
    byId("scene-size").textContent = parts.join(" · ");
    byId("scene-size").title =
      `${some(scene.vertices, "vertex", "vertices")}, ${some(scene.materials, "material", "materials")}`;
    document.title = `${scene.name} – raystream`;
  }

  showLegend(legend) {
    const figure = byId("legend");
    figure.hidden = !legend;
    if (!legend) return;
    const title = capital(this.titles[legend.what] || words(legend.what));
    const caption = figure.querySelector("figcaption");
    if (caption.textContent !== title) caption.textContent = title;
    byId("legend-middle").textContent = number(legend.maximum / 2);
    byId("legend-top").textContent = number(legend.maximum);
  }
}

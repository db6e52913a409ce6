// The settings form: shows the effective settings, and sends the user's changes.

import {fillSelect} from "./elements.js";
import {capital, number, words} from "./format.js";

const NUMBERS = ["samples", "max_bounces", "maximum"];
const AUTOMATIC = "";

const STRUCTURE_NAMES = {
  bvh: "BVH", kdtree: "k-d tree", graph: "Graph", grid: "Grid", brute: "Brute force",
};
const DEVICE_NAMES = {cpu: "CPU", cuda: "CUDA", graphics: "Graphics"};

export class Settings {
  /** `changed(settings)` is called with the user's changes, by name. */
  constructor(form, changed) {
    this.form = form;
    this.changed = changed;
    this.hello = null;
    this.current = {};
    this.chosen = {};
    this.typed = new Set(); // fields being edited
    form.addEventListener("submit", event => event.preventDefault());
    form.addEventListener("input", event => this.typed.add(event.target.name));
    form.addEventListener("focusout", event => this.typed.delete(event.target.name));
    form.addEventListener("change", event => {
      this.typed.delete(event.target.name);
      this.change(event.target);
    });
    this.field("exposure").addEventListener("input", event => this.change(event.target));
  }

  field(name) {
    return this.form.elements.namedItem(name);
  }

  /** Fill the menus. */
  offer(hello) {
    this.hello = hello;
    const names = (list, say = name => name) =>
      list.map(one => one.name ?? one).map(name => [name, say(name)]);
    fillSelect(this.field("mode"), names(hello.modes));
    fillSelect(this.field("structure"), names(hello.structures, name => STRUCTURE_NAMES[name] || name));
    fillSelect(this.field("tone"), names(hello.tones, capital));
    const maps = Object.keys(hello.heatmaps).map(name => [name, capital(name)]);
    fillSelect(this.field("heatmap"), [[AUTOMATIC, "Off"], ...maps]);
    for (const option of this.field("heatmap").options) {
      option.title = hello.heatmaps[option.value] || "";
    }
    this.offerDevices(hello.devices);
    this.field("samples").max = hello.limits.samples;
  }

  /** Fill the device menu; availability is known a moment after the rest. */
  offerDevices(devices) {
    const field = this.field("device");
    const {value} = field;
    this.hello.devices = devices;
    fillSelect(field, devices.map(({name}) => [name, DEVICE_NAMES[name] || name]));
    for (const {name, available, reason} of devices) {
      const option = [...field.options].find(one => one.value === name);
      option.disabled = available === false;
      option.title = reason || "";
      if (available === false) option.textContent += " (unavailable)";
    }
    const reasons = devices.filter(one => one.available === false && one.reason);
    field.title = reasons.map(one => `${one.name}: ${one.reason}`).join("\n");
    if (value) field.value = value;
  }

  /** Show the effective settings. */
  show(settings) {
    this.current = settings;
    const possible = settings.possible || {};
    for (const name of ["traversal", "machine", "scheduler"]) {
      const select = this.field(name);
      const choices = possible[name] || this.known(name);
      fillSelect(select, choices.map(one => [one, words(one)]));
      this.offerField(name, choices.length > (name === "machine" ? 0 : 1));
    }
    for (const name of ["mode", "structure", "traversal", "machine", "scheduler", "device", "tone", "heatmap"]) {
      this.field(name).value = settings[name] ?? AUTOMATIC;
    }
    for (const name of NUMBERS) {
      const field = this.field(name);
      if (!this.typed.has(name)) field.value = settings[name] ?? this.chosen[name] ?? "";
    }
    const exposure = this.field("exposure");
    if (exposure !== document.activeElement) exposure.value = Math.log2(settings.exposure || 1);
    this.sayExposure(settings.exposure || 1);
    const mode = this.hello.modes.find(one => one.name === settings.mode);
    this.form.querySelector("#mode-says").textContent = mode ? mode.description : "";
    const hot = typeof settings.heatmap === "string";
    this.offerField("maximum", hot);
    this.offerField("max_bounces", possible.max_bounces ?? true);
    for (const name of ["samples", "tone", "exposure"]) {
      this.field(name).disabled = hot;
      this.field(name).title = hot ? "Not available with a heat map" : "";
    }
  }

  /** Hide fields that do not apply to the other settings. */
  offerField(name, meaningful) {
    const field = this.field(name);
    field.disabled = !meaningful;
    field.closest("label").hidden = !meaningful;
  }

  known(name) {
    if (name === "scheduler") return this.hello.schedulers;
    if (name === "machine") return this.hello.machines;
    const structure = this.hello.structures.find(one => one.name === this.current.structure);
    return structure ? structure.traversals : [];
  }

  change(field) {
    const name = field.name;
    let value = field.value;
    if (name === "exposure") {
      value = 2 ** Number(field.value);
      this.sayExposure(value);
    } else if (NUMBERS.includes(name)) {
      if (!field.reportValidity()) return;
      value = field.value === "" ? null : Number(field.value);
    } else if (value === AUTOMATIC) {
      value = null;
    }
    this.choose({[name]: value});
  }

  /** Request settings, and remember them as the user's choice. */
  choose(settings) {
    // Dependent settings are reset.
    if ("structure" in settings) delete this.chosen.traversal;
    if ("device" in settings) delete this.chosen.machine;
    if ("device" in settings || "machine" in settings) delete this.chosen.scheduler;
    Object.assign(this.chosen, settings);
    this.changed(settings);
  }

  /** Request the settings remembered in a URL or from a lost connection, as far as they exist. */
  restore(settings) {
    const kept = {};
    for (const [name, value] of Object.entries(settings)) {
      const {modes, structures, devices, tones, heatmaps} = this.hello;
      const known = {
        mode: modes.map(one => one.name), structure: structures.map(one => one.name), tone: tones,
        device: devices.filter(one => one.available !== false).map(one => one.name),
        heatmap: [null, ...Object.keys(heatmaps)],
      }[name];
      if (!known || known.includes(value)) kept[name] = value;
    }
    if (Object.keys(kept).length) this.choose(kept);
  }

  /** Drop choices that the server has rejected. */
  refuse(settings) {
    for (const name of Object.keys(this.chosen)) {
      if (settings[name] === undefined) continue;
      if (settings[name] !== this.chosen[name] && this.chosen[name] !== null) delete this.chosen[name];
    }
  }

  sayExposure(factor) {
    this.form.querySelector("#exposure-says").textContent = `× ${number(factor)}`;
  }
}

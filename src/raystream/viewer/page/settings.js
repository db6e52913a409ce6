// The settings form: shows the effective settings, and sends the user's changes.

import {fillSelect} from "./elements.js";
import {capital, number, words} from "./format.js";

const NUMBERS = ["samples", "max_bounces", "maximum"];
const AUTOMATIC = "";

const STRUCTURE_NAMES = {
  bvh: "BVH", kdtree: "k-d tree", graph: "Graph", grid: "Grid", brute: "Brute force",
};
const DEVICE_NAMES = {cpu: "CPU", cuda: "CUDA", graphics: "Graphics"};
const BROWSER = "browser"; // a device of the page, which the server does not know

export class Settings {
  /** `changed(settings)` is called with the user's changes for the server, by name. */
  constructor(form, changed) {
    this.form = form;
    this.changed = changed;
    this.hello = null;
    this.current = {};
    this.chosen = {};
    this.isByBrowser = false; // traced by this browser, not by the server's device
    this.browserReason = null; // why it cannot be, for what is chosen
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
    this.hello.devices = devices;
    const named = devices.map(one => ({...one, text: DEVICE_NAMES[one.name] || one.name}));
    const reason = this.browserReason;
    named.push({name: BROWSER, text: "This browser", available: !reason, reason});
    const isMissing = one => one.available === false;
    const field = this.field("device");
    fillSelect(field, named.map(one =>
      [one.name, isMissing(one) ? `${one.text} (unavailable)` : one.text]));
    named.forEach((one, index) => {
      const option = field.options[index];
      // The browser may be chosen for what it will be able to trace.
      option.disabled = isMissing(one) && one.name !== BROWSER;
      option.title = one.reason || "";
    });
    const reasons = named.filter(one => isMissing(one) && one.reason);
    field.title = reasons.map(one => `${one.text}: ${one.reason}`).join("\n");
    this.showDevice();
  }

  /** Show why this browser cannot trace what is chosen, or null, and a note on it. */
  offerBrowser(reason, note) {
    const says = this.form.querySelector("#device-says");
    if (says.textContent !== note) says.textContent = note;
    if (reason === this.browserReason || !this.hello) return;
    this.browserReason = reason;
    this.offerDevices(this.hello.devices);
  }

  showDevice() {
    const device = this.isByBrowser ? BROWSER : this.current.device;
    if (device) this.field("device").value = device;
  }

  /** Show the effective settings. */
  show(settings) {
    this.current = settings;
    const possible = settings.possible || {};
    for (const name of ["traversal", "machine", "scheduler"]) {
      const select = this.field(name);
      const choices = possible[name] || this.known(name);
      fillSelect(select, choices.map(one => [one, words(one)]));
      const isServer = name === "traversal" || !this.isByBrowser;
      this.offerField(name, isServer && choices.length > (name === "machine" ? 0 : 1));
    }
    for (const name of ["mode", "structure", "traversal", "machine", "scheduler", "tone", "heatmap"]) {
      this.field(name).value = settings[name] ?? AUTOMATIC;
    }
    this.showDevice();
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

  /** What the user has chosen, to be restored. */
  get said() {
    return this.isByBrowser ? {...this.chosen, device: BROWSER} : {...this.chosen};
  }

  /** Request settings, and remember them as the user's choice. */
  choose(settings) {
    const {device, ...others} = settings;
    const wasByBrowser = this.isByBrowser;
    if (device !== undefined) this.isByBrowser = device === BROWSER;
    if (this.isByBrowser) settings = others;
    // Dependent settings are reset.
    if ("structure" in settings) delete this.chosen.traversal;
    if ("device" in settings) delete this.chosen.machine;
    if ("device" in settings || "machine" in settings) delete this.chosen.scheduler;
    Object.assign(this.chosen, settings);
    this.changed(settings);
    if (this.isByBrowser !== wasByBrowser && this.current.mode) this.show(this.current);
  }

  /** Request the settings remembered in a URL or from a lost connection, as far as they exist. */
  restore(settings) {
    const kept = {};
    for (const [name, value] of Object.entries(settings)) {
      const {modes, structures, devices, tones, heatmaps} = this.hello;
      const known = {
        mode: modes.map(one => one.name), structure: structures.map(one => one.name), tone: tones,
        device: [BROWSER, ...devices.filter(one => one.available !== false).map(one => one.name)],
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

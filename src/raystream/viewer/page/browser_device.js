// The device "this browser": traces the image on this computer's GPU, where it can; the server renders
// whatever it cannot, and until its first image.

import {capital, words} from "./format.js";
import {missingWebGpu} from "./webgpu.js";

export class BrowserDevice {
  /**
   * Handlers: load() gets the packed scene; seen() is the view and the size to trace; offer(reason,
   * note) is why it cannot trace now, or null, and what to say of it while it is chosen; showing(is)
   * whether its image is on the canvas; drawn(header, view) after a sample; loading(is); tell(text)
   * of the GPU; failed(text).
   */
  constructor(canvas, handlers) {
    this.canvas = canvas;
    this.handlers = handlers;
    this.isChosen = false;
    this.isShowing = false;
    this.settings = null; // in effect
    this.structure = null; // the server's message of the structure, which it has built
    this.scene = 0; // number of the scene
    this.image = null;
    this.loaded = ""; // what was asked for last
    this.failure = null;
  }

  /** The user chooses this device, or another. */
  choose(isChosen) {
    this.isChosen = isChosen;
    this.retry();
    if (!isChosen) this.drop();
    this.update();
  }

  /** Another scene is shown, or the same by another connection. */
  takeScene() {
    this.scene += 1;
    this.structure = null;
    this.retry();
    this.drop();
    this.update();
  }

  takeStructure(message) {
    this.structure = message;
    this.retry();
    this.update();
  }

  takeSettings(settings) {
    const before = this.settings;
    this.settings = settings;
    const isOther = name => before?.[name] !== settings[name];
    if (isOther("mode") || isOther("structure")) this.retry();
    this.update();
  }

  /** Why it cannot trace what is chosen; null if it can, or this is not known yet. */
  get reason() {
    const {failure, settings, structure} = this;
    const reason = missingWebGpu() ?? failure ?? structure?.browser.reason;
    if (reason || !structure || !settings) return reason ?? null;
    const {view} = this.handlers.seen();
    if (typeof settings.heatmap === "string") return "Browsers cannot trace heat maps.";
    if (!structure.browser.modes.includes(settings.mode)) {
      return `Browsers cannot trace mode ${settings.mode}.`;
    }
    if (settings.tone !== "linear") return `Browsers cannot show tone curve ${settings.tone}.`;
    if (view && view.projection !== "perspective") {
      return `${capital(words(view.projection))} views cannot be traced by browsers.`;
    }
    return null;
  }

  /** Whether the server has built the structure of the settings in effect. */
  get isReady() {
    const {settings, structure} = this;
    return Boolean(settings && structure && this.handlers.seen().view)
      && ["structure", "traversal"].every(name => settings[name] === structure[name]);
  }

  /** Trace what is chosen, as it is seen now. */
  update() {
    const {reason} = this;
    if (this.isChosen) this.trace(reason);
    this.handlers.offer(reason, this.isChosen ? this.note(reason) : "");
  }

  trace(reason) {
    if (reason || !this.isReady) {
      this.show(false);
      this.image?.halt();
    } else if (this.image?.fits(this.settings)) {
      const {view, size} = this.handlers.seen();
      this.image.follow(this.settings, view, size);
    } else {
      this.load();
    }
  }

  note(reason) {
    if (reason) return `${reason} The server renders.`;
    return this.isShowing ? `Traced by ${this.image.gpu.name}.` : "";
  }

  /** Load the scene, which takes a while; the server renders. */
  async load() {
    const {structure, traversal, mode, max_bounces: bounces} = this.settings;
    const wanted = JSON.stringify([this.scene, structure, traversal, mode, bounces]);
    if (wanted === this.loaded) return;
    this.drop();
    this.loaded = wanted;
    this.handlers.loading(true);
    const isWanted = () => this.loaded === wanted;
    try {
      const [{BrowserImage}, bytes] = await Promise.all([
        import("./browser_image.js"), this.handlers.load(),
      ]);
      if (!isWanted()) return;
      const image = await BrowserImage.make(bytes, this.canvas, {
        say: text => this.handlers.tell(text),
        stopped: text => this.fail(text),
        drawn: (header, view) => this.draw(header, view),
      });
      if (!isWanted()) {
        image.close();
        return;
      }
      this.image = image;
      this.handlers.loading(false);
      this.update();
    } catch (error) {
      if (isWanted()) this.fail(error.message);
    }
  }

  /** Give up the scene and the GPU. */
  drop() {
    this.show(false);
    this.handlers.loading(false);
    this.image?.close();
    this.image = null;
    this.loaded = "";
  }

  /** Forget a failure: another choice may work. */
  retry() {
    if (!this.failure) return;
    this.failure = null;
    this.drop();
  }

  fail(text) {
    this.failure = text;
    this.handlers.loading(false);
    this.handlers.failed(`${text} The server renders.`);
    this.update();
  }

  draw(header, view) {
    if (!this.image || this.failure) return;
    this.show(true);
    this.handlers.drawn(header, view);
  }

  show(isShowing) {
    if (isShowing === this.isShowing) return;
    this.isShowing = isShowing;
    this.canvas.hidden = !isShowing;
    this.handlers.showing(isShowing);
    if (isShowing) this.handlers.offer(null, this.note(null));
  }
}

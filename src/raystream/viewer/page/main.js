// Main: assembles the page, and communicates with the server.

import * as urlState from "./url_state.js";
import {BrowserDevice} from "./browser_device.js";
import {Connection} from "./connection.js";
import {byId} from "./elements.js";
import {Figures} from "./figures.js";
import {Gestures} from "./gestures.js";
import {HitsPanel} from "./hits.js";
import {Keys} from "./keys.js";
import {Models} from "./models.js";
import {loadScene} from "./scene_request.js";
import {Panels} from "./panels.js";
import {Picking} from "./picking.js";
import {FrameCanvas} from "./frame_canvas.js";
import {CameraController} from "./camera_controller.js";
import {Settings} from "./settings.js";
import {Toasts} from "./toasts.js";
import {look, lookAt, orbit, pan, toCamera, zoom} from "./view.js";
import {Views} from "./views.js";
import {ProgressBar} from "./progress.js";

const WRITE_DELAY = 250; // ms
const KEPT_VIEWS = 64;

const toasts = new Toasts(byId("toasts"));
const panels = new Panels();
const figures = new Figures();
const seen = new Map(); // views by camera number
let wanted = urlState.read(location.hash); // state to restore with the next scene
let line = null;
let served = null; // header of the server's last frame
let isWelcome = false; // hello has been received
let screenshots = 0;
let writing = null;

const send = message => line !== null && isWelcome && line.send(message);

const controller = new CameraController({
  send(message) {
    seen.set(message.number, controller.view);
    if (seen.size > KEPT_VIEWS) seen.delete(seen.keys().next().value);
    send(message);
  },
  changed() {
    browser.update();
    writeAddress();
  },
});
const frameCanvas = new FrameCanvas(byId("picture"), (header, isDrawn) => {
  send({type: "shown", frame: header.number});
  if (isDrawn) byId("stage").dataset.frame = header.number;
  served = header;
  if (browser.isShowing) return;
  // A frame from before its camera was numbered belongs to the current view.
  const view = seen.get(header.camera) || controller.view;
  if (isDrawn && view) picking.follow(view);
  figures.drew(header, isDrawn);
});
const views = new Views(controller, frameCanvas, (width, height) => send({type: "size", width, height}));
const settings = new Settings(byId("settings"), changed => {
  if (Object.keys(changed).length) send({type: "settings", ...changed});
  if (settings.isByBrowser !== browser.isChosen) browser.choose(settings.isByBrowser);
  writeAddress();
});
const panel = new HitsPanel({
  closed: () => picking.clear(),
  copied: done => (done ? toasts.show("The hits were copied to the clipboard.") : toasts.error("This browser does not allow pages to copy.")),
});
const picking = new Picking({
  ask(message) {
    if (send(message)) work.show("ray", "Tracing the ray", undefined);
  },
  picked: (message, place) => panel.show(message, place),
  centre: point => controller.view && controller.go(lookAt(controller.view, point)),
  missed: () => toasts.show("Nothing to orbit around at this point."),
});
const work = new ProgressBar(() => models.cancel());
const browser = new BrowserDevice(byId("traced"), {
  load: () => loadScene(models.uploads.key),
  seen() {
    const {width, height} = frameCanvas.canvas;
    return {view: controller.view, size: [width, height]};
  },
  offer: (reason, note) => settings.offerBrowser(reason, note),
  showing(is) {
    pauseServer();
    if (!is && served) figures.drew(served, false);
  },
  drawn(header, view) {
    byId("stage").dataset.frame = "browser";
    picking.follow(view);
    figures.drew(header, true);
  },
  loading: is => work.show("browser", "Loading the scene into this browser", is ? undefined : null),
  tell: text => toasts.show(text),
  failed: text => toasts.error(text),
});
const models = new Models({send, error: text => toasts.error(text)}, work);

/** The server renders for a page that is seen, and does not trace by itself. */
function pauseServer() {
  send({type: "pause", paused: document.hidden || browser.isShowing});
}

/** The user moves the camera: the view is no longer one of the scene's cameras. */
function fly(how) {
  controller.change(how);
  views.mark();
}

new Gestures(byId("picture"), {
  orbit: (dx, dy) => fly(view => orbit(view, dx, dy)),
  pan: (dx, dy) => fly(view => pan(view, dx, dy)),
  look: (dx, dy) => fly(view => look(view, dx, dy)),
  zoom: (factor, x, y) => fly(view => zoom(view, factor, x, y)),
  looking: () => controller.isWalking,
  tap: (x, y) => picking.pick(x, y),
  doubleTap: (x, y) => picking.pick(x, y, true),
});

const PRESSES = {
  h: () => views.home(),
  f: () => views.frameAll(),
  1: () => views.side("front"),
  2: () => views.side("right"),
  3: () => views.side("top"),
  o: () => views.otherProjection(),
  x: () => picking.showCrosshair(!picking.isAiming),
  z: () => picking.isAiming && picking.pick(...picking.aim, true),
  p: () => takeScreenshot(),
  c: () => panels.toggleControls(),
  "?": () => panels.showHelp(),
  "+": () => fly(view => zoom(view, 0.85)),
  "=": () => fly(view => zoom(view, 0.85)),
  "-": () => fly(view => zoom(view, 1 / 0.85)),
  Enter: () => picking.isAiming && picking.pick(...picking.aim),
  Escape: () => closeOne(),
};

function closeOne() {
  if (panel.isOpen) panel.close();
  else if (picking.isAiming) picking.showCrosshair(false);
  else panels.close();
}

new Keys({
  walk: (going, fast) => {
    controller.walk(going, fast);
    if (controller.isWalking) views.mark();
  },
  orbit: (dx, dy) => fly(view => orbit(view, dx, dy)),
  look: (dx, dy) => fly(view => look(view, dx, dy)),
  arrow: (code, isLong) => picking.arrow(code, isLong),
  press(key) {
    const action = PRESSES[key.length === 1 ? key.toLowerCase() : key];
    if (action) action();
    return Boolean(action);
  },
});
addEventListener("keydown", event => {
  const inPanel = byId("hits").contains(event.target) || byId("controls").contains(event.target);
  if (event.key === "Escape" && inPanel && !event.defaultPrevented) closeOne();
});
byId("aim").onclick = () => {
  picking.showCrosshair(!picking.isAiming);
  if (picking.isAiming) byId("picture").focus();
};
byId("screenshot").onclick = takeScreenshot;
byId("retry").onclick = () => line.retry();

async function takeScreenshot() {
  const number = ++screenshots;
  if (!browser.isShowing) {
    send({type: "screenshot", number});
    return;
  }
  try {
    const {file, ...size} = await browser.image.toFile();
    saveScreenshot({number, ...size}, file);
  } catch (error) {
    toasts.error(error.message);
  }
}

function saveScreenshot(header, file) {
  const place = URL.createObjectURL(file);
  const link = document.createElement("a");
  const name = (views.scene ? views.scene.name : "picture").replace(/[^\w.-]+/g, "_");
  link.href = place;
  link.download = `${name}-${header.number}.png`;
  link.click();
  setTimeout(() => URL.revokeObjectURL(place), 10000);
  toasts.show(`Saved ${link.download}, ${header.width} × ${header.height} pixels.`);
}

function writeAddress() {
  clearTimeout(writing);
  writing = setTimeout(() => {
    if (!views.scene || !controller.view) return;
    const said = {
      scene: views.scene.name, camera: toCamera(controller.view), settings: settings.said,
      size: views.choice,
    };
    history.replaceState(null, "", urlState.write(said));
  }, WRITE_DELAY);
}

const ANSWERS = {
  hello(message) {
    isWelcome = true;
    byId("banner").hidden = true;
    views.limits = message.limits;
    models.uploads.key = message.upload_key || "";
    models.uploads.limit = message.limits.upload_bytes || Infinity;
    figures.titles = message.heatmaps;
    settings.offer(message);
    settings.restore(wanted.settings);
    views.chooseSize(wanted.size);
    const {width, height} = frameCanvas.canvas;
    send({type: "size", width, height});
    pauseServer();
    models.again();
  },
  scene(message) {
    views.take(message);
    browser.takeScene();
    const isWanted = wanted.camera && wanted.scene === message.name;
    views.begin(isWanted ? wanted.camera : null);
    if (isWanted || !models.files) wanted.camera = null;
    panel.close();
    figures.showScene(message);
    models.loaded(message);
  },
  devices: message => settings.offerDevices(message.devices),
  structure(message) {
    figures.showStructure(message);
    browser.takeStructure(message);
  },
  settings(message) {
    if (message.refused) {
      toasts.error(message.refused);
      settings.refuse(message);
      writeAddress();
    }
    settings.show(message);
    browser.takeSettings(message);
  },
  progress: message => work.show("server", message.what, message.done, models.isLoading),
  hits(message) {
    work.show("ray", "", null);
    picking.take(message);
  },
  error(message) {
    toasts.error(message.message);
    if (message.about === "open") models.loaded(null);
    if (message.about === "pick") work.show("ray", "", null);
    if (message.about === "settings") {
      settings.refuse(settings.current);
      settings.show(settings.current);
      writeAddress();
    }
  },
};

/** Remember the state of a lost connection, to restore it with the next one. */
function lose(seconds, reason) {
  if (isWelcome && views.scene) {
    wanted = {
      scene: views.scene.name, camera: toCamera(controller.view), settings: settings.said,
      size: views.choice,
    };
  }
  isWelcome = false;
  models.uploads.cancel();
  work.clear();
  const why = reason ? ` (${reason})` : "";
  const text = `No connection to raystream${why}. Retrying in ${Math.ceil(seconds)} s.`;
  byId("banner-text").textContent = text;
  byId("banner").hidden = false;
}

document.addEventListener("visibilitychange", () => {
  pauseServer();
  if (!document.hidden) line.retry();
});
addEventListener("hashchange", () => {
  const said = urlState.read(location.hash);
  if (!views.scene) return;
  if (said.camera) views.begin(said.camera);
  settings.restore(said.settings);
  views.chooseSize(said.size);
});

const live = new URL("live", document.baseURI);
live.protocol = live.protocol.replace("http", "ws");
live.hash = "";
line = new Connection(live, {
  open() {},
  text: message => (ANSWERS[message.type] || (() => {}))(message),
  image(header, bytes) {
    if (header.type === "screenshot") saveScreenshot(header, new Blob([bytes], {type: header.format}));
    else frameCanvas.take(header, bytes);
  },
  lost: lose,
});

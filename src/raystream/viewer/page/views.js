// Views: the scene's cameras, standard views, projections, and the image size.

import {byId, fillSelect} from "./elements.js";
import {isSize, SIZES, sizeFor} from "./size.js";
import {subtract, length} from "./vector.js";
import {facing, frame, fromCamera, likelyUp, projected, worldOf} from "./view.js";

const LIMITS = {width: 4096, height: 4096, pixels: 8.3e6};
const OWN = "own";
const FREE = "free";

export class Views {
  /** `resized(width, height)` is called when the image resolution changes. */
  constructor(controller, frameCanvas, resized) {
    this.controller = controller;
    this.frameCanvas = frameCanvas;
    this.resized = resized;
    this.scene = null;
    this.limits = LIMITS;
    this.choice = "fit";
    fillSelect(byId("size"), SIZES);
    byId("size").onchange = event => this.chooseSize(event.target.value);
    byId("home").onclick = () => this.home();
    byId("frame-all").onclick = () => this.frameAll();
    byId("camera").onchange = event => this.toCamera(event.target.value);
    byId("projection").onchange = event => this.project(event.target.value);
    for (const button of document.querySelectorAll("[data-side]")) {
      button.onclick = () => this.side(button.dataset.side);
    }
    new ResizeObserver(() => this.fit()).observe(byId("stage"));
  }

  /** Set up a new scene: its world and its cameras. */
  take(scene) {
    this.scene = scene;
    const size = length(subtract(scene.high, scene.low));
    this.world = worldOf(scene.up || likelyUp(scene.camera.up), size);
    const named = scene.cameras.map(({name}, index) => [String(index), name || `Camera ${index + 1}`]);
    fillSelect(byId("camera"), [[OWN, "Scene's own"], ...named, [FREE, "Free"]]);
  }

  viewOf(camera) {
    const {canvas} = this.frameCanvas;
    return fromCamera(camera, this.world, canvas.width / canvas.height);
  }

  /** Select the camera that matches the view. */
  mark(which = FREE) {
    byId("camera").value = which;
    if (this.controller.view) byId("projection").value = this.controller.view.projection;
  }

  begin(camera) {
    this.controller.set(this.viewOf(camera || this.scene.camera));
    this.mark(camera ? FREE : OWN);
  }

  toCamera(which) {
    if (!this.scene || which === FREE) return;
    const camera = which === OWN ? this.scene.camera : this.scene.cameras[Number(which)];
    this.controller.go(this.viewOf(camera));
    byId("camera").value = which;
    byId("projection").value = camera.projection || "perspective";
  }

  home() {
    this.toCamera(OWN);
  }

  frameAll() {
    if (!this.scene) return;
    this.controller.go(frame(this.controller.view, this.scene.low, this.scene.high));
    this.mark();
  }

  side(name) {
    if (!this.scene) return;
    const turned = facing(this.controller.view, name);
    this.controller.go(frame(turned, this.scene.low, this.scene.high));
    this.mark();
  }

  project(projection) {
    if (!this.scene) return;
    this.controller.set(projected(this.controller.view, projection));
    this.mark();
  }

  otherProjection() {
    const {projection} = this.controller.view || {};
    this.project(projection === "orthographic" ? "perspective" : "orthographic");
  }

  chooseSize(choice) {
    this.choice = isSize(choice) ? choice : "fit";
    byId("size").value = this.choice;
    this.fit();
  }

  /** Fit the image into the stage. */
  fit() {
    const stage = byId("stage");
    const room = {width: stage.clientWidth, height: stage.clientHeight};
    if (!room.width || !room.height) return;
    const {width, height, shown} = sizeFor(this.choice, room, devicePixelRatio, this.limits);
    const {canvas} = this.frameCanvas;
    for (const {style} of [canvas, byId("traced")]) {
      style.width = `${shown[0]}px`;
      style.height = `${shown[1]}px`;
    }
    if (canvas.width === width && canvas.height === height) return;
    this.frameCanvas.resize(width, height);
    this.resized(width, height);
    if (!this.controller.view) return;
    this.controller.view = {...this.controller.view, aspect: width / height};
    this.controller.rest();
  }
}

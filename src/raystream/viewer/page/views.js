// Views: the scene's cameras, the usual sides, projections, and the picture's size.

import {byId, fillSelect} from "./elements.js";
import {isSize, SIZES, sizeFor} from "./size.js";
import {subtract, length} from "./vector.js";
import {facing, frame, fromCamera, likelyUp, projected, worldOf} from "./view.js";

const LIMITS = {width: 4096, height: 4096, pixels: 8.3e6};
const OWN = "own";
const FREE = "free";

export class Views {
  /** `resized(width, height)` is called when the picture's pixels change. */
  constructor(pilot, picture, resized) {
    this.pilot = pilot;
    this.picture = picture;
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

  /** A scene is there: its world and its cameras. */
  take(scene) {
    this.scene = scene;
    const size = length(subtract(scene.high, scene.low));
    this.world = worldOf(scene.up || likelyUp(scene.camera.up), size);
    const named = scene.cameras.map(({name}, index) => [String(index), name || `Camera ${index + 1}`]);
    fillSelect(byId("camera"), [[OWN, "Scene's own"], ...named, [FREE, "Free"]]);
  }

  viewOf(camera) {
    const {canvas} = this.picture;
    return fromCamera(camera, this.world, canvas.width / canvas.height);
  }

  /** Show which of the cameras the view is. */
  mark(which = FREE) {
    byId("camera").value = which;
    if (this.pilot.view) byId("projection").value = this.pilot.view.projection;
  }

  begin(camera) {
    this.pilot.set(this.viewOf(camera || this.scene.camera));
    this.mark(camera ? FREE : OWN);
  }

  toCamera(which) {
    if (!this.scene || which === FREE) return;
    const camera = which === OWN ? this.scene.camera : this.scene.cameras[Number(which)];
    this.pilot.go(this.viewOf(camera));
    byId("camera").value = which;
    byId("projection").value = camera.projection || "perspective";
  }

  home() {
    this.toCamera(OWN);
  }

  frameAll() {
    if (!this.scene) return;
    this.pilot.go(frame(this.pilot.view, this.scene.low, this.scene.high));
    this.mark();
  }

  side(name) {
    if (!this.scene) return;
    const turned = facing(this.pilot.view, name);
    this.pilot.go(frame(turned, this.scene.low, this.scene.high));
    this.mark();
  }

  project(projection) {
    if (!this.scene) return;
    this.pilot.set(projected(this.pilot.view, projection));
    this.mark();
  }

  otherProjection() {
    const {projection} = this.pilot.view || {};
    this.project(projection === "orthographic" ? "perspective" : "orthographic");
  }

  chooseSize(choice) {
    this.choice = isSize(choice) ? choice : "fit";
    byId("size").value = this.choice;
    this.fit();
  }

  /** Fit the picture into the stage. */
  fit() {
    const stage = byId("stage");
    const room = {width: stage.clientWidth, height: stage.clientHeight};
    if (!room.width || !room.height) return;
    const {width, height, shown} = sizeFor(this.choice, room, devicePixelRatio, this.limits);
    const {canvas} = this.picture;
    canvas.style.width = `${shown[0]}px`;
    canvas.style.height = `${shown[1]}px`;
    if (canvas.width === width && canvas.height === height) return;
    this.picture.resize(width, height);
    this.resized(width, height);
    if (!this.pilot.view) return;
    this.pilot.view = {...this.pilot.view, aspect: width / height};
    this.pilot.rest();
  }
}

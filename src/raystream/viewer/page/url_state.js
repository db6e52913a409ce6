// Stores the view and the settings in the fragment of the page's URL, so that a reload or a
// bookmark restores them.

import {isPoint} from "./vector.js";

const SETTINGS = [
  "mode", "structure", "traversal", "machine", "scheduler", "device", "max_bounces",
  "exposure", "tone", "heatmap", "maximum", "samples",
];
const NUMBERS = new Set(["max_bounces", "exposure", "maximum", "samples"]);
const PROJECTIONS = ["perspective", "orthographic", "equirectangular"];

const short = n => String(Number(n.toPrecision(7)));

/** Make a fragment from a scene's name, a camera, settings and the image size. */
export function write({scene, camera, settings, size}) {
  const said = new URLSearchParams();
  if (scene) said.set("scene", scene);
  if (camera) {
    for (const name of ["eye", "look_at", "up"]) said.set(name, camera[name].map(short).join(","));
    said.set("fov", short(camera.fov));
    if (camera.projection !== "perspective") said.set("projection", camera.projection);
    if (camera.height) said.set("height", short(camera.height));
  }
  for (const name of SETTINGS) {
    if (!(name in settings)) continue;
    said.set(name, settings[name] === null ? "" : String(settings[name]));
  }
  if (size && size !== "fit") said.set("size", size);
  return "#" + said.toString().replaceAll("%2C", ",");
}

/** Parse a fragment; invalid parts are ignored. */
export function read(fragment) {
  const said = new URLSearchParams(fragment.replace(/^#/, ""));
  const settings = {};
  for (const name of SETTINGS) {
    const text = said.get(name);
    if (text === null) continue;
    const value = text === "" ? null : NUMBERS.has(name) ? Number(text) : text;
    if (typeof value !== "number" || Number.isFinite(value)) settings[name] = value;
  }
  return {
    scene: said.get("scene"), camera: readCamera(said), settings, size: said.get("size") || "fit",
  };
}

function readCamera(said) {
  const point = name => (said.get(name) || "").split(",").map(part => part === "" ? NaN : Number(part));
  const camera = {
    eye: point("eye"), look_at: point("look_at"), up: point("up"),
    fov: Number(said.get("fov")), projection: said.get("projection") || "perspective",
  };
  const height = Number(said.get("height"));
  if (height > 0 && Number.isFinite(height)) camera.height = height;
  const good = isPoint(camera.eye) && isPoint(camera.look_at) && isPoint(camera.up) &&
    camera.fov > 0 && camera.fov < 180 && PROJECTIONS.includes(camera.projection);
  return good ? camera : null;
}

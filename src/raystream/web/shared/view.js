// A view: a camera parametrized so that it can be rotated without flipping over.
//
// {world, target, yaw, pitch, roll, distance, fov, projection, height, aspect}: the eye is
// `distance` away from the target, in the direction of angles around the world's up; roll rotates
// the image. Angles are in radians, fov is the vertical field of view in degrees, height is the
// vertical extent of an orthographic image, aspect is width over height. An image narrower than
// 4 : 3 shows more above and below instead of less at the sides. All functions return a new view.
// Shifts on the screen are in image heights, positions are fractions of the image from its
// upper left corner.

import {add, cross, dot, length, mix, scale, subtract, unit} from "./vector.js";

const RADIANS = Math.PI / 180;
const STEEPEST = Math.PI / 2;
const FULL_ASPECT = 4 / 3;
const WIDEST_SLOPE = Math.tan(85 * RADIANS);

const clamp = (value, low, high) => Math.min(Math.max(value, low), high);

/** Make the axes of a world: up, front (toward the viewer of a front view) and right. */
export function worldOf(up, size = 1) {
  up = unit(up, [0, 1, 0]);
  const toward = Math.abs(up[1]) >= Math.abs(up[2]) ? [0, 0, 1] : [0, -1, 0];
  const right = unit(cross(up, toward), [1, 0, 0]);
  return {up, right, front: cross(right, up), size: size > 0 ? size : 1};
}

/** Guess the world's up from a camera's: the nearest axis, or the vector itself. */
export function likelyUp(up) {
  up = unit(up, [0, 1, 0]);
  const [y, z] = [Math.abs(up[1]), Math.abs(up[2])];
  if (Math.max(y, z) < 0.5) return up;
  return y >= z ? [0, Math.sign(up[1]), 0] : [0, 0, Math.sign(up[2])];
}

/** Compute the axes of the image: back (toward the eye), right and up. */
export function axesOf(view) {
  const {up, front, right} = view.world;
  const [sine, cosine] = [Math.sin(view.yaw), Math.cos(view.yaw)];
  const level = add(scale(right, sine), scale(front, cosine));
  const back = add(scale(level, Math.cos(view.pitch)), scale(up, Math.sin(view.pitch)));
  const side = add(scale(right, cosine), scale(front, -sine));
  const above = cross(back, side);
  const [turn, rest] = [Math.sin(view.roll), Math.cos(view.roll)];
  return {
    back,
    right: add(scale(side, rest), scale(above, -turn)),
    up: add(scale(above, rest), scale(side, turn)),
  };
}

export function eyeOf(view) {
  const eye = add(view.target, scale(axesOf(view).back, view.distance));
  const nothing = 1e-12 * view.world.size; // rounding error of cosines at right angles
  return eye.map(part => (Math.abs(part) < nothing ? 0 : part));
}

const widened = view => Math.max(1, FULL_ASPECT / view.aspect);
const nominalSlope = view => Math.tan(view.fov * RADIANS / 2);
const slopeOf = view => Math.min(nominalSlope(view) * widened(view), WIDEST_SLOPE);

/** Convert a view to a camera, independent of the image's shape. */
export function toCamera(view) {
  const camera = {
    eye: eyeOf(view), look_at: view.target, up: axesOf(view).up,
    fov: view.fov, projection: view.projection,
  };
  if (view.projection === "orthographic") camera.height = view.height;
  return camera;
}

/** Convert a view to a camera for an image of the view's shape, as sent to the server. */
export function toShapedCamera(view) {
  const camera = {...toCamera(view), fov: 2 * Math.atan(slopeOf(view)) / RADIANS};
  if (view.projection === "orthographic") camera.height = heightAt(view);
  return camera;
}

export function fromCamera(camera, world, aspect = FULL_ASPECT) {
  const apart = subtract(camera.eye, camera.look_at);
  const distance = length(apart) || world.size;
  const back = unit(apart, world.front);
  const pitch = Math.asin(clamp(dot(back, world.up), -1, 1));
  let heading = back;
  if (Math.abs(pitch) > STEEPEST - 1e-6) heading = scale(camera.up, -Math.sign(pitch));
  const yaw = Math.atan2(dot(heading, world.right), dot(heading, world.front));
  const fov = camera.fov || 40;
  const view = {
    world, target: [...camera.look_at], yaw, pitch, roll: 0, distance, fov,
    projection: camera.projection || "perspective",
    height: camera.height || 2 * distance * Math.tan(fov * RADIANS / 2), aspect,
  };
  const axes = axesOf(view);
  const roll = Math.atan2(dot(camera.up, axes.right), dot(camera.up, axes.up));
  return {...view, roll: Math.abs(roll) < 1e-6 ? 0 : roll};
}

/** World units from top to bottom of the image, at the target. */
export function heightAt(view) {
  if (view.projection === "orthographic") return view.height * widened(view);
  return 2 * view.distance * slopeOf(view);
}

export function orbit(view, dx, dy) {
  return {
    ...view,
    yaw: view.yaw - dx * Math.PI,
    pitch: clamp(view.pitch + dy * Math.PI, -STEEPEST, STEEPEST),
  };
}

/** Rotate around the eye, so that the image follows the pointer. */
export function look(view, dx, dy) {
  const eye = eyeOf(view);
  const angle = 2 * Math.atan(slopeOf(view));
  const turned = {
    ...view,
    yaw: view.yaw + dx * angle,
    pitch: clamp(view.pitch - dy * angle, -STEEPEST, STEEPEST),
  };
  return {...turned, target: subtract(eye, scale(axesOf(turned).back, view.distance))};
}

/** Turn toward a point without moving the eye; the point becomes the centre of orbits. */
export function lookAt(view, point) {
  const camera = toCamera(view);
  const distance = length(subtract(camera.eye, point));
  if (!(distance > 1e-9 * view.world.size)) return view;
  const turned = fromCamera({...camera, look_at: point}, view.world, view.aspect);
  return {...turned, height: view.height, roll: view.roll};
}

export function pan(view, dx, dy) {
  const axes = axesOf(view);
  const height = heightAt(view);
  const shift = add(scale(axes.right, -dx * height), scale(axes.up, dy * height));
  return {...view, target: add(view.target, shift)};
}

/** Find the point at a position in the image, in the plane of the target. */
export function pointAt(view, x, y) {
  const axes = axesOf(view);
  const height = heightAt(view);
  const across = scale(axes.right, (x - 0.5) * height * view.aspect);
  return add(view.target, add(across, scale(axes.up, (0.5 - y) * height)));
}

/** Zoom in by a factor below 1, or out; the point at a position in the image stays fixed. */
export function zoom(view, factor, x = 0.5, y = 0.5) {
  const flat = view.projection === "orthographic";
  const size = flat ? view.height : view.distance;
  const kept = clamp(size * factor, 1e-5 * view.world.size, 100 * view.world.size) / size;
  if (!Number.isFinite(kept)) return view;
  const around = view.projection === "equirectangular";
  const point = around ? view.target : pointAt(view, x, y);
  const target = mix(point, view.target, kept);
  const distance = flat ? view.distance : view.distance * kept;
  return {...view, target, distance, height: view.height * kept};
}

/** Move right, up (the world's) and forward, by world units. */
export function walk(view, right, up, ahead) {
  const axes = axesOf(view);
  const shift = add(scale(axes.right, right), scale(axes.back, -ahead));
  return {...view, target: add(view.target, add(shift, scale(view.world.up, up)))};
}

/** Frame a box in the current viewing direction. */
export function frame(view, low, high) {
  const target = mix(low, high, 0.5);
  const axes = axesOf(view);
  const slope = slopeOf(view);
  let [distance, height, depth] = [0, 0, 0];
  for (let corner = 0; corner < 8; corner++) {
    const point = [0, 1, 2].map(axis => (corner >> axis & 1 ? high : low)[axis]);
    const apart = subtract(point, target);
    const [near, across, above] = [
      dot(apart, axes.back),
      Math.abs(dot(apart, axes.right)) / view.aspect,
      Math.abs(dot(apart, axes.up)),
    ];
    distance = Math.max(distance, near + Math.max(across, above) / slope);
    height = Math.max(height, 2 * across, 2 * above);
    depth = Math.max(depth, near);
  }
  const size = view.world.size;
  distance = 1.04 * distance || size;
  if (view.projection === "orthographic") distance = Math.max(distance, depth + size);
  return {...view, target, distance, height: 1.04 * height / widened(view) || size};
}

const SIDES = {front: [0, 0], right: [STEEPEST, 0], top: [0, STEEPEST]};

/** Rotate to "front", "right" or "top". */
export function facing(view, side) {
  const [yaw, pitch] = SIDES[side];
  return {...view, yaw, pitch, roll: 0};
}

/** Change the projection, keeping the extent at the target. */
export function projected(view, projection) {
  if (projection === view.projection) return view;
  if (view.projection === "orthographic") {
    return {...view, projection, distance: view.height / (2 * nominalSlope(view))};
  }
  return {...view, projection, height: 2 * view.distance * nominalSlope(view)};
}

/** Project a point into the image, as [x, y]; null behind the eye. */
export function place(view, point) {
  if (view.projection === "equirectangular") return null;
  const axes = axesOf(view);
  const apart = subtract(point, view.target);
  let height = heightAt(view);
  if (view.projection !== "orthographic") {
    const depth = view.distance - dot(apart, axes.back);
    if (!(depth > 0)) return null;
    height = 2 * depth * slopeOf(view);
  }
  return [
    0.5 + dot(apart, axes.right) / (height * view.aspect),
    0.5 - dot(apart, axes.up) / height,
  ];
}

/** Interpolate between two views of the same world. */
export function between(from, to, share) {
  const turn = (to.yaw - from.yaw) % (2 * Math.PI);
  const shortest = turn - 2 * Math.PI * Math.round(turn / (2 * Math.PI));
  const number = name => from[name] + (to[name] - from[name]) * share;
  const size = name => from[name] * (to[name] / from[name]) ** share;
  return {
    ...to, target: mix(from.target, to.target, share), yaw: from.yaw + shortest * share,
    pitch: number("pitch"), roll: number("roll"), fov: number("fov"),
    distance: size("distance"), height: size("height"),
  };
}

// A camera as the uniform View of camera.wgsl: as raystream/graphics/camera.py.

import {cross, subtract, unit} from "./vector.js";

const NEAR = 2 ** -24;

const high = value => Math.fround(value);
const low = value => value - Math.fround(value);

/** Right, up and forward of a camera: {eye, look_at, up}. */
export function basisOf(camera) {
  const forward = unit(subtract(camera.look_at, camera.eye), [0, 0, -1]);
  const right = unit(cross(forward, camera.up), [1, 0, 0]);
  return [right, cross(right, forward), forward];
}

/** The eye in the local frame: float64 numbers. */
export function localEye(camera, {center, scale}) {
  return camera.eye.map((value, axis) => (value - center[axis]) * scale);
}

/** 28 numbers of View, then what is left of the eye. */
export function viewNumbers(camera, [width, height], frame) {
  const eye = localEye(camera, frame);
  const [right, up, forward] = basisOf(camera);
  const pixel = 2 * Math.tan(camera.fov * Math.PI / 360) / height;
  const reach = Math.max(frame.max_coordinate, ...eye.map(value => Math.abs(value)), 1e-30);
  return [
    ...eye.map(high), reach * NEAR,
    ...right.map(high), high(pixel), ...right.map(low), low(pixel),
    ...up.map(high), width, ...up.map(low), height,
    ...forward.map(high), 1 / frame.scale, ...forward.map(low), 0,
    ...eye.map(low),
  ];
}

// Vectors of three numbers, stored as arrays.

export const add = (a, b) => [a[0] + b[0], a[1] + b[1], a[2] + b[2]];
export const subtract = (a, b) => [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
export const scale = (a, factor) => [a[0] * factor, a[1] * factor, a[2] * factor];
export const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
export const length = a => Math.hypot(a[0], a[1], a[2]);
export const mix = (a, b, share) => a.map((value, axis) => value + (b[axis] - value) * share);

export const cross = (a, b) => [
  a[1] * b[2] - a[2] * b[1],
  a[2] * b[0] - a[0] * b[2],
  a[0] * b[1] - a[1] * b[0],
];

/** Normalize; a zero vector becomes `otherwise`. */
export function unit(a, otherwise = [0, 0, 1]) {
  const size = length(a);
  return size > 0 && Number.isFinite(size) ? scale(a, 1 / size) : otherwise;
}

export const isPoint = a =>
  Array.isArray(a) && a.length === 3 && a.every(value => Number.isFinite(value));

// The resolution of the image, and its size on the screen.

const LEAST = 16;
const DENSEST = 2;

/** Choices: name and text; "fit" follows the window. */
export const SIZES = [
  ["fit", "Fit the window"],
  ["half", "Fit, half resolution"],
  ["640x480", "640 × 480"],
  ["1024x768", "1024 × 768"],
  ["1280x720", "1280 × 720"],
  ["1920x1080", "1920 × 1080"],
];

export const isSize = name => SIZES.some(([known]) => known === name);

/**
 * Compute the image's resolution and its size in CSS pixels for a stage size. Limits are those
 * of the server: width, height and total pixels.
 */
export function sizeFor(choice, stage, density, limits) {
  const fixed = /^(\d+)x(\d+)$/.exec(choice);
  let [width, height] = [stage.width, stage.height];
  if (fixed) {
    [width, height] = [Number(fixed[1]), Number(fixed[2])];
    const share = Math.min(1, stage.width / width, stage.height / height);
    return {
      width, height,
      shown: [Math.round(width * share), Math.round(height * share)],
    };
  }
  let factor = choice === "half" ? 0.5 : Math.min(density, DENSEST);
  factor = Math.min(factor, limits.width / width, limits.height / height);
  factor = Math.min(factor, Math.sqrt(limits.pixels / (width * height)));
  const pixels = (size, most) => Math.max(LEAST, Math.min(Math.floor(size * factor), most));
  return {
    width: pixels(width, limits.width),
    height: pixels(height, limits.height),
    shown: [width, height],
  };
}

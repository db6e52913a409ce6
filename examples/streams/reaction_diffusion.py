"""
Reaction and diffusion
======================

Two chemicals on a torus: a kernel in WGSL, repeated on the graphics device.

The model is that of Gray and Scott (Pearson, "Complex Patterns in a Simple System", Science 261,
1993). Each pass reads the four neighbours of a record from the stream that it writes, as in the
kernel chains of Christen 2005, chapter 4.3.
"""

import time

import numpy as np
from PIL import Image

from raystream.graphics.errors import GraphicsError
from raystream.graphics.streams import INDEX, GatherArray, Kernel, Repeat, Stream

SIDE, PASSES = 160, 3000

REACT = """
fn react(at: vec2f, i: i32, spread: vec2f, feed: f32, kill: f32) -> vec2f {
    let height = field_shape[0];
    let width = field_shape[1];
    let row = i / width;
    let column = i % width;
    let around = field((row + 1) % height, column) + field(row - 1, column)
        + field(row, (column + 1) % width) + field(row, column - 1);
    let reaction = at.x * at.y * at.y;
    let change = vec2f(feed * (1.0 - at.x) - reaction, reaction - (feed + kill) * at.y);
    return at + spread * (around - 4.0 * at) + change;
}
"""


def start() -> np.ndarray:
    """The first chemical everywhere; twenty drops of the second."""
    random = np.random.default_rng(2005)
    field = np.zeros((SIDE, SIDE, 2), np.float32)
    field[..., 0] = 1.0
    for row, column in random.integers(0, SIDE - 8, (20, 2)):
        field[row : row + 8, column : column + 8] = 0.5, 0.25
    return field.reshape(-1, 2)


def main() -> None:
    """Run the passes, and write the image."""
    field = Stream(start(), name="field")
    kernel = Kernel(
        REACT,
        inputs={"at": field, "i": INDEX},
        outputs=field,
        gathers={"field": GatherArray(field, (SIDE, SIDE))},
        constants={"spread": (0.2, 0.1), "feed": 0.037, "kill": 0.06},
    )
    began = time.perf_counter()
    count = Repeat(PASSES, kernel).run()
    second = field.array[:, 1].reshape(SIDE, SIDE)
    seconds = time.perf_counter() - began
    levels = np.clip(second / second.max(), 0.0, 1.0)[..., None]
    colours = (1 - levels) * (18, 24, 56) + levels * (255, 214, 120)
    image = Image.fromarray(colours.astype(np.uint8)).resize((2 * SIDE, 2 * SIDE))
    image.quantize(32).save("reaction_diffusion.png", optimize=True)
    print(f"reaction_diffusion.png: {SIDE} x {SIDE} records after {count.calls:,} passes")
    print(f"{field.opened.adapter}: {seconds:.1f} s")
    assert 0.2 < second.mean() / second.max() < 0.6, "no pattern"


if __name__ == "__main__":
    try:
        main()
    except GraphicsError as error:  # no adapter, or wgpu is not installed
        print(error)

"""
Heat in a plate
===============

A plate with one hot edge, until its temperatures settle.

Each cell becomes the mean of its four neighbours. The kernel gathers from the stream that it
writes, and all writes take effect after the pass, so every cell reads its neighbours' old values. A
cell that hardly changes is rejected; when all cells are rejected, the plate has settled. Denser
characters and brighter pixels are hotter.
"""

import numpy as np

import raystream as rs
from raystream.streams import INDEX, Counters, GatherArray, Kernel, Stream


def diffuse(i, cell, plate, tolerance):
    """The mean of the neighbours; None if the cell is close to it."""
    columns = plate.shape[1]
    row, column = i // columns, i % columns
    mean = np.float32(0.25) * (
        (plate[row - 1, column] + plate[row + 1, column])
        + (plate[row, column - 1] + plate[row, column + 1])
    )
    return mean if abs(mean - cell) > tolerance else None


height, width = 96, 128
temperatures = np.zeros((height, width), np.float32)
temperatures[0] = 100.0  # one edge is hot, the others are cold
is_inside = np.zeros((height, width), bool)
is_inside[1:-1, 1:-1] = True

cells = Stream(temperatures.ravel(), name="cells")
kernel = Kernel(
    diffuse,
    inputs={"i": INDEX, "cell": cells},
    outputs=cells,
    gathers={"plate": GatherArray(cells, (height, width))},
    constants={"tolerance": np.float32(1e-3)},
    where=Stream(is_inside.ravel(), name="inside"),
)

calls = kernel.loop()
counters = Counters()
kernel.set_constants(tolerance=-1.0)  # one more step, in which every cell is written
kernel.execute(counters=counters)
print(f"the plate settled after {calls:,} steps; one step:")
print(counters)

plate = cells.array.reshape(height, width) / 100.0
for row in plate[::8, ::2]:
    print("".join(" .:-=+*#%@"[min(int(value * 10.0), 9)] for value in row))
colours = np.stack([3.0 * plate, 3.0 * plate - 1.0, 3.0 * plate - 2.0], axis=-1)
image = np.clip(colours, 0.0, 1.0).astype(np.float32).repeat(4, axis=0).repeat(4, axis=1)
rs.Image(image).save("heat.png")
print("heat.png: black is cold, white is hot")

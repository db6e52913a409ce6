"""Layout: positions of instances, evenly spread without overlap."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray


def floor_cells(
    count: int,
    low: tuple[float, float],
    high: tuple[float, float],
    generator: np.random.Generator,
    jitter: float = 0.12,
) -> tuple[NDArray[np.float64], float]:
    """Choose positions on a floor, each in its own square cell.

    Parameters
    ----------
    count : int
        Number N of spots.
    low, high : tuple of float
        Corners (x, z) of the floor.
    generator : numpy.random.Generator
    jitter : float
        Maximum offset from the cell's centre on either axis, in cell widths.

    Returns
    -------
    spots : ndarray of shape (N, 2), float64
        x and z, row by row.
    spacing : float
        Width of a cell: discs of radius ``(0.5 - jitter) * spacing`` do not overlap.
    """
    width, depth = high[0] - low[0], high[1] - low[1]
    columns = max(1, math.ceil(math.sqrt(count * width / depth)))
    rows = max(1, math.ceil(count / columns))
    spacing = min(width / columns, depth / rows)
    chosen = np.sort(generator.permutation(columns * rows)[:count])
    middle = np.stack([chosen % columns, chosen // columns], axis=1) + 0.5
    middle *= [width / columns, depth / rows]
    wobble = generator.uniform(-jitter, jitter, (count, 2)) * spacing
    return np.asarray(low) + middle + wobble, spacing

"""Statistics of a grid: cells, references and expected cost."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from raystream.structures.grid.lattice import Lattice
from raystream.structures.grid.layout import FineArrays, GridArrays


def statistics(
    lattice: Lattice, lists: GridArrays, fine: FineArrays, triangle_count: int
) -> dict[str, float]:
    """Count cells and references.

    Parameters
    ----------
    lattice : Lattice
    lists : GridArrays
    fine : FineArrays
    triangle_count : int
        Triangles that can be hit.

    Returns
    -------
    dict of str to float
        ``cells x``, ``cells y``, ``cells z``: along each axis; ``divided cells``: the
        subdivided ones; ``cells``: all others, with fine cells; ``empty
        share``: fraction of them that list no triangle; ``references per triangle`` and
        ``largest list``: of their lists.
    """
    sizes = np.delete(np.diff(lists.splits), fine.cells)
    sizes = np.concatenate([sizes, np.diff(fine.lists.splits)])
    x, y, z = lattice.counts
    return {
        "cells x": float(x),
        "cells y": float(y),
        "cells z": float(z),
        "divided cells": float(len(fine.cells)),
        "cells": float(len(sizes)),
        "empty share": float(np.count_nonzero(sizes == 0) / len(sizes)),
        "references per triangle": float(sizes.sum(dtype=np.int64)) / max(1, triangle_count),
        "largest list": float(sizes.max()),
    }


def trace_cost(
    lattice: Lattice, lists: GridArrays, fine: FineArrays, bounds: NDArray[np.float32]
) -> float:
    """Expected cells and references visited by a random line through bounds, hits or not.

    A line that hits a convex body hits one inside it with a probability of the ratio of
    their surface areas (MacDonald and Booth 1990). nan for bounds of no area.
    """
    low, high = bounds.astype(np.float64)
    whole = float(_half_area(high - low))
    if not whole > 0.0:
        return math.nan
    divided_references = int(np.diff(lists.splits)[fine.cells].sum(dtype=np.int64))
    plain = lattice.cell_count + len(lists.references) - divided_references
    size = np.array(lattice.size)
    cost = plain * float(_half_area(size))
    firsts = fine.first_cells
    references = np.diff(fine.lists.splits[firsts].astype(np.int64))
    inner = np.diff(firsts) + references
    cost += float((inner * _half_area(size / fine.counts)).sum())
    return cost / whole


def _half_area(size: NDArray[np.float64]) -> NDArray[np.float64]:
    x, y, z = size[..., 0], size[..., 1], size[..., 2]
    return x * y + y * z + z * x

"""Grid: the uniform grid as a structure."""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raystream.core.triangles import Triangles
from raystream.jit.threads import Progress
from raystream.kernels.queries import ray_queries
from raystream.structures.base import BuildReport, Structure
from raystream.structures.grid.build import build_grid
from raystream.structures.grid.lattice import MAX_CELLS, Lattice, chosen_resolution
from raystream.structures.grid.layout import GridAddresses, GridArrays, check_lists
from raystream.structures.grid.traversal import STACK_BYTES, traverse

__all__ = ["Grid"]


class Grid(Structure):
    """A uniform grid (Purcell 2002, section 3): the scene's box in cells of one size.

    Parameters
    ----------
    triangles : Triangles
    resolution : int or sequence of three int, optional
        Cells along the axes x, y and z, of whatever shape that makes them; a number is for
        all three. An axis on which the scene is flat has one.
    min_resolution : int, optional
        Cells along the shortest axis on which the scene is not flat; the others get cells of
        about the same size (Purcell 2002, section 4.1).
    progress : callable, optional
        Called with (triangles placed, triangles) while building.

    Raises
    ------
    ValueError
        If an option is out of range, both are given, or they ask for more than 2**28 cells,
        2**20 along an axis, or 2**32 - 1 references of cells to triangles.
    TypeError
        If a number is no integer.
    MemoryError
        If the cells, or their lists, do not fit into the memory that is free.

    Notes
    -----
    Memory is 4 bytes for each cell, twice that while building, and 4 for each reference.
    Without `resolution` and `min_resolution` there are about 8 cells for each triangle, and
    fewer if triangles are so large that lists become long: at most 24 references for each
    triangle (or 2**20). A scene with details that are small against its size, as a teapot in
    a stadium, then has them in few cells: rays take long there, and find the same hits.
    """

    name = "grid"
    queries = ray_queries(traverse, STACK_BYTES)

    def __init__(
        self,
        triangles: Triangles,
        *,
        resolution: Any = None,
        min_resolution: int | None = None,
        progress: Progress | None = None,
    ) -> None:
        resolution, min_resolution = chosen_resolution(resolution, min_resolution)
        started = time.perf_counter()
        lattice, lists = build_grid(triangles, resolution, min_resolution, progress)
        options = {"resolution": resolution, "min_resolution": min_resolution}
        self._set(triangles, lattice, lists, options, started)

    def _set(
        self,
        triangles: Triangles,
        lattice: Lattice,
        lists: GridArrays,
        options: Mapping[str, Any],
        started: float,
    ) -> None:
        self.triangles = triangles
        self.lattice = lattice
        self.lists = lists
        self.options = options
        # Kept, as rays read it by its address.
        self._corners = np.ascontiguousarray(triangles.corners)
        self._addresses = GridAddresses.of(lattice, lists, self._corners)
        self.report = BuildReport(
            seconds=time.perf_counter() - started,
            byte_count=sum(array.nbytes for array in lists),
        )

    @property
    def arrays(self) -> GridAddresses:
        """Where the grid is; the structure keeps it."""
        return self._addresses

    def quality(self) -> dict[str, float]:
        """Cells along each axis, how many are empty, and how long the others' lists are."""
        sizes = np.diff(self.lists.splits)
        count = len(self.triangles.prim_ids)
        return {
            **{f"cells {axis}": float(n) for axis, n in zip("xyz", self.lattice.counts, strict=True)},
            "cells": float(len(sizes)),
            "empty share": float(np.count_nonzero(sizes == 0) / len(sizes)),
            "references per triangle": len(self.lists.references) / max(1, count),
            "largest list": float(sizes.max()),
            "bytes": float(self.report.byte_count),
        }

    def saved_arrays(self) -> dict[str, NDArray[Any]]:
        """The lists, how many cells there are, and the options that say so."""
        chosen = self.options["resolution"] or (0, 0, 0)
        least = self.options["min_resolution"] or 0
        return {
            "splits": self.lists.splits,
            "references": self.lists.references,
            "counts": np.array(self.lattice.counts, np.int64),
            "options": np.array([*chosen, least], np.int64),
        }

    @classmethod
    def from_arrays(cls, triangles: Triangles, arrays: Mapping[str, NDArray[Any]]) -> Grid:
        """Make a grid of saved arrays; see `Structure.from_arrays`."""
        started = time.perf_counter()
        counts = _integers(arrays, "counts", 3)
        *chosen, least = _integers(arrays, "options", 4)
        resolution, min_resolution = chosen_resolution(
            chosen if any(chosen) else None, least if least else None
        )
        if min(counts) < 1 or max(counts) > MAX_CELLS or np.prod(counts, dtype=float) > MAX_CELLS:
            raise ValueError("its cells are too many or too few")
        if len(triangles.prim_ids):
            lattice = Lattice.of(triangles, counts)
            if list(lattice.counts) != counts:
                raise ValueError("its cells are not those of the scene's box")
        else:
            lattice, _ = build_grid(triangles, None, None)
        ids = triangles.prim_ids
        lists = check_lists(arrays, lattice.cell_count, ids, len(triangles))
        options = {"resolution": resolution, "min_resolution": min_resolution}
        structure = cls.__new__(cls)
        structure._set(triangles, lattice, lists, options, started)
        return structure


def _integers(arrays: Mapping[str, NDArray[Any]], name: str, count: int) -> list[int]:
    array = arrays.get(name)
    if array is None or array.shape != (count,) or array.dtype != np.int64:
        raise ValueError(f"array {name!r} is missing or of another kind")
    return array.tolist()

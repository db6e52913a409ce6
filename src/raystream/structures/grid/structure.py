"""GridStructure: the uniform grid as a structure."""

from __future__ import annotations

import time
from collections.abc import Mapping
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raystream.core.triangles import Triangles
from raystream.jit.threads import Progress
from raystream.structures.base import BuildReport, Structure, UpdateReport
from raystream.structures.grid.build import build_grid
from raystream.structures.grid.lattice import Lattice
from raystream.structures.grid.layout import (
    FineArrays,
    GridAddresses,
    GridArrays,
    check_fine,
    check_lists,
)
from raystream.structures.grid.options import Grid, check_cells
from raystream.structures.grid.refine import refine
from raystream.structures.grid.statistics import statistics, trace_cost
from raystream.structures.grid.traversal import traverse
from raystream.structures.grid.update import move_lists
from raystream.structures.saved import solid_mask, take

#: Largest local coordinate, so that no distance overflows float32.
_LARGEST_BOX = 2.0**60


class GridStructure(Structure):
    """A uniform grid as it was built; see `Grid`.

    Parameters
    ----------
    triangles : Triangles
    options : Grid
    progress : callable, optional
        Called with (triangles placed, triangles) while building.

    Raises
    ------
    ValueError
        If there would be more than 2**32 - 1 references of cells to triangles.
    MemoryError
        If there is not enough memory for the cells or their lists.
    """

    traverse = staticmethod(traverse)
    options: Grid

    def __init__(
        self, triangles: Triangles, options: Grid, *, progress: Progress | None = None
    ) -> None:
        started = time.perf_counter()
        lattice, lists = build_grid(triangles, options, progress)
        fine = refine(triangles, lattice, lists) if options.levels == 2 else FineArrays.none()
        self._set(triangles, lattice, lists, fine, options, started)

    def _set(
        self,
        triangles: Triangles,
        lattice: Lattice,
        lists: GridArrays,
        fine: FineArrays,
        options: Grid,
        started: float,
    ) -> None:
        self.triangles = triangles
        self.lattice = lattice
        self.lists = lists
        self.options = options
        self.fine = fine
        # Kept alive, as kernels read them by address.
        self._kept = (
            *lists,
            np.ascontiguousarray(triangles.corners),
            fine.children(lattice.cell_count),
            fine.records(),
            *fine.lists,
        )
        names = GridAddresses._fields[-len(self._kept) :]
        self.arrays = dict(zip(names, self._kept, strict=True))
        self.view = _addresses(lattice, self._kept)
        kept_bytes = sum(array.nbytes for array in self._kept)
        self.report = BuildReport(
            seconds=time.perf_counter() - started,
            byte_count=kept_bytes - self._kept[2].nbytes,
        )

    @property
    def tests_per_ray(self) -> int:
        """Half of the most cells and triangles that a ray visits, about; few visit as many."""
        sizes = np.diff(self.lists.splits)
        sizes[self.fine.cells] = 0
        inner = np.diff(self.fine.lists.splits)
        longest = max(int(sizes.max()), int(inner.max(initial=0)))
        usual = 1 + len(self.lists.references) // self.lattice.cell_count
        return (longest + usual * sum(self.lattice.counts)) // 2

    @cached_property
    def cost_when_built(self) -> float:
        """Expected cost of a ray before triangles moved; see `UpdateReport`."""
        return trace_cost(self.lattice, self.lists, self.fine, self.triangles.bounds)

    def quality(self) -> dict[str, float]:
        """Numbers of cells and lengths of lists; see `statistics`."""
        figures = statistics(self.lattice, self.lists, self.fine, len(self.triangles.prim_ids))
        return {**figures, "bytes": float(self.report.byte_count)}

    def saved_arrays(self) -> dict[str, NDArray[Any]]:
        """The lists and the numbers of cells."""
        return {
            "splits": self.lists.splits,
            "references": self.lists.references,
            "counts": np.array(self.lattice.counts, np.int64),
            "box": self.lattice.box,
            "fine_cells": self.fine.cells,
            "fine_counts": self.fine.counts,
            "fine_splits": self.fine.lists.splits,
            "fine_references": self.fine.lists.references,
        }

    @classmethod
    def from_arrays(
        cls, triangles: Triangles, arrays: Mapping[str, NDArray[Any]], options: Grid
    ) -> GridStructure:
        """Make a grid from saved arrays; see `Structure.from_arrays`."""
        started = time.perf_counter()
        counts = take(arrays, "counts", np.int64, (3,)).tolist()
        check_cells("counts", counts)
        lattice = _saved_lattice(arrays, counts, triangles, options.is_exact)
        if list(lattice.counts) != counts:
            raise ValueError("the number of cells does not fit the bounding box")
        solid = solid_mask(triangles)
        lists = check_lists(arrays, "", lattice.cell_count, solid)
        found = np.zeros(len(triangles), np.bool_)
        found[lists.references] = True
        if not np.array_equal(found, solid):
            raise ValueError("a triangle of the scene is in no cell")
        fine = check_fine(arrays, lattice.cell_count, solid)
        structure = cls.__new__(cls)
        structure._set(triangles, lattice, lists, fine, options, started)
        return structure

    def updated(
        self, triangles: Triangles, max_cost_growth: float, progress: Progress | None = None
    ) -> tuple[Structure, UpdateReport]:
        """Change the lists of cells that triangles leave or enter; see `Structure.updated`.

        Notes
        -----
        A grid is rebuilt if its box no longer contains all triangles, or if its expected cost
        grew too much, for instance as triangles gather in a part of the box. The second level is
        always rebuilt.
        """
        started = time.perf_counter()
        if self._holds(triangles):
            lists = move_lists(self.triangles, triangles, self.lattice, self.lists)
            is_fine = self.options.levels == 2
            fine = refine(triangles, self.lattice, lists) if is_fine else FineArrays.none()
            cost = trace_cost(self.lattice, lists, fine, triangles.bounds)
            if cost <= max_cost_growth * self.cost_when_built:
                moved = GridStructure.__new__(GridStructure)
                moved.cost_when_built = self.cost_when_built
                moved._set(triangles, self.lattice, lists, fine, self.options, started)
                return moved, UpdateReport(False, moved.report.seconds, cost, self.cost_when_built)
        rebuilt = GridStructure(triangles, self.options, progress=progress)
        cost = rebuilt.cost_when_built
        return rebuilt, UpdateReport(True, time.perf_counter() - started, cost, cost)

    def _holds(self, triangles: Triangles) -> bool:
        """Whether the grid's box contains the triangles, in the same frame."""
        if len(self.triangles.prim_ids) == 0 or len(triangles.prim_ids) == 0:
            return False
        if triangles.scale != self.triangles.scale:
            return False
        if not np.array_equal(triangles.center, self.triangles.center):
            return False
        low, high = self.lattice.box
        return bool((triangles.bounds[0] >= low).all() and (triangles.bounds[1] <= high).all())


def _saved_lattice(
    arrays: Mapping[str, NDArray[Any]], counts: list[int], triangles: Triangles, is_exact: bool
) -> Lattice:
    """The lattice of a file, whose box contains the triangles but may be larger."""
    box = take(arrays, "box", np.float32, (2, 3))
    if not (np.abs(box) <= _LARGEST_BOX).all() or (box[0] > box[1]).any():
        raise ValueError("invalid bounding box")
    low, high = triangles.bounds
    if len(triangles.prim_ids) and ((box[0] > low).any() or (box[1] < high).any()):
        raise ValueError("the bounding box does not contain the triangles")
    return Lattice.of(box, counts, is_exact)


def _addresses(lattice: Lattice, kept: tuple[NDArray[Any], ...]) -> GridAddresses:
    """Addresses of arrays in the order of `GridAddresses`; 0 for empty ones."""
    low, high, size, counts = (
        (np.float32(x), np.float32(y), np.float32(z))
        for x, y, z in (lattice.low, lattice.high, lattice.size, lattice.counts)
    )
    at = [np.uint64(array.ctypes.data if array.size else 0) for array in kept]
    if kept[1].size == 0:
        at[0] = np.uint64(0)
    return GridAddresses(low, high, size, counts, *at)

"""Building the lists of a grid: count, then fill; on all threads."""

from __future__ import annotations

import threading
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.core.memory import check_memory
from raystream.core.triangles import Triangles
from raystream.jit.cpu import kernel
from raystream.jit.simd import address
from raystream.jit.threads import Progress, parallel_for, part_of, thread_count
from raystream.structures.grid.lattice import Lattice, choose_lattice
from raystream.structures.grid.layout import MAX_REFERENCES, GridArrays
from raystream.structures.grid.overlap import range_along, spread_within

__all__ = ["build_grid", "build_lists"]

#: Triangles that one call of the first kernel gets.
_CHUNK = 1 << 13

#: References for each triangle beyond which the automatic resolution is made coarser, and how
#: many there may be in any case.
_MOST_REFERENCES, _FEW_REFERENCES = 24, 1 << 20


class _TooManyError(Exception):
    """Ends a count as soon as there are more references than allowed."""


def build_grid(
    triangles: Triangles,
    resolution: tuple[int, int, int] | None,
    min_resolution: int | None,
    levels: int = 1,
    progress: Progress | None = None,
) -> tuple[Lattice, GridArrays]:
    """Choose a lattice and list the triangles of each cell.

    Parameters
    ----------
    triangles : Triangles
    resolution : tuple of three int, optional
    min_resolution : int, optional
    levels : int
        See `lattice.choose_lattice`. Without a resolution, cells are made coarser until lists are
        short.
    progress : callable, optional
        Called with (triangles placed, triangles).

    Returns
    -------
    Lattice
    GridArrays
        The same ones for any number of threads.

    Raises
    ------
    ValueError
        If there are more references than a grid can have.
    MemoryError
        If there is not enough memory.
    """
    count = len(triangles.prim_ids)
    if count == 0:
        return Lattice.of(triangles, (1, 1, 1)), GridArrays.empty(1)
    is_free = resolution is None and min_resolution is None
    option = "resolution" if min_resolution is None else "min_resolution"
    coarser = 0
    while True:
        lattice = choose_lattice(triangles, resolution, min_resolution, levels, coarser)
        # One cell needs one reference for each triangle, so coarsening comes to an end.
        most = MAX_REFERENCES
        if is_free:
            most = max(_FEW_REFERENCES, _MOST_REFERENCES * count)
        try:
            return lattice, build_lists(triangles, lattice, most, option, progress)
        except _TooManyError:
            if not is_free:
                raise ValueError(
                    f"{option}: more than {most:,} references of cells to triangles are too many"
                ) from None
        coarser += 2


class _Layers(NamedTuple):
    """The axis along which threads share the cells, and where triangles are along it.

    Attributes
    ----------
    axis : int
        The one with the most cells.
    ranges : ndarray of shape (A, 2), int32
        First and last layer of cells that each triangle that can be hit is in, at most.
    """

    axis: int
    ranges: NDArray[np.int32]


def build_lists(
    triangles: Triangles,
    lattice: Lattice,
    most: int,
    option: str,
    progress: Progress | None = None,
) -> GridArrays:
    """List the triangles of each cell.

    Parameters
    ----------
    triangles : Triangles
    lattice : Lattice
    most : int
        How many references there may be.
    option : str
        What to blame if memory is short.
    progress : callable, optional
        Called with (triangles placed, triangles).

    Returns
    -------
    GridArrays
    """
    cell_count = lattice.cell_count
    remedy = "choose a coarser one"
    check_memory(cell_count * 8, f"{option}: {cell_count:,} cells would", remedy)
    layers = _find_layers(triangles, lattice)
    splits = np.zeros(cell_count + 1, np.uint32)
    references = np.empty(0, np.int32)
    solid_count = len(triangles.prim_ids)
    halves = [None, None]
    if progress is not None:
        report = progress  # layers done, of twice as many, as triangles
        steps = 2 * lattice.counts[layers.axis]
        whole = lambda done, _: report(done * solid_count // steps, solid_count)  # noqa: E731
        halves = [part_of(whole, 0, steps), part_of(whole, steps // 2, steps)]
    total = _spread_all(triangles, lattice, layers, splits[1:], references, most, halves[0])
    check_memory(total * 4, f"{option}: {total:,} references would", remedy)
    np.cumsum(splits, out=splits)
    references = np.empty(total, np.int32)
    cursors = splits[:-1].copy()
    _spread_all(triangles, lattice, layers, cursors, references, most, halves[1])
    return GridArrays(splits, references)


def _find_layers(triangles: Triangles, lattice: Lattice) -> _Layers:
    axis = int(np.argmax(lattice.counts))
    prim_ids, corners = triangles.prim_ids, triangles.corners
    ranges = np.empty((len(prim_ids), 2), np.int32)

    def body(begin: int, end: int) -> None:
        _find_ranges(begin, end, lattice, axis, corners, prim_ids, ranges)

    parallel_for(body, len(prim_ids), _CHUNK)
    return _Layers(axis, ranges)


def _spread_all(
    triangles: Triangles,
    lattice: Lattice,
    layers: _Layers,
    cursors: NDArray[np.uint32],
    references: NDArray[np.int32],
    most: int,
    progress: Progress | None,
) -> int:
    """Count the triangles of each cell, or write them; returns how many there are.

    Each thread takes some layers and looks for the triangles there, in order: so lists
    come out the same whoever makes them, and no two threads write to one cell.
    """
    is_fill = len(references) > 0
    prim_ids, corners = triangles.prim_ids, triangles.corners
    found = 0
    lock = threading.Lock()

    def body(begin: int, end: int) -> None:
        nonlocal found
        here = _spread_layers(
            begin,
            end,
            lattice,
            layers.axis,
            layers.ranges,
            corners,
            prim_ids,
            cursors,
            references,
            is_fill,
            most,
        )
        with lock:
            found += here
        if found > most:
            raise _TooManyError

    layer_count = lattice.counts[layers.axis]
    # Each call reads all ranges: few calls, but enough to share the work evenly.
    chunk = max(1, -(-layer_count // (8 * thread_count())))
    parallel_for(body, layer_count, chunk, progress)
    return found


@kernel
def _find_ranges(begin, end, lattice, axis, corners, prim_ids, ranges):
    """Find the layers of triangles begin to end."""
    for row in range(np.uint64(begin), np.uint64(end)):
        first, last = range_along(lattice, corners, np.uint64(prim_ids[row]), axis)
        ranges[row, 0] = first
        ranges[row, 1] = last


@kernel
def _spread_layers(
    begin,
    end,
    lattice,
    axis,
    ranges,
    corners,
    prim_ids,
    cursors,
    references,
    is_fill,
    most,
):
    """Count or write the triangles of the layers begin to end; ends beyond `most`."""
    total = np.int64(0)
    cursor_at, reference_at = address(cursors), address(references)
    for row in range(np.uint64(len(ranges))):
        if ranges[row, 0] >= end or ranges[row, 1] < begin:
            continue
        i = np.uint64(prim_ids[row])
        total += spread_within(
            lattice, corners, i, axis, begin, end, cursor_at, reference_at, is_fill
        )
        if total > most:
            break
    return total

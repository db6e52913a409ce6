"""Building the lists of a grid on all threads: count, then fill."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from raystream.core.memory import check_memory
from raystream.core.triangles import Triangles
from raystream.jit.cpu import kernel
from raystream.jit.simd import address
from raystream.jit.threads import Progress, parallel_for, part_of, thread_count
from raystream.structures.grid.lattice import Lattice, choose_lattice
from raystream.structures.grid.layout import MAX_REFERENCES, GridArrays
from raystream.structures.grid.options import Grid
from raystream.structures.grid.overlap import ListWriter, list_in_layers, range_along

#: Triangles per call of the first kernel.
_CHUNK = 1 << 13

#: References per triangle beyond which the automatic resolution is made coarser; and references
#: that are always allowed.
_REFERENCES_PER_TRIANGLE, _FEW_REFERENCES = 24, 1 << 20


Lists = TypeVar("Lists")


class TooManyError(Exception):
    """Stops a count as soon as there are more references than allowed."""


def build_grid(
    triangles: Triangles, options: Grid, progress: Progress | None = None
) -> tuple[Lattice, GridArrays]:
    """Choose a lattice and list the triangles of each cell.

    Parameters
    ----------
    triangles : Triangles
    options : Grid
    progress : callable, optional
        Called with (triangles placed, triangles).

    Returns
    -------
    Lattice
    GridArrays
        The same for any number of threads.

    Raises
    ------
    ValueError
        If there are more references than a grid can have.
    MemoryError
        If there is not enough memory.
    """
    if len(triangles.prim_ids) == 0:
        return Lattice.of(triangles.bounds, (1, 1, 1)), GridArrays.empty(1)

    def make(lattice: Lattice, limit: int, option: str) -> GridArrays:
        return build_lists(triangles, lattice, limit, option, progress)

    return choose_and_build(triangles, options, make)


def choose_and_build(
    triangles: Triangles, options: Grid, make: Callable[[Lattice, int, str], Lists]
) -> tuple[Lattice, Lists]:
    """Choose a lattice, coarser if there are too many references, and make its lists.

    Parameters
    ----------
    triangles : Triangles
        At least one that can be hit.
    options : Grid
        Without a resolution, cells are made coarser until lists are short.
    make : callable
        ``make(lattice, limit, option)`` makes lists; it raises `TooManyError` if there are more
        than `limit` references.

    Raises
    ------
    ValueError
        If there are more references than a grid can have.
    """
    count = len(triangles.prim_ids)
    is_free = options.resolution is None and options.min_resolution is None
    option = "resolution" if options.min_resolution is None else "min_resolution"
    coarser = 0
    while True:
        lattice = choose_lattice(triangles, options, coarser)
        # One cell needs one reference per triangle, so coarsening ends.
        limit = reference_limit(count) if is_free else MAX_REFERENCES
        try:
            return lattice, make(lattice, limit, option)
        except TooManyError:
            if not is_free:
                raise ValueError(
                    f"{option}: more than {limit:,} references of cells to triangles are too many"
                ) from None
        coarser += 2


def reference_limit(triangle_count: int) -> int:
    """Most references of a grid that chooses its resolution itself."""
    return min(MAX_REFERENCES, max(_FEW_REFERENCES, _REFERENCES_PER_TRIANGLE * triangle_count))


class Layers(NamedTuple):
    """The axis along which threads share the cells, and the extent of triangles along it.

    Attributes
    ----------
    axis : int
        The one with the most cells.
    ranges : ndarray of shape (A, 2), int32
        First and last layer of cells that each triangle can be in.
    """

    axis: int
    ranges: NDArray[np.int32]


class ListOutput(NamedTuple):
    """Where the triangles of cells are counted, or written.

    Attributes
    ----------
    positions : ndarray of shape (C,), uint32
        For each cell, the row of its next reference. Grows by one for each triangle in it.
    references : ndarray of shape (R,), int32
        Written; if it is empty, triangles are only counted.
    limit : int
        `TooManyError` is raised if there are more references.
    """

    positions: NDArray[np.uint32]
    references: NDArray[np.int32]
    limit: int = MAX_REFERENCES


def build_lists(
    triangles: Triangles,
    lattice: Lattice,
    limit: int,
    option: str,
    progress: Progress | None = None,
) -> GridArrays:
    """List the triangles of each cell.

    Parameters
    ----------
    triangles : Triangles
    lattice : Lattice
    limit : int
        `TooManyError` is raised if there are more references.
    option : str
        The option to blame if memory is short.
    progress : callable, optional
        Called with (triangles placed, triangles).

    Returns
    -------
    GridArrays
    """
    corners, prim_ids = triangles.corners, triangles.prim_ids
    layers = find_layers(corners, prim_ids, lattice)
    # Two loops over the layers.
    count, half = len(prim_ids), len(prim_ids) // 2
    halves = iter((part_of(progress, 0, half, count), part_of(progress, half, count - half, count)))

    def list_all(output: ListOutput) -> int:
        return list_triangles(corners, prim_ids, lattice, layers, output, next(halves))

    return count_and_fill(lattice.cell_count, limit, list_all, option, "choose a coarser one")


def count_and_fill(
    cell_count: int, limit: int, list_all: Callable[[ListOutput], int], option: str, remedy: str
) -> GridArrays:
    """Make the lists of cells: count their triangles, then write them.

    Parameters
    ----------
    cell_count : int
    limit : int
        Most references.
    list_all : callable
        Counts the triangles of all cells, or writes them; returns their number.
    option, remedy : str
        The option to blame if memory is short, and what to do then.
    """
    check_memory(cell_count * 8, f"{option}: {cell_count:,} cells would", remedy)
    splits = np.zeros(cell_count + 1, np.uint32)
    total = list_all(ListOutput(splits[1:], np.empty(0, np.int32), limit))
    check_memory(total * 4, f"{option}: {total:,} references would", remedy)
    np.cumsum(splits, out=splits)
    references = np.empty(total, np.int32)
    list_all(ListOutput(splits[:-1].copy(), references, limit))
    return GridArrays(splits, references)


def find_layers(
    corners: NDArray[np.float32], prim_ids: NDArray[np.int32], lattice: Lattice
) -> Layers:
    """Find the layers of cells that triangles are in."""
    axis = int(np.argmax(lattice.counts))
    ranges = np.empty((len(prim_ids), 2), np.int32)

    def body(begin: int, end: int) -> None:
        _find_ranges(begin, end, lattice, axis, corners, prim_ids, ranges)

    parallel_for(body, len(prim_ids), _CHUNK)
    return Layers(axis, ranges)


def list_triangles(
    corners: NDArray[np.float32],
    prim_ids: NDArray[np.int32],
    lattice: Lattice,
    layers: Layers,
    output: ListOutput,
    progress: Progress | None = None,
) -> int:
    """Count the triangles of each cell, or write them.

    Each thread takes some layers and lists the triangles there, in order. So lists do not
    depend on the number of threads, and no two threads write to one cell.

    Parameters
    ----------
    corners : ndarray of shape (F, 3, 3), float32
    prim_ids : ndarray of shape (A,), int32
        Rows of `corners`, in increasing order.
    lattice : Lattice
    layers : Layers
        From `find_layers` for the same triangles.
    output : ListOutput
    progress : callable, optional
        Called with (layers done, layers).

    Returns
    -------
    int
        The number of references.
    """

    def list_some(begin: int, end: int) -> int:
        return int(_list_layers(begin, end, lattice, layers, corners, prim_ids, output))

    layer_count = lattice.counts[layers.axis]
    # Each call reads all ranges: few calls, but enough to share the work evenly.
    chunk = max(1, -(-layer_count // (8 * thread_count())))
    return parallel_count(list_some, layer_count, chunk, output.limit, progress)


def parallel_count(
    count_some: Callable[[int, int], int],
    count: int,
    chunk: int,
    limit: int,
    progress: Progress | None = None,
) -> int:
    """Run a loop over [0, count) whose calls count references; returns their number.

    Raises
    ------
    TooManyError
        As soon as there are more than `limit`.
    """
    found = 0
    lock = threading.Lock()

    def body(begin: int, end: int) -> None:
        nonlocal found
        here = count_some(begin, end)
        with lock:
            found += here
        if found > limit:
            raise TooManyError

    parallel_for(body, count, chunk, progress)
    return found


@kernel
def _find_ranges(begin, end, lattice, axis, corners, prim_ids, ranges):
    """Find the layers of triangles begin to end."""
    for row in range(np.uint64(begin), np.uint64(end)):
        first, last = range_along(lattice, corners, np.uint64(prim_ids[row]), axis)
        ranges[row, 0] = first
        ranges[row, 1] = last


@kernel
def _list_layers(begin, end, lattice, layers, corners, prim_ids, output):
    """Count or write the triangles of layers begin to end; stops beyond the limit."""
    total = np.int64(0)
    axis, ranges, limit = layers.axis, layers.ranges, output.limit
    is_fill = len(output.references) > 0
    writer = ListWriter(address(output.positions), address(output.references), is_fill)
    for row in range(np.uint64(len(ranges))):
        if ranges[row, 0] >= end or ranges[row, 1] < begin:
            continue
        i = np.uint64(prim_ids[row])
        total += list_in_layers(lattice, corners, i, axis, begin, end, writer)
        if total > limit:
            break
    return total

"""Updating a grid for moved triangles: only the lists that a triangle leaves or enters change.

Purcell 2002, section 5.1, asks for such updates, for moving geometry.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from raystream.core.memory import check_memory
from raystream.core.triangles import Triangles
from raystream.jit.cpu import kernel
from raystream.jit.threads import parallel_for
from raystream.structures.grid.build import ListOutput, find_layers, list_triangles
from raystream.structures.grid.lattice import Lattice
from raystream.structures.grid.layout import MAX_REFERENCES, GridArrays
from raystream.structures.saved import solid_mask

#: Triangles, and cells, per call of a kernel.
_TRIANGLE_CHUNK = 1 << 14
_CELL_CHUNK = 1 << 14


def move_lists(old: Triangles, new: Triangles, lattice: Lattice, lists: GridArrays) -> GridArrays:
    """Make the lists of moved triangles.

    Parameters
    ----------
    old, new : Triangles
        In the same frame, and both in the lattice's box.
    lattice : Lattice
    lists : GridArrays
        Of the old ones; not changed.

    Returns
    -------
    GridArrays
        Equal to those that `build.build_lists` makes of the new ones.

    Raises
    ------
    MemoryError
        If there is not enough memory.
    """
    was, now = solid_mask(old), solid_mask(new)
    moved = np.empty(len(now), np.bool_)
    arrays = _flat(old.corners), _flat(new.corners), was, now, moved

    def compare(begin: int, end: int) -> None:
        _compare(begin, end, *arrays)

    parallel_for(compare, len(now), _TRIANGLE_CHUNK)

    # Step 1: the number of triangles that leave, and that enter, each cell.
    cell_count = lattice.cell_count
    check_memory(cell_count * 16, f"update: {cell_count:,} cells would")
    left, kept, entered = (np.zeros(cell_count, np.uint32) for _ in range(3))
    nothing = np.empty(0, np.int32)
    ids = np.flatnonzero(moved & was).astype(np.int32)
    layers = find_layers(old.corners, ids, lattice)
    list_triangles(old.corners, ids, lattice, layers, ListOutput(left, nothing))
    ids = np.flatnonzero(moved & now).astype(np.int32)
    layers = find_layers(new.corners, ids, lattice)
    list_triangles(new.corners, ids, lattice, layers, ListOutput(entered, nothing))

    # Step 2: allocate the new lists.
    def keep(output: ListOutput) -> None:
        def keep_some(begin: int, end: int) -> None:
            _keep(begin, end, lists, left, moved, output)

        parallel_for(keep_some, cell_count, _CELL_CHUNK)

    keep(ListOutput(kept, nothing))
    total = int(kept.sum(dtype=np.int64) + entered.sum(dtype=np.int64))
    check_memory(total * 4, f"update: {total:,} references would")
    if total > MAX_REFERENCES:
        raise MemoryError(f"update: {total:,} references are more than {MAX_REFERENCES:,}")
    splits = np.zeros(cell_count + 1, np.uint32)
    np.add(kept, entered, out=splits[1:])
    np.cumsum(splits, out=splits)
    result = GridArrays(splits, np.empty(total, np.int32))

    # Step 3: copy the triangles that stay, append those that enter, sort.
    kept[:] = splits[:-1]  # from here on: the row of the next triangle
    output = ListOutput(kept, result.references)
    keep(output)
    list_triangles(new.corners, ids, lattice, layers, output)

    def sort(begin: int, end: int) -> None:
        _sort_lists(begin, end, *result, entered)

    parallel_for(sort, cell_count, _CELL_CHUNK)
    return result


def _flat(corners: NDArray[np.float32]) -> NDArray[Any]:
    return np.ascontiguousarray(corners).reshape(-1, 9)


@kernel
def _compare(begin, end, old, new, was, now, moved):
    """Find the triangles that moved, or that can be hit only before or only after."""
    for i in range(np.uint64(begin), np.uint64(end)):
        differs = was[i] != now[i]
        for k in range(np.uint64(9)):
            differs |= old[i, k] != new[i, k]
        moved[i] = differs


@kernel
def _keep(begin, end, lists, left, moved, output):
    """Count the triangles of each cell that did not move, or copy them."""
    is_fill = len(output.references) > 0
    for cell in range(np.uint64(begin), np.uint64(end)):
        first, last = np.uint64(lists.splits[cell]), np.uint64(lists.splits[cell + np.uint64(1)])
        to = np.uint64(output.positions[cell])
        leaves = left[cell] != 0
        if not (leaves or is_fill):  # all of them stay
            output.positions[cell] = to + (last - first)
            continue
        for row in range(first, last):
            prim_id = lists.references[row]
            if not (leaves and moved[np.uint64(prim_id)]):
                if is_fill:
                    output.references[to] = prim_id
                to += np.uint64(1)
        output.positions[cell] = to


@kernel
def _sort_lists(begin, end, splits, references, entered):
    """Sort the lists that a triangle entered; each is two sorted runs."""
    for cell in range(np.uint64(begin), np.uint64(end)):
        if entered[cell] == 0:
            continue
        first, last = np.int64(splits[cell]), np.int64(splits[cell + np.uint64(1)])
        references[first:last].sort()

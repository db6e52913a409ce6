"""Checks that a graph from a file is safe to walk: in bounds, and every walk ends.

A walk ends if no ray visits a sector twice. Rays leave through faces that face their direction,
so it suffices that for each of the eight octants of directions, the links through its three
faces have no cycle, link nodes included. Correct planes do not follow from this, nor
the other way round; both are checked.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raystream.jit.cpu import device, kernel
from raystream.jit.threads import parallel_for
from raystream.kernels.leaf_block import BLOCK_SIZE
from raystream.structures.graph.layout import (
    MAX_ROWS,
    NODE_BIT,
    NODE_WORDS,
    SECTOR_ROWS,
    VOID,
    GraphArrays,
)
from raystream.structures.saved import are_listed, take

_CHUNK = 1 << 12

#: Rounding error of the sum of the sectors' volumes, relative.
_VOLUME_ERROR = 1e-9

_BIT, _NOWHERE, _ROWS = np.int64(NODE_BIT), np.int64(VOID), np.int64(SECTOR_ROWS)
_NAN = np.float32(np.nan)

# Error codes of kernels.
_FINE = 0
_BAD_BOX, _BAD_LIST, _BAD_ID, _BAD_LINK, _BAD_NODE, _BAD_PLANE, _BAD_SIDE = range(1, 8)

_FAULTS = {
    _BAD_BOX: "a sector has an invalid bounding box",
    _BAD_LIST: "a sector's list is out of range",
    _BAD_ID: "a sector lists an invalid triangle, or too few",
    _BAD_LINK: "a link is out of range",
    _BAD_NODE: "a link node links to one that comes later, or to nowhere",
    _BAD_PLANE: "a link node's plane is not between what it links to",
    _BAD_SIDE: "a face links to sectors that do not touch it",
}


@kernel
def _check_sectors(begin, end, rows, numbers, prim_ids, solid, wanted):
    """Check boxes and lists of sectors begin to end; `wanted` becomes false for those listed."""
    block_count = np.int64(len(prim_ids))
    for sector in range(begin, end):
        row = sector * SECTOR_ROWS
        for axis in range(3):
            low, high = numbers[row, axis], numbers[row + 1, axis]
            if not (np.isfinite(low) and np.isfinite(high) and low < high):
                return _BAD_BOX
        first, count = np.int64(rows[row, 3]), np.int64(rows[row + 1, 3])
        if first + (count + BLOCK_SIZE - 1) // BLOCK_SIZE > block_count:
            return _BAD_LIST
        if not are_listed(prim_ids, first, count, solid, wanted):
            return _BAD_ID
    return _FINE


@device
def _is_sector(link, sector_count):
    return link < sector_count * _ROWS and link % _ROWS == 0


@kernel
def _check_nodes(rows, numbers, sector_count, sides, hulls):
    """Check the link nodes, and compute the extent of the sectors behind each.

    Parameters
    ----------
    rows, numbers : ndarray of shape (R, 4), uint32 and float32
        The same memory.
    sector_count : int
    sides : ndarray of shape (N, 6), float32
        Written: low x, y, z, high x, y, z common to all sectors behind a node, else NaN.
    hulls : ndarray of shape (N, 6), float32
        Written: the bounding box of those sectors.
    """
    first_node = sector_count * _ROWS
    for row in range(first_node, len(rows)):
        node, axis, plane = row - first_node, np.int64(rows[row, 1]), numbers[row, 0]
        if axis > 2:
            return _BAD_NODE
        below, above = np.int64(rows[row, 2]), np.int64(rows[row, 3])
        for link in (below, above):
            inner = (link & ~_BIT) - first_node
            if link & _BIT != 0 and (inner < 0 or inner >= node):
                return _BAD_NODE
            if link & _BIT == 0 and not _is_sector(link, sector_count):
                return _BAD_LINK
        for k in range(6):
            row_of, column = k // 3, k % 3
            if below & _BIT != 0:
                inner = (below & ~_BIT) - first_node
                side, reach = sides[inner, k], hulls[inner, k]
            else:
                side = reach = numbers[below + row_of, column]
            if above & _BIT != 0:
                inner = (above & ~_BIT) - first_node
                other_side, other_reach = sides[inner, k], hulls[inner, k]
            else:
                other_side = other_reach = numbers[above + row_of, column]
            # Sectors below the plane end there, and those above begin there.
            if k == axis and not other_reach >= plane:
                return _BAD_PLANE
            if k == axis + 3 and not reach <= plane:
                return _BAD_PLANE
            sides[node, k] = side if side == other_side else _NAN
            hulls[node, k] = min(reach, other_reach) if k < 3 else max(reach, other_reach)
    return _FINE


@kernel
def _check_links(begin, end, rows, numbers, sector_count, sides, box):
    """Check that faces of sectors begin to end link to sectors that touch them."""
    first_node = sector_count * _ROWS
    node_count = len(rows) - first_node
    for sector in range(begin, end):
        row = sector * SECTOR_ROWS
        for face in range(6):
            axis, is_high = face >> 1, face & 1
            link = np.int64(rows[row + 2 + face // 4, face % 4])
            plane = numbers[row + is_high, axis]
            if link == _NOWHERE:
                if plane != box[is_high, axis]:
                    return _BAD_SIDE
                continue
            other = axis + 3 * (1 - is_high)
            if link & _BIT != 0:
                node = (link & ~_BIT) - first_node
                if node < 0 or node >= node_count:
                    return _BAD_LINK
                side = sides[node, other]
            else:
                if not _is_sector(link, sector_count):
                    return _BAD_LINK
                side = numbers[link + other // 3, axis]
            if side != plane:
                return _BAD_SIDE
    return _FINE


@device
def _vertex(link, sector_count):
    """Number of the vertex that a link leads to: sectors first, then link nodes."""
    if link & _BIT != 0:
        return (link & ~_BIT) - sector_count * (_ROWS - 1)
    return link // _ROWS


@kernel
def _count_node_links(rows, sector_count, degrees):
    """Add to the degree of each vertex the links of link nodes to it."""
    for row in range(sector_count * _ROWS, len(rows)):
        for end in range(2):
            degrees[_vertex(np.int64(rows[row, 2 + end]), sector_count)] += np.uint32(1)


@kernel
def _is_ordered(octant, rows, sector_count, degrees, ready):
    """Whether the links of an octant have no cycle: Kahn's topological sort.

    Parameters
    ----------
    octant : int
        Bit k: whether rays go up axis k.
    rows : ndarray of shape (R, 4), uint32
        Otherwise valid.
    sector_count : int
    degrees : ndarray of shape (V,), uint32
        Links of link nodes to each sector and node. Changed.
    ready : ndarray of shape (V,), uint32
        Written: a stack.

    References
    ----------
    Kahn, "Topological sorting of large networks", Communications of the ACM 5(11), 1962.
    """
    for sector in range(sector_count):
        for axis in range(3):
            face = 2 * axis + ((octant >> axis) & 1)
            link = np.int64(rows[sector * _ROWS + 2 + face // 4, face % 4])
            if link != _NOWHERE:
                degrees[_vertex(link, sector_count)] += np.uint32(1)
    top, done = 0, 0
    for vertex in range(len(degrees)):
        if degrees[vertex] == 0:
            ready[top] = vertex
            top += 1
    while top > 0:
        top -= 1
        done += 1
        vertex = np.int64(ready[top])
        is_sector = vertex < sector_count
        for k in range(3 if is_sector else 2):
            if is_sector:
                face = 2 * k + ((octant >> k) & 1)
                link = np.int64(rows[vertex * _ROWS + 2 + face // 4, face % 4])
                if link == _NOWHERE:
                    continue
            else:
                link = np.int64(rows[vertex + sector_count * (_ROWS - 1), 2 + k])
            target = _vertex(link, sector_count)
            degrees[target] -= np.uint32(1)
            if degrees[target] == 0:
                ready[top] = target
                top += 1
    return done == len(degrees)


def check_graph(
    arrays: Mapping[str, Any],
    bounds: NDArray[np.float32],
    solid_ids: NDArray[np.int32],
    triangle_count: int,
) -> GraphArrays:
    """Check a graph from a file: that no walk reads out of bounds or never ends.

    Parameters
    ----------
    arrays : mapping of str to ndarray
        See `GraphArrays`; ``sector_count`` is an array of shape ().
    bounds : ndarray of shape (2, 3), float32
        The scene's box, which the sectors must contain.
    solid_ids : ndarray of shape (A,), int32
        The triangles that sectors must list, and no others.
    triangle_count : int
        Of the scene.

    Returns
    -------
    GraphArrays

    Raises
    ------
    ValueError
        If it is invalid.

    Notes
    -----
    The graph may still be wrong: sectors may lack triangles.
    """
    graph = _take(arrays)
    rows, sector_count, prim_ids, _ = graph
    solid = np.zeros(triangle_count, np.bool_)
    solid[solid_ids] = True
    if sector_count == 0:
        if len(rows) or len(prim_ids) or graph.bins.size or len(solid_ids):
            raise ValueError("a graph without sectors cannot hold anything")
        return graph
    wanted = solid.copy()
    numbers = rows.view(np.float32)

    def check_some(begin: int, end: int) -> None:
        _raise_fault(_check_sectors(begin, end, rows, numbers, prim_ids, solid, wanted))

    parallel_for(check_some, sector_count, _CHUNK)
    # In all blocks, also those of no sector: corners are looked up for each.
    if len(prim_ids) and not (prim_ids.min() >= -1 and prim_ids.max() < triangle_count):
        raise ValueError(_FAULTS[_BAD_ID])
    if wanted.any():
        raise ValueError("a triangle of the scene is in no sector")
    _check_box(numbers[: SECTOR_ROWS * sector_count], bounds)
    if graph.bins.size == 0 or not _are_sectors(graph.bins, sector_count):
        raise ValueError("a bin has no sector")
    _check_all_links(rows, numbers, sector_count)
    return graph


def _take(arrays: Mapping[str, Any]) -> GraphArrays:
    """The arrays, checked for dtype and shape."""
    rows = take(arrays, "rows", np.uint32, (None, NODE_WORDS))
    prim_ids = take(arrays, "prim_ids", np.int32, (None, BLOCK_SIZE))
    bins = take(arrays, "bins", np.uint32, (None, None, None))
    count = int(take(arrays, "sector_count", np.int64, ()))
    if not 0 <= SECTOR_ROWS * count <= len(rows) <= MAX_ROWS:
        raise ValueError(f"{len(rows):,} rows cannot hold {count:,} sectors")
    return GraphArrays(rows, count, prim_ids, bins)


def _raise_fault(code: int) -> None:
    if code != _FINE:
        raise ValueError(_FAULTS[code])


def _are_sectors(links: NDArray[np.uint32], sector_count: int) -> bool:
    is_in = links.max() < SECTOR_ROWS * sector_count
    return bool(is_in and not (links % SECTOR_ROWS).any())


def _check_box(numbers: NDArray[np.float32], bounds: NDArray[np.float32]) -> None:
    """Check that the sectors, with valid boxes, tile one that contains the scene's."""
    low, high = _box_of(numbers)
    if not (low <= bounds[0]).all() or not (high >= bounds[1]).all():
        raise ValueError("the sectors do not contain the scene")
    size = numbers[1::SECTOR_ROWS, :3].astype(np.float64) - numbers[::SECTOR_ROWS, :3]
    volume = (high.astype(np.float64) - low).prod()
    if not abs(size.prod(axis=1).sum() - volume) <= _VOLUME_ERROR * volume:
        raise ValueError("the sectors do not tile their bounding box")


def _box_of(numbers: NDArray[np.float32]) -> NDArray[np.float32]:
    """The bounding box of sectors, shape (2, 3)."""
    return np.stack(
        [
            numbers[::SECTOR_ROWS, :3].min(axis=0),
            numbers[1::SECTOR_ROWS, :3].max(axis=0),
        ]
    )


def _check_all_links(
    rows: NDArray[np.uint32], numbers: NDArray[np.float32], sector_count: int
) -> None:
    node_count = len(rows) - SECTOR_ROWS * sector_count
    sides = np.empty((node_count, 6), np.float32)
    hulls = np.empty((node_count, 6), np.float32)
    _raise_fault(_check_nodes(rows, numbers, sector_count, sides, hulls))
    box = _box_of(numbers[: SECTOR_ROWS * sector_count])

    def check_some(begin: int, end: int) -> None:
        _raise_fault(_check_links(begin, end, rows, numbers, sector_count, sides, box))

    parallel_for(check_some, sector_count, _CHUNK)
    degrees = np.zeros(sector_count + node_count, np.uint32)
    _count_node_links(rows, sector_count, degrees)

    def check_octants(begin: int, end: int) -> None:
        for octant in range(begin, end):
            ready = np.empty(len(degrees), np.uint32)
            if not _is_ordered(octant, rows, sector_count, degrees.copy(), ready):
                raise ValueError("the links form a cycle")

    nothing = np.zeros(0, np.uint32)
    _is_ordered(0, rows[:0], 0, nothing, nothing)  # compiled before threads start
    parallel_for(check_octants, 8, 1)

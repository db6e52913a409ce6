"""Statistics of a graph: size and expected cost."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from raystream.jit.constants import BYTES_32, ONE_U64, THREE_U64, ZERO_U64
from raystream.jit.cpu import kernel
from raystream.jit.simd import address, load, store
from raystream.jit.threads import parallel_for
from raystream.structures.boxes import copy_box, face_area, half_area
from raystream.structures.clip import HIGH
from raystream.structures.graph.layout import NODE_BIT, SECTOR_ROWS, VOID, GraphArrays
from raystream.structures.graph.options import Graph

_CHUNK = 1 << 12

#: A pending part of a face: its link (uint64) and its box (low x, y, z, high x, y, z).
_PENDING = np.uint64(32)

_BOX_AT = np.uint64(8)
_ROW = np.uint64(16)
_BIT = np.uint64(NODE_BIT)
_NOWHERE = np.uint64(VOID)
_SECTOR_BYTES = np.uint64(16 * SECTOR_ROWS)


@kernel
def _measure_trees(rows, sector_count, depths, sizes):
    """Depth of the tree of each link node, and its number of nodes if not shared."""
    first = sector_count * SECTOR_ROWS
    bit = np.int64(NODE_BIT)
    for node in range(len(depths)):
        depth, size = 0, 0.0
        for end in range(2):
            link = np.int64(rows[first + node, 2 + end])
            if link & bit != 0:
                inner = (link & ~bit) - first
                depth = max(depth, depths[inner])
                size += sizes[inner]
        depths[node], sizes[node] = depth + 1, size + 1.0


@kernel
def _add_up(begin, end, rows, stack, sums):
    """Add the areas of sectors begin to end to `sums`.

    Parameters
    ----------
    begin, end : int
    rows : ndarray of shape (R, 4), uint32
    stack : ndarray of shape (K,), uint8
        Room for one more part of a face than the depth of its tree.
    sums : ndarray of shape (4,), float64
        Half areas of sectors; the same times triangles; areas of faces with a link; areas of
        faces per link node.
    """
    row_at, stack_at = address(rows), address(stack)
    box = stack_at
    for sector in range(np.uint64(begin), np.uint64(end)):
        at = row_at + sector * _SECTOR_BYTES
        # The sector's box without the interleaved words, below the stack.
        for k in range(THREE_U64):
            store(box + k * BYTES_32, load(np.float32, at + k * BYTES_32))
            store(box + HIGH + k * BYTES_32, load(np.float32, at + _ROW + k * BYTES_32))
        half = half_area(box)
        sums[0] += half
        sums[1] += half * np.float64(load(np.uint32, at + np.uint64(28)))
        for face in range(np.uint64(6)):
            link = np.uint64(load(np.uint32, at + _ROW + _ROW + face * BYTES_32))
            if link == _NOWHERE:
                continue
            axis = face >> ONE_U64
            sums[2] += face_area(box, axis)
            top = stack_at + _PENDING
            store(top, link)
            copy_box(top + _BOX_AT, box)
            top += _PENDING
            while top != stack_at + _PENDING:
                top -= _PENDING
                link = load(np.uint64, top)
                if link & _BIT == ZERO_U64:
                    continue
                sums[3] += face_area(top + _BOX_AT, axis)
                node = row_at + (link ^ _BIT) * _ROW
                side = np.uint64(load(np.uint32, node + BYTES_32)) * BYTES_32
                above = top + _PENDING
                copy_box(above + _BOX_AT, top + _BOX_AT)
                store(above + _BOX_AT + side, load(np.float32, node))
                store(top + _BOX_AT + HIGH + side, load(np.float32, node))
                store(top, np.uint64(load(np.uint32, node + np.uint64(8))))
                store(above, np.uint64(load(np.uint32, node + np.uint64(12))))
                top = above + _PENDING


def _sum_areas(graph: GraphArrays, depth: int) -> NDArray[np.float64]:
    """The sums of `_add_up` over all sectors; the same for any number of threads."""
    parts = np.zeros((-(-graph.sector_count // _CHUNK), 4))

    def body(begin: int, end: int) -> None:
        stack = np.empty((depth + 3) * int(_PENDING), np.uint8)
        _add_up(begin, end, graph.rows, stack, parts[begin // _CHUNK])

    parallel_for(body, graph.sector_count, _CHUNK)
    return parts.sum(axis=0)


def statistics(graph: GraphArrays, options: Graph) -> dict[str, float]:
    """Measure a graph.

    Parameters
    ----------
    graph : GraphArrays
    options : Graph
        With the costs of steps.

    Returns
    -------
    dict of str to float
        ``sectors``, ``empty sectors``; ``references``: triangles of all sectors, one in
        several counted several times; ``largest list``; ``link nodes``, and ``link nodes
        unshared``: if each face had its own; ``mean link depth``: link nodes that a random ray
        passes between sectors; ``link depth``: their maximum; ``bytes``, without corners;
        ``sectors per ray``, ``link nodes per ray``, ``tests per ray``: expected for a random
        line through the box, hits or not; ``cost``: of these, J in `build`.
    """
    rows, count = graph.rows, graph.sector_count
    if count == 0:
        return dict.fromkeys(("sectors", "empty sectors", "references", "link nodes"), 0.0)
    sizes = rows[1 : SECTOR_ROWS * count : SECTOR_ROWS, 3]
    node_count = len(rows) - SECTOR_ROWS * count
    depths, own = np.zeros(node_count, np.int64), np.zeros(node_count)
    _measure_trees(rows, count, depths, own)
    links = rows[: SECTOR_ROWS * count].reshape(count, -1)[:, 8:14]
    nodes = links[(links & NODE_BIT != 0) & (links != VOID)] - NODE_BIT - SECTOR_ROWS * count
    depth = int(depths.max(initial=0))
    half, tests, faces, passed = _sum_areas(graph, depth).tolist()
    numbers = rows[: SECTOR_ROWS * count].view(np.float32)
    low = numbers[::SECTOR_ROWS, :3].min(axis=0).astype(np.float64)
    x, y, z = (numbers[1::SECTOR_ROWS, :3].max(axis=0) - low).tolist()
    whole = x * y + y * z + z * x
    per_ray = {
        "sectors per ray": half / whole,
        "link nodes per ray": passed / (2.0 * whole),
        "tests per ray": tests / whole,
    }
    costs = options.crossing_cost, options.link_cost, options.intersection_cost
    return {
        "sectors": float(count),
        "empty sectors": float(np.count_nonzero(sizes == 0)),
        "references": float(sizes.sum(dtype=np.int64)),
        "largest list": float(sizes.max()),
        "link nodes": float(node_count),
        "link nodes unshared": float(own[nodes].sum()),
        "mean link depth": passed / faces if faces else 0.0,
        "link depth": float(depth),
        "bytes": float(rows.nbytes + graph.prim_ids.nbytes + graph.bins.nbytes),
        **per_ray,
        "cost": sum(c * n for c, n in zip(costs, per_ray.values(), strict=True)),
    }

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

from raystream.jit.cpu import kernel
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
from raystream.structures.saved import check_blocks, take

#: Rounding error of the sum of the sectors' volumes, relative.
_VOLUME_ERROR = 1e-9

_NAN = np.float32(np.nan)


@kernel
def _fill_extents(axes, planes, targets, sides, hulls):
    """Find the extent of the sectors behind each link node.

    Parameters
    ----------
    axes, planes : ndarray of shape (N,), int64 and float32
        Of the link nodes.
    targets : ndarray of shape (N, 2), int32
        The vertices below and above a node's plane: sectors first, then link nodes, which come
        before those that link to them.
    sides : ndarray of shape (S + N, 6), float32
        Low x, y, z, high x, y, z common to all sectors behind a vertex, else NaN: given for
        sectors, written for nodes.
    hulls : ndarray of shape (S + N, 6), float32
        The bounding box of those sectors; likewise.

    Returns
    -------
    bool
        Whether each plane is between what its node links to.
    """
    first_node = len(sides) - len(targets)
    for row in range(len(targets)):
        node, below, above = first_node + row, targets[row, 0], targets[row, 1]
        # Sectors below the plane end there, and those above begin there.
        if not hulls[below, axes[row] + 3] <= planes[row] <= hulls[above, axes[row]]:
            return False
        for k in range(6):
            is_common = sides[below, k] == sides[above, k]
            sides[node, k] = sides[below, k] if is_common else _NAN
            low, high = hulls[below, k], hulls[above, k]
            hulls[node, k] = min(low, high) if k < 3 else max(low, high)
    return True


@kernel
def _is_acyclic(links):
    """Whether a graph has no cycle: Kahn's topological sort.

    Parameters
    ----------
    links : ndarray of shape (V, 3), int32
        The vertices that each vertex links to; -1 for none.

    References
    ----------
    Kahn, "Topological sorting of large networks", Communications of the ACM 5(11), 1962.
    """
    degrees = np.zeros(len(links), np.int32)  # links to each vertex
    for vertex in range(len(links)):
        for k in range(3):
            if links[vertex, k] >= 0:
                degrees[links[vertex, k]] += 1
    ready = np.empty(len(links), np.int32)
    end, done = 0, 0
    for vertex in range(len(links)):
        if degrees[vertex] == 0:
            ready[end] = vertex
            end += 1
    while done < end:
        for k in range(3):
            target = links[ready[done], k]
            if target >= 0:
                degrees[target] -= 1
                if degrees[target] == 0:
                    ready[end] = target
                    end += 1
        done += 1
    return done == len(links)


def check_graph(
    arrays: Mapping[str, Any],
    bounds: NDArray[np.float32],
    solid: NDArray[np.bool_],
) -> GraphArrays:
    """Check a graph from a file: that no walk reads out of bounds or never ends.

    Parameters
    ----------
    arrays : mapping of str to ndarray
        See `GraphArrays`; ``sector_count`` is an array of shape ().
    bounds : ndarray of shape (2, 3), float32
        The scene's box, which the sectors must contain.
    solid : ndarray of shape (F,), bool
        Whether sectors must list a triangle of the scene.

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
    rows, count, prim_ids, bins = graph
    if count == 0:
        if len(rows) or len(prim_ids) or bins.size or solid.any():
            raise ValueError("a graph without sectors cannot hold anything")
        return graph
    sectors = rows[: SECTOR_ROWS * count].reshape(count, SECTOR_ROWS * NODE_WORDS)
    boxes = sectors[:, [0, 1, 2, 4, 5, 6]].view(np.float32)
    if not (np.isfinite(boxes).all() and (boxes[:, :3] < boxes[:, 3:]).all()):
        raise ValueError("a sector has an invalid bounding box")
    check_blocks(prim_ids, sectors[:, 3], sectors[:, 7], solid, "sector")
    box = np.concatenate([boxes[:, :3].min(axis=0), boxes[:, 3:].max(axis=0)])
    if (box[:3] > bounds[0]).any() or (box[3:] < bounds[1]).any():
        raise ValueError("the sectors do not contain the scene")
    volumes = (boxes[:, 3:].astype(np.float64) - boxes[:, :3]).prod(axis=1)
    volume = (box[3:].astype(np.float64) - box[:3]).prod()
    if not abs(volumes.sum() - volume) <= _VOLUME_ERROR * volume:
        raise ValueError("the sectors do not tile their bounding box")
    if bins.size == 0 or bins.max() >= SECTOR_ROWS * count or (bins % SECTOR_ROWS).any():
        raise ValueError("a bin has no sector")
    _check_links(rows[SECTOR_ROWS * count :], sectors[:, 8:14], boxes, box)
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


def _targets(links: NDArray[np.uint32], sector_count: int, node_count: int) -> NDArray[np.int32]:
    """The vertices that links lead to: sectors first, then link nodes; -1 for nowhere."""
    first_node = SECTOR_ROWS * sector_count
    row, is_node = (links & ~np.uint32(NODE_BIT)).view(np.int32), links >= NODE_BIT
    is_sector = ~is_node & (row < first_node) & (row % SECTOR_ROWS == 0)
    is_valid = is_sector | is_node & (row >= first_node) & (row - first_node < node_count)
    if not (is_valid | (links == VOID)).all():
        raise ValueError("a link is out of range")
    targets = np.where(is_node, row - first_node + sector_count, row // SECTOR_ROWS)
    return np.where(links == VOID, -1, targets).astype(np.int32)


def _check_links(
    nodes: NDArray[np.uint32],
    links: NDArray[np.uint32],
    boxes: NDArray[np.float32],
    box: NDArray[np.float32],
) -> None:
    """Check the links of nodes and sectors.

    Parameters
    ----------
    nodes : ndarray of shape (N, 4), uint32
        See `GraphArrays.rows`.
    links : ndarray of shape (S, 6), uint32
        Of the sectors' faces.
    boxes : ndarray of shape (S, 6), float32
        Low x, y, z, high x, y, z of the sectors.
    box : ndarray of shape (6,), float32
        The same of all.
    """
    node_count, count = len(nodes), len(boxes)
    inner = _targets(nodes[:, 2:], count, node_count)
    later = np.arange(count, count + node_count)[:, None]
    if (nodes[:, 1] > 2).any() or (inner < 0).any() or (inner >= later).any():
        raise ValueError("a link node links to one that comes later, or to nowhere")
    sides = np.concatenate([boxes, np.empty((node_count, 6), np.float32)])
    hulls = sides.copy()
    planes = np.ascontiguousarray(nodes[:, 0]).view(np.float32)
    if not _fill_extents(nodes[:, 1].astype(np.int64), planes, inner, sides, hulls):
        raise ValueError("a link node's plane is not between what it links to")
    outer = _targets(links, count, node_count)
    # The sectors behind a face begin or end in its plane; a void face is at the side of the box.
    for face in range(6):
        axis, is_high = face >> 1, face & 1
        own, other = axis + 3 * is_high, axis + 3 * (1 - is_high)
        touching = np.where(outer[:, face] < 0, box[own], sides[outer[:, face], other])
        if (touching != boxes[:, own]).any():
            raise ValueError("a face links to sectors that do not touch it")

    # Rays of an octant leave through three faces, and leave a link node to either side.
    def check_octants(begin: int, end: int) -> None:
        for octant in range(begin, end):
            faces = [2 * axis + (octant >> axis & 1) for axis in range(3)]
            ahead = np.full((count + node_count, 3), -1, np.int32)
            ahead[:count], ahead[count:, :2] = outer[:, faces], inner
            if not _is_acyclic(ahead):
                raise ValueError("the links form a cycle")

    _is_acyclic(np.zeros((0, 3), np.int32))  # compiled before threads start
    parallel_for(check_octants, 8, 1)

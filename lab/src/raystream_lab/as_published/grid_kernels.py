"""Purcell's kernels on a grid: a 3D-DDA that adds up distances, and the printed triangle test.

The intersector is Figure 5 of Purcell 2002, with the check of section 3.1.3 that a hit lies in the
voxel. The traverser is not printed: it is the 3D-DDA that the paper refers to, with one record per
ray of the size of Table 1.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from raystream.jit.constants import SHIFT_32
from raystream.jit.cpu import device
from raystream.jit.simd import load
from raystream.kernels.search import put_hit
from raystream.machines.records import DONE, INTERSECTING, SHADING, TRAVERSING, RayState
from raystream.machines.steps.base import StepKernel, Steps
from raystream.structures.grid.cells import cell_list
from raystream.structures.grid.structure import GridStructure
from raystream_lab.as_published.triangle import PrintedHit, intersect_triangle, vertex_at

#: The state of a ray between passes. `cell` and `t_next` are those of the next step; `list_pos` to
#: `list_end` are the references of the voxel that the ray is in, and `t_exit` where it leaves it.
WALK = np.dtype(
    [
        ("cell", np.int32, 3),
        ("t_next", np.float32, 3),
        ("t_delta", np.float32, 3),
        ("list_pos", np.uint32),
        ("list_end", np.uint32),
        ("t_exit", np.float32),
        ("hit", np.float32, 3),
        ("prim_id", np.int32),
    ]
)

_TRIANGLE = np.uint64(36)
_SECOND, _THIRD = np.uint64(12), np.uint64(24)
_ZERO, _ONE, _INF = np.float32(0.0), np.float32(1.0), np.float32(np.inf)
_NOWHERE = np.uint32(0)
_MISS = np.int32(-1)


class Textures(NamedTuple):
    """The grid and its triangles (Purcell 2002, Figure 4).

    Attributes
    ----------
    low, high, size, counts : triple of float32
    splits, references, corners : uint64
        Addresses: see `structures.grid.layout.GridAddresses`.
    """

    low: tuple[np.float32, np.float32, np.float32]
    high: tuple[np.float32, np.float32, np.float32]
    size: tuple[np.float32, np.float32, np.float32]
    counts: tuple[np.float32, np.float32, np.float32]
    splits: np.uint64
    references: np.uint64
    corners: np.uint64


@device
def _slab(o, d, low, high, t_in, t_out):
    near, far = (low - o) / d, (high - o) / d
    # In this order, so that a NaN changes nothing.
    return max(t_in, min(near, far)), min(t_out, max(near, far))


@device
def _begin(o, d, t_in, low, size, count):
    """The cell along an axis, and the distances of its end and of a whole cell."""
    place = (o + t_in * d - low) / size if size > _ZERO else _ZERO
    cell = min(max(np.float32(np.floor(place)), _ZERO), count - _ONE)
    if d == _ZERO:
        return np.int32(cell), _INF, _INF
    end = cell + _ONE if d > _ZERO else cell
    return np.int32(cell), (low + end * size - o) / d, size / abs(d)


def set_up(ray, tree):
    """Find the first voxel, and the DDA's distances."""
    o, d = ray.origin, ray.direction
    t_in, t_out = ray.t_min, ray.t_max
    t_in, t_out = _slab(o[0], d[0], tree.low[0], tree.high[0], t_in, t_out)
    t_in, t_out = _slab(o[1], d[1], tree.low[1], tree.high[1], t_in, t_out)
    t_in, t_out = _slab(o[2], d[2], tree.low[2], tree.high[2], t_in, t_out)
    i, x, step_x = _begin(o[0], d[0], t_in, tree.low[0], tree.size[0], tree.counts[0])
    j, y, step_y = _begin(o[1], d[1], t_in, tree.low[1], tree.size[1], tree.counts[1])
    k, z, step_z = _begin(o[2], d[2], t_in, tree.low[2], tree.size[2], tree.counts[2])
    hit = (ray.t_max, _ZERO, _ZERO)
    place = ((i, j, k), (x, y, z), (step_x, step_y, step_z), _NOWHERE, _NOWHERE, _ZERO, hit, _MISS)
    is_active = tree.splits != np.uint64(0) and t_in <= t_out
    return place, TRAVERSING if is_active else DONE


@device
def _is_inside(cell, counts):
    return (
        cell[0] >= 0
        and cell[1] >= 0
        and cell[2] >= 0
        and cell[0] < np.int32(counts[0])
        and cell[1] < np.int32(counts[1])
        and cell[2] < np.int32(counts[2])
    )


@device
def _sign(d):
    return np.int32(1) if d > _ZERO else np.int32(-1)


def traverse(ray, place, tree):
    """Look a ray's voxel up, and step to the next one."""
    cell, t_next, delta, d = place.cell, place.t_next, place.t_delta, ray.direction
    hit = place.hit
    i, j, k = cell[0], cell[1], cell[2]
    x, y, z = t_next[0], t_next[1], t_next[2]
    state, row, end, t_exit = DONE, _NOWHERE, _NOWHERE, _ZERO
    if _is_inside((i, j, k), tree.counts):
        nx, ny = np.int64(tree.counts[0]), np.int64(tree.counts[1])
        first, last = cell_list(tree.splits, np.int64(i) + nx * (np.int64(j) + ny * np.int64(k)))
        row, end = np.uint32(first), np.uint32(last)
        state = TRAVERSING if row == end else INTERSECTING
        t_exit = min(x, y, z)
        if t_exit == x:
            i, x = i + _sign(d[0]), x + delta[0]
        elif t_exit == y:
            j, y = j + _sign(d[1]), y + delta[1]
        else:
            k, z = k + _sign(d[2]), z + delta[2]
        if not _is_inside((i, j, k), tree.counts):
            t_exit = _INF  # what rounds to beyond the grid's faces is in its last voxel
    place = (
        (i, j, k),
        (x, y, z),
        (delta[0], delta[1], delta[2]),
        row,
        end,
        t_exit,
        (hit[0], hit[1], hit[2]),
        place.prim_id,
    )
    return place, state


def intersect(ray, place, tree):
    """Test one triangle of a ray's voxel."""
    cell, t_next, delta = place.cell, place.t_next, place.t_delta
    o, d, hit = ray.origin, ray.direction, place.hit
    tri_id = load(np.int32, tree.references + (np.uint64(place.list_pos) << SHIFT_32))
    at = tree.corners + np.uint64(tri_id) * _TRIANGLE
    v0, v1, v2 = vertex_at(at), vertex_at(at + _SECOND), vertex_at(at + _THIRD)
    h = PrintedHit(hit[0], hit[1], hit[2], place.prim_id)
    found = intersect_triangle((o[0], o[1], o[2]), (d[0], d[1], d[2]), v0, v1, v2, tri_id, h)
    if found.t <= place.t_exit:  # else outside the voxel: a miss
        h = found
    list_pos = np.uint32(place.list_pos + np.uint32(1))
    state = INTERSECTING
    if list_pos == place.list_end:
        state = SHADING if h.prim_id >= 0 else TRAVERSING
    place = (
        (cell[0], cell[1], cell[2]),
        (t_next[0], t_next[1], t_next[2]),
        (delta[0], delta[1], delta[2]),
        list_pos,
        place.list_end,
        place.t_exit,
        (h.t, h.u, h.v),
        h.prim_id,
    )
    return place, state


def shade(wanted, place, query):
    """Write a ray's hit."""
    put_hit(query.hits, wanted.first, place.hit[0], place.hit[1], place.hit[2], place.prim_id)
    return DONE


_KERNELS = (
    StepKernel("set up", RayState.STARTING, device(set_up), ("place",)),
    StepKernel("traverse", RayState.TRAVERSING, device(traverse), ("place",)),
    StepKernel("intersect", RayState.INTERSECTING, device(intersect), ("place",)),
    StepKernel("shade", RayState.SHADING, device(shade), ()),
)


def grid_steps(grid: GridStructure) -> Steps:
    """Purcell's kernels on a grid of one level, for first hits.

    Raises
    ------
    ValueError
        If the grid has two levels.
    """
    if grid.options.levels != 1:
        raise ValueError(f"levels: expected 1, got {grid.options.levels}")
    own = grid.view
    textures = Textures(
        own.low, own.high, own.size, own.counts, own.splits, own.references, own.corners
    )
    return Steps(_KERNELS, WALK, textures)

"""Walking through a lattice of cells (DDA): set-up and step.

The walk assigns each distance t along a ray to one cell. Along an axis, the ray passes plane p
at ``D(p) = fma(p, inv, middle)``, which is monotone in p; it is in the cell between two planes
while D(first) <= t < D(second). The first cell of an axis extends infinitely backward, and the
last one forward. Distances come from the planes' positions and are never accumulated, so each t
is in exactly one cell, whatever the rounding, and cells come by increasing t.

Sources: Amanatides and Woo, "A Fast Voxel Traversal Algorithm for Ray Tracing", Eurographics
1987; Purcell 2002, section 3.1.3.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from raystream.jit.constants import INF_F32, ONE_F32, ZERO_F32
from raystream.jit.cpu import device
from raystream.jit.simd import copy_sign, floor, fma
from raystream.kernels.ray import component
from raystream.structures.plane_distances import split_ray


class Walk(NamedTuple):
    """The constants of a ray's walk through a lattice; triples are in world order.

    Attributes
    ----------
    low, size : triple of float32
        Of the lattice.
    inv, middle : triple of float32
        A plane's distance is ``fma(plane, inv, middle)``.
    end : triple of float32
        Index of the last plane, which the ray never passes.
    step : triple of float32
        From the index of a plane to the next one: 1 or -1.
    stride : triple of int64
        From the number of a cell to the next one.
    """

    low: object
    size: object
    inv: object
    middle: object
    end: object
    step: object
    stride: object


class WalkState(NamedTuple):
    """The state of a walk.

    Attributes
    ----------
    cell : int64
        Number of the cell.
    t_next : triple of float32
        Distance of the next plane for each axis; inf for the last one.
    plane : triple of float32
        Index of the plane after that.
    t_after : triple of float32
        Its distance: known a step ahead, so that no step waits for it.
    """

    cell: object
    t_next: object
    plane: object
    t_after: object


@device
def _distance(number, low, size, inv, middle):
    """Distance at which a ray passes plane `number` of an axis."""
    return fma(fma(number, size, low), inv, middle)


@device
def _start(t, o, d, inv, middle, low, size, count):
    """The cell of an axis in which a ray is at distance t, as a float32."""
    step = copy_sign(ONE_F32, inv)
    ahead = ONE_F32 if step > ZERO_F32 else ZERO_F32
    first, last = ZERO_F32, count - ONE_F32
    if step < ZERO_F32:
        first, last = last, first
    # Step 1: a guess that is correct up to rounding. NaN, for a flat axis, becomes 0.
    guess = (fma(t, d, o) - low) / size
    guess = guess if guess > ZERO_F32 else ZERO_F32
    cell = floor(min(guess, count - ONE_F32))
    # Step 2: correct it by the rule above. One of the two loops does nothing.
    while cell != last and _distance(cell + ahead, low, size, inv, middle) <= t:
        cell += step
    behind = ONE_F32 - ahead
    while cell != first and _distance(cell + behind, low, size, inv, middle) > t:
        cell -= step
    return cell


@device
def begin_walk(lattice, ray, t):
    """Begin a walk at distance t.

    Parameters
    ----------
    lattice : NamedTuple
        With `low`, `size` and `counts`, each a triple of float32.
    ray : Ray
    t : float32
        Finite.

    Returns
    -------
    Walk
    WalkState
    """
    walk = prepare_walk(lattice, ray)
    return walk, first_state(lattice, walk, ray, t)


@device
def prepare_walk(lattice, ray):
    """The constants of a walk; see `begin_walk`."""
    low, size, counts = lattice.low, lattice.size, lattice.counts
    line = split_ray(ray)
    inv = (line.inv_x, line.inv_y, line.inv_z)
    middle = (line.middle_x, line.middle_y, line.middle_z)
    step = (
        copy_sign(ONE_F32, inv[0]),
        copy_sign(ONE_F32, inv[1]),
        copy_sign(ONE_F32, inv[2]),
    )
    end = (
        counts[0] if step[0] > ZERO_F32 else ZERO_F32,
        counts[1] if step[1] > ZERO_F32 else ZERO_F32,
        counts[2] if step[2] > ZERO_F32 else ZERO_F32,
    )
    row, layer = np.int64(counts[0]), np.int64(counts[0]) * np.int64(counts[1])
    stride = (
        np.int64(step[0]),
        row if step[1] > ZERO_F32 else -row,
        layer if step[2] > ZERO_F32 else -layer,
    )
    return Walk(low, size, inv, middle, end, step, stride)


@device
def first_state(lattice, walk, ray, t):
    """The first state of a walk; see `begin_walk`."""
    low, size, counts = lattice.low, lattice.size, lattice.counts
    kz = ray.kz
    o = (
        component(kz, ray.oz, ray.oy, ray.ox),
        component(kz, ray.ox, ray.oz, ray.oy),
        component(kz, ray.oy, ray.ox, ray.oz),
    )
    d = (
        component(kz, ray.dz, ray.dy, ray.dx),
        component(kz, ray.dx, ray.dz, ray.dy),
        component(kz, ray.dy, ray.dx, ray.dz),
    )
    inv, middle = walk.inv, walk.middle
    i = _start(t, o[0], d[0], inv[0], middle[0], low[0], size[0], counts[0])
    j = _start(t, o[1], d[1], inv[1], middle[1], low[1], size[1], counts[1])
    k = _start(t, o[2], d[2], inv[2], middle[2], low[2], size[2], counts[2])
    return state_at(lattice, walk, i, j, k)


@device
def state_at(lattice, walk, i, j, k):
    """The state of a walk in the cell with indices i, j and k (float32)."""
    row, layer = (
        np.int64(lattice.counts[0]),
        np.int64(lattice.counts[0]) * np.int64(lattice.counts[1]),
    )
    cell = np.int64(i) + row * np.int64(j) + layer * np.int64(k)
    step = walk.step
    first = (
        i + max(step[0], ZERO_F32),
        j + max(step[1], ZERO_F32),
        k + max(step[2], ZERO_F32),
    )
    second = (first[0] + step[0], first[1] + step[1], first[2] + step[2])
    return WalkState(cell, _distances(walk, first), second, _distances(walk, second))


@device
def _next(plane, end, low, size, inv, middle):
    """Distance of the next plane; inf for the last one."""
    return INF_F32 if plane == end else _distance(plane, low, size, inv, middle)


@device
def _distances(walk, plane):
    low, size, inv, middle = walk.low, walk.size, walk.inv, walk.middle
    return (
        _next(plane[0], walk.end[0], low[0], size[0], inv[0], middle[0]),
        _next(plane[1], walk.end[1], low[1], size[1], inv[1], middle[1]),
        _next(plane[2], walk.end[2], low[2], size[2], inv[2], middle[2]),
    )


@device
def cell_end(state):
    """Distance at which the ray leaves its cell; inf where it never does."""
    return min(state.t_next[0], state.t_next[1], state.t_next[2])


@device
def step_walk(walk, state):
    """Step to the next cell: across all planes that the ray passes at the cell's end.

    Must not be called if `cell_end` is inf.
    """
    t = cell_end(state)
    cell = state.cell
    t_x, t_y, t_z = state.t_next
    plane_x, plane_y, plane_z = state.plane
    if t_x <= t:
        t_x = state.t_after[0]
        cell += walk.stride[0]
        plane_x += walk.step[0]
    if t_y <= t:
        t_y = state.t_after[1]
        cell += walk.stride[1]
        plane_y += walk.step[1]
    if t_z <= t:
        t_z = state.t_after[2]
        cell += walk.stride[2]
        plane_z += walk.step[2]
    plane = (plane_x, plane_y, plane_z)
    return WalkState(cell, (t_x, t_y, t_z), plane, _distances(walk, plane))

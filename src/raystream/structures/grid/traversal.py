"""One ray through a grid: the functions of a cell, and the loop that joins them."""

from __future__ import annotations

import numpy as np

from raystream.jit.cpu import device
from raystream.jit.intrinsics import corners_at
from raystream.jit.simd import load
from raystream.kernels.collect import keep_hit
from raystream.kernels.slab import box_interval
from raystream.kernels.triangle import intersect
from raystream.structures.grid.dda import cell_end, set_up_walk, step_walk

__all__ = ["STACK_BYTES", "cell_list", "enter_grid", "intersect_list", "traverse"]

#: A grid needs no stack.
STACK_BYTES = 1

_NONE = np.uint64(0)
_ONE = np.uint64(1)
_WORD = np.uint64(2)  # a number's four bytes, as a shift
_INF = np.float32(np.inf)


@device
def enter_grid(grid, ray, t_min, t_max):
    """The part of a ray's interval in which it can hit anything; empty if t_in > t_out.

    Every triangle's box is inside the grid's, so every hit is in the interval of that one.
    """
    low, high = grid.low, grid.high
    t_in, t_out = box_interval(ray, low[0], low[1], low[2], high[0], high[1], high[2])
    return max(t_min, t_in), min(t_max, t_out)


@device
def cell_list(grid, cell):
    """Where the list of a cell begins and ends."""
    at = grid.splits + (np.uint64(cell) << _WORD)
    return np.uint64(load(np.uint32, at)), np.uint64(load(np.uint32, at + np.uint64(4)))


@device
def intersect_list(
    grid, ray, begin, end, t_in, t_out, t_far, surfaces, keep, count, capacity, first, out
):
    """Test the triangles of a cell against a ray.

    Parameters
    ----------
    grid : GridAddresses
    ray : Ray
    begin, end : uint64
        See `cell_list`.
    t_in, t_out : float32
        A hit counts where t_in <= t < t_out. Outside, it is another cell's.
    t_far : float32
        Hits beyond are not wanted.
    surfaces, keep, count, capacity, first, out
        See `kernels.leaf.test_triangles`.

    Returns
    -------
    count : uint64
    t_far : float32
        Hits beyond are no longer wanted.
    """
    at, stop = grid.references + (begin << _WORD), grid.references + (end << _WORD)
    corners = corners_at(grid.corners)
    while at != stop:
        prim_id = load(np.int32, at)
        at += np.uint64(4)
        hit, t, u, v = intersect(ray, corners, np.uint64(prim_id), surfaces)
        # Written so that a NaN would fail.
        if hit and t >= t_in and t < t_out and t <= t_far:
            if keep:
                count, t_far = keep_hit(out, first, count, capacity, t, u, v, prim_id, t_far)
            else:
                count += _ONE
                if count == capacity:
                    break
    return count, t_far


@device
def traverse(grid, ray, t_min, t_max, surfaces, keep, capacity, first, out, stack, seen):
    """Visit the cells along a ray; see `kernels.queries.ray_queries` for the arguments."""
    count = _NONE
    t_in, t_far = enter_grid(grid, ray, t_min, t_max)
    if grid.splits == _NONE or not (t_in <= t_far):
        return count
    # Whoever wants one hit, no matter which, takes it from wherever it is.
    is_any = capacity == _ONE and not keep
    walk, state = set_up_walk(grid, ray, t_in)
    while True:
        t_out = cell_end(state)
        begin, end = cell_list(grid, state.cell)
        if begin != end:
            last = _INF if is_any else t_out
            count, t_far = intersect_list(
                grid,
                ray,
                begin,
                end,
                t_in,
                last,
                t_far,
                surfaces,
                keep,
                count,
                capacity,
                first,
                out,
            )
            if not keep and count == capacity:
                break
        # A hit at the cell's end is in the next cell, and may tie with one at t_far.
        if t_far < t_out:
            break
        state = step_walk(walk, state)
        t_in = t_out
    return count

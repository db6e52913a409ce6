"""Where lines enter a scene's box, for origins far outside: one ray, or sixteen as vectors."""

from __future__ import annotations

import numpy as np

from raystream.jit.constants import INF_F64, ZERO_F64
from raystream.jit.cpu import device, device_call
from raystream.jit.intrinsics import no_inline
from raystream.jit.simd import maximum, minimum, select


@device
def _outside_axis(o, low, high):
    return maximum(np.float64(low) - o, o - np.float64(high))


@device
def outside_by(origin, frame):
    """Distance of an origin of numbers or vectors from the scene's box; negative inside."""
    low, high = frame.low, frame.high
    x = _outside_axis(origin[0], low[0], high[0])
    y = _outside_axis(origin[1], low[1], high[1])
    return maximum(maximum(x, y), _outside_axis(origin[2], low[2], high[2]))


@device
def _crossing(o, d, low, high, margin):
    """Interval (t_in, t_out) of a line between two planes that a margin moves apart."""
    to_low = (np.float64(low) - margin) - o
    to_high = (np.float64(high) + margin) - o
    t_low, t_high = to_low / d, to_high / d
    # A line along the planes is between them everywhere, or nowhere.
    is_along = d == ZERO_F64
    is_beside = is_along & ((to_low > ZERO_F64) | (to_high < ZERO_F64))
    t_in = select(is_along, -INF_F64, minimum(t_low, t_high))
    t_out = select(is_along, INF_F64, maximum(t_low, t_high))
    return select(is_beside, INF_F64, t_in), select(is_beside, -INF_F64, t_out)


@device
def box_entry(origin, direction, frame):
    """Distance at which a line, or sixteen, enter the scene's box, padded by its size.

    inf for a miss.
    """
    margin = np.float64(frame.max_coordinate)
    low, high = frame.low, frame.high
    in_x, out_x = _crossing(origin[0], direction[0], low[0], high[0], margin)
    in_y, out_y = _crossing(origin[1], direction[1], low[1], high[1], margin)
    in_z, out_z = _crossing(origin[2], direction[2], low[2], high[2], margin)
    t_in = maximum(maximum(in_x, in_y), in_z)
    t_out = minimum(minimum(out_x, out_y), out_z)
    return select(t_in <= t_out, t_in, INF_F64)


@device
def advanced(origin, direction, step):
    """An origin of numbers or vectors, moved along its direction."""
    (x, y, z), (dx, dy, dz) = origin, direction
    return x + step * dx, y + step * dy, z + step * dz


@device_call
def entry_of_one(origin, direction, frame):
    """`box_entry` of a ray, not inlined."""
    no_inline()
    return box_entry(origin, direction, frame)

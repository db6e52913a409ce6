"""The nearest hit of a ray so far: an interval of its distance, which is resolved when it must be.

Hits are ordered by the distance that is rounded from the exact one, then by prim_id. Most hits are
told apart by intervals; the distance of one in doubt is computed then, and the others never.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from raystream.geometry.float64.exact import solve_exactly
from raystream.jit.constants import ZERO_U64
from raystream.jit.cpu import device, device_call
from raystream.jit.intrinsics import no_inline

#: prim_id of a ray without a hit: the greatest number.
NO_PRIM = np.int32(2**31 - 1)


class Nearest(NamedTuple):
    """The nearest hit so far.

    Attributes
    ----------
    low, t_far : float64
        The distance lies between; hits beyond are not wanted. Equal if it was resolved. Without a
        hit, both are the end of the ray's interval.
    triangle : uint64
        Address of the triangle's first number; 0 without a hit.
    prim_id : int32
    """

    low: np.float64
    t_far: np.float64
    triangle: np.uint64
    prim_id: np.int32


@device
def no_hit(t_max):
    """No hit yet."""
    return Nearest(t_max, t_max, ZERO_U64, NO_PRIM)


@device
def within(line, low, high):
    """Whether a distance between `low` and `high` is in the ray's interval for sure.

    `line` is a `Line`, or a group of rays, with vectors of distances.
    """
    return (low >= line.t_min) & (high <= line.t_max)


@device_call
def _break_tie(line, best, span, triangle, prim_id):
    """Offer a hit that is in doubt; see `offer`."""
    no_inline()
    low, high, is_sure = span
    if not is_sure or not within(line, low, high):
        is_hit, t, _, _ = solve_exactly(line, triangle, False)
        if not (is_hit and within(line, t, t)):
            return best
        low, high = t, t
    if low > best.t_far:
        return best
    if high < best.low:
        return Nearest(low, high, triangle, prim_id)
    if low != high:
        _, t, _, _ = solve_exactly(line, triangle, False)
        low, high = t, t
    if best.low != best.t_far:
        _, t, _, _ = solve_exactly(line, best.triangle, False)
        best = Nearest(t, t, best.triangle, best.prim_id)
    if low < best.low or (low == best.low and prim_id < best.prim_id):
        return Nearest(low, high, triangle, prim_id)
    return best


@device
def offer(line, best, span, triangle, prim_id):
    """Keep a hit if it is the nearest.

    Parameters
    ----------
    line : Line
    best : Nearest
    span : tuple
        Its distance lies between two float64; and whether the triangle is hit for sure.
    triangle : uint64
    prim_id : int32

    Returns
    -------
    Nearest
    """
    low, high, is_sure = span
    if is_sure and within(line, low, high):
        if low > best.t_far:
            return best
        if high < best.low:
            return Nearest(low, high, triangle, prim_id)
    return _break_tie(line, best, span, triangle, prim_id)


@device_call
def _is_counted(line, triangle, surfaces):
    """Whether a triangle that may be hit is hit, in the ray's interval."""
    no_inline()
    is_hit, t, _, _ = solve_exactly(line, triangle, surfaces)
    return is_hit and within(line, t, t)


@device
def exists(line, span, triangle, surfaces):
    """The same for a hit with a `span`, see `offer`: exactly only if it is in doubt."""
    low, high, is_sure = span
    return (is_sure and within(line, low, high)) or _is_counted(line, triangle, surfaces)

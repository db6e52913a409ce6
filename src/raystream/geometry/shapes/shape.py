"""The test of a shape against a ray: the user's function in float64, rounded once.

As for spheres, t is clamped to the padded slab interval of the shape's own box. So a hit lies in
the interval of every box that holds the shape, and a tree leaves out no hit.
"""

from __future__ import annotations

import numpy as np

from raystream.core.shapes import SLACK
from raystream.jit.constants import ONE_U64, SHIFT_64, ZERO_F32
from raystream.jit.cpu import device
from raystream.jit.simd import as_float32, load, scratch
from raystream.kernels.search import is_full, offer
from raystream.kernels.shapes import CROSSINGS_BYTES, ShapeRecord, crossings, place
from raystream.kernels.slab import box_interval
from raystream.kernels.tally import TESTS, add_to
from raystream.structures.bvh.node_layout import leaf_address

#: A shape's own box, float32, is grown by these parts of its longest side and of its largest
#: coordinate: twice the slack that crossings have, and four times the rounding of its corners.
_OF_SIDE, _OF_COORDINATE = 2.0 * SLACK, 2.0**-22


def reach_of(side, coordinate):
    """By how much a shape's box is grown, for numbers or arrays: local frame."""
    return side * _OF_SIDE + coordinate * _OF_COORDINATE


_reach_of = device(reach_of)


@device
def shape_of(shapes, child):
    """The shape of a leaf."""
    return ShapeRecord(leaf_address(shapes, child))


@device
def own_box(own, frame):
    """Low and high corners of a shape's grown box, float32, local frame."""
    (a, b, c), (d, e, f) = own.low, own.high
    (x, y, z), scale = frame.center, np.float64(frame.scale)
    a, b, c = (a - x) * scale, (b - y) * scale, (c - z) * scale
    d, e, f = (d - x) * scale, (e - y) * scale, (f - z) * scale
    low, high = min(min(a, b), c), max(max(d, e), f)
    reach = _reach_of(max(max(d - a, e - b), f - c), max(abs(low), abs(high)))
    return (
        (as_float32(a - reach), as_float32(b - reach), as_float32(c - reach)),
        (as_float32(d + reach), as_float32(e + reach), as_float32(f + reach)),
    )


@device
def local_t(t, exact, t_in, t_out):
    """A distance of a user's function in the local frame: float32, within the box."""
    local = as_float32(t * exact.scale - exact.offset)
    return min(max(local, t_in), t_out) + ZERO_F32  # adding zero turns -0 into 0


@device
def place_at(own, exact, t):
    """The u and v of a hit at a distance of a user's function."""
    (x, y, z), (dx, dy, dz) = exact.origin, exact.direction
    return place(own, x + t * dx, y + t * dy, z + t * dz)


@device
def intersect_shape(own, ray, exact, search):
    """Offer the hits of a ray with a shape to a search.

    Parameters
    ----------
    own : ShapeRecord
    ray : Ray
    exact : ExactRay
        The same one.
    search : Search

    Returns
    -------
    Search
    """
    add_to(search.counters, TESTS, ONE_U64)
    low, high = own_box(own, exact)
    t_in, t_out = box_interval(ray, *low, *high)
    if not (t_in <= t_out and t_in <= search.t_far and t_out >= search.t_min):
        return search
    found = scratch(CROSSINGS_BYTES)
    for k in range(crossings(own, exact.origin, exact.direction, found)):
        exact_t = load(np.float64, found + (k << SHIFT_64))
        t = local_t(exact_t, exact, t_in, t_out)
        if t < search.t_min or t > search.t_far:
            continue
        u, v = place_at(own, exact, exact_t)
        search = offer(search, t, u, v, np.int32(own.number + np.int32(k)))
        if is_full(search):
            break
    return search

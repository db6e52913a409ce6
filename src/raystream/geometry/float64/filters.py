"""Filters in float64: a hit is asked for before it is compared, and its digits only if need be.

Masks and skipped triangles need the ray and the triangle alone. A filter's function is asked for
one hit at a time, solved exactly.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from raystream.geometry.float64.exact import solve_exactly
from raystream.geometry.float64.ray import Lengths, reported
from raystream.geometry.float64.search import within
from raystream.jit.constants import NULL, ONE_U64, ZERO_U64
from raystream.jit.cpu import device, device_call
from raystream.jit.intrinsics import no_inline
from raystream.jit.simd import scratch, store
from raystream.kernels.hit_filter import FILTERED_BYTES, U_AT, V_AT, HitFilter, kept_hits, may_hit
from raystream.structures.bvh.packets.filters import lanes_that_may_hit
from raystream.structures.bvh.packets.rays import first_ray


class Float64Filter(NamedTuple):
    """The filter of one ray's hits.

    Attributes
    ----------
    filter : HitFilter
        Its function reads t, u and v in float64, of one hit.
    ray : uint64
        Index in the batch.
    lengths : Lengths
    """

    filter: HitFilter
    ray: np.uint64
    lengths: Lengths


@device
def filter_of(filter_, i, ray):
    """The `Float64Filter` of ray i, whose `Lengths` are given; None without a filter."""
    if filter_ is None:
        return None
    return Float64Filter(filter_, i, Lengths(ray.half, ray.rest))


@device
def filter_of_lane(filter_, lanes, g, k):
    """The same of ray k of group g, for a `PacketFilter` or None."""
    if filter_ is None:
        return None
    i, lengths = first_ray(filter_.places, g) + k, Lengths(lanes.half[k], lanes.rest[k])
    return Float64Filter(filter_.filter, i, lengths)


@device
def possible_lanes(filter_, found, prim_id, g):
    """Those lanes of a group that masks and skipped triangles leave, for a `PacketFilter` or None.

    Returns their mask, and whether a function is left to be asked.
    """
    if filter_ is None:
        return found, False
    own = filter_.filter
    return lanes_that_may_hit(
        own, found, prim_id, first_ray(filter_.places, g)
    ), own.function != NULL


@device_call
def _ask(filter_, line, span, triangle, prim_id, surfaces):
    """Call the function for a hit in doubt; see `kept_span`."""
    no_inline()
    is_hit, t, u, v = solve_exactly(line, triangle, surfaces)
    if not (is_hit and within(line, t, t)):
        return False, span
    hits = scratch(FILTERED_BYTES)
    store(hits, reported(t, filter_.lengths))
    store(hits + U_AT, u)
    store(hits + V_AT, v)
    kept = kept_hits(filter_.filter, ONE_U64, hits, prim_id, filter_.ray)
    return kept != ZERO_U64, (t, t, True)


@device
def _kept(function, filter_, line, span, triangle, prim_id, surfaces):
    if function is None:
        return True, span
    if function == NULL:
        return True, span
    return _ask(filter_, line, span, triangle, prim_id, surfaces)


@device
def kept_span(filter_, line, span, triangle, prim_id, surfaces):
    """Whether a filter keeps a hit, if there is one, and what is known of its distance now.

    Parameters
    ----------
    filter_ : Float64Filter or None
    line, span, triangle, prim_id
        See `search.offer`.
    surfaces : bool
        The rule at edges and vertices, see `kernels.triangle.intersect`.

    Returns
    -------
    is_kept : bool
    span : tuple
    """
    if filter_ is None:
        return True, span
    own = filter_.filter
    if not may_hit(own, filter_.ray, prim_id):
        return False, span
    return _kept(own.function, filter_, line, span, triangle, prim_id, surfaces)

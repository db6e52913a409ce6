"""Filters in traversals: whether a hit exists is asked where it is found.

A filter is called by its address, so a traversal is compiled once for all of them. It gets numbers
only; whatever else it reads lies at the address of its context, whose first number it sets if it
raises: see `raystream.programs.filters_at_hits`, which makes both.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from raystream.jit.cpu import device, device_call
from raystream.jit.intrinsics import call_filter, no_inline
from raystream.jit.simd import count_trailing_zeros, load
from raystream.kernels.ray import world_t

__all__ = ["HitFilter", "RayFilter", "any_kept", "is_kept", "keeps"]

_NONE, _ONE = np.uint64(0), np.uint64(1)
_WORD = np.uint64(4)


class HitFilter(NamedTuple):
    """The hits that a query ignores, by address; the caller keeps what is there alive.

    Attributes
    ----------
    function : uint64
        Address of the filter's code; 0 if there is none.
    context : uint64
        Its first argument.
    skipped : uint64
        Address of the triangles that the first ray skips, int32; -1 skips nothing.
    skip_count : uint64
        Triangles per ray; 0 if rays skip none.
    """

    function: np.uint64
    context: np.uint64
    skipped: np.uint64
    skip_count: np.uint64


class RayFilter(NamedTuple):
    """The filter of one ray's hits.

    Attributes
    ----------
    filter : HitFilter
    ray : uint64
        Index in the batch.
    t_scale, t_offset : float64
        To distances in world direction lengths.
    """

    filter: HitFilter
    ray: np.uint64
    t_scale: np.float64
    t_offset: np.float64


@device
def _is_skipped(filter_, ray, prim_id):
    at = filter_.skipped + ray * filter_.skip_count * _WORD
    end = at + filter_.skip_count * _WORD
    while at != end:
        if load(np.int32, at) == prim_id:
            return True
        at += _WORD
    return False


@device_call
def is_kept(filter_, ray, t, t_scale, t_offset, u, v, prim_id):
    """Whether a hit exists.

    Parameters
    ----------
    filter_ : HitFilter
    ray : uint64
        Index in the batch.
    t : float32
        Local.
    t_scale, t_offset : float64
        To the distance in world direction lengths, which the filter gets.
    u, v : float32
    prim_id : int32
    """
    no_inline()
    if _is_skipped(filter_, ray, prim_id):
        return False
    if filter_.function == _NONE:
        return True
    t = world_t(t, t_scale, t_offset)
    return call_filter(filter_.function, (filter_.context, ray, t, u, v, prim_id))


@device
def keeps(filter_, t, u, v, prim_id):
    """Whether a ray's hit exists, for a `RayFilter`; without one, given None, all do."""
    if filter_ is None:
        return True
    own, ray = filter_.filter, filter_.ray
    return is_kept(own, ray, t, filter_.t_scale, filter_.t_offset, u, v, prim_id)


@device
def any_kept(filter_, block, bits, lanes):
    """Whether one of a ray's hits in a block exists; see `keeps`.

    Parameters
    ----------
    filter_ : RayFilter or None
    block : view of leaf_block.Block
    bits : uint64
        Bits of the lanes that are hit, at least one.
    lanes : view of leaf_block.HitLanes
    """
    if filter_ is None:
        return True
    while bits != _NONE:
        lane = count_trailing_zeros(bits)
        bits &= bits - _ONE
        if keeps(filter_, lanes.t[lane], lanes.u[lane], lanes.v[lane], block.prim_ids[lane]):
            return True
    return False

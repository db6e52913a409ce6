"""Filters in traversals: whether a hit exists is asked where it is found.

A filter is called by its address, so a traversal is compiled once for all of them. It gets the hits
of some rays with one triangle. Whatever else it reads lies at the address of its context, whose
first number becomes 1 if it raises: see `raystream.programs.filters_at_hits`, which makes both.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from raystream.core.store import Store
from raystream.jit.constants import BYTES_32, NULL, ONE_U64, ZERO_U64
from raystream.jit.cpu import device, device_call
from raystream.jit.intrinsics import call_filter, no_inline
from raystream.jit.simd import count_trailing_zeros, load, scratch, store
from raystream.kernels.masks import has_bit, is_admitted
from raystream.kernels.ray import world_t

#: Bytes of 16 hits as filters read them, and where their u and v are.
FILTERED_BYTES = 192
U_AT, V_AT = np.uint64(64), np.uint64(128)


class HitFilter(NamedTuple):
    """The hits that a query ignores, by address; the caller keeps what is there alive.

    Attributes
    ----------
    function : uint64 or None
        Address of the filter's code; 0 if there is none, None where there cannot be one.
    context : uint64
        Its first argument.
    skipped : uint64
        Address of the triangles that the first ray skips, int32; -1 skips nothing.
    skip_count : uint64
        Triangles per ray; 0 if rays skip none.
    masks : uint64
        Address of a `masks.MaskTable` to ask at hits; 0 if none has to be asked.
    entered : uint64
        The same where a ray enters an instance.
    """

    function: np.uint64 | None
    context: np.uint64
    skipped: np.uint64
    skip_count: np.uint64
    masks: np.uint64
    entered: np.uint64


#: It ignores no hit.
NO_FILTER = HitFilter(NULL, NULL, NULL, ZERO_U64, NULL, NULL)


def masked(given: HitFilter, table: np.uint64, store: Store) -> HitFilter:
    """A filter that also asks for the masks of a `masks.MaskTable` at an address.

    Hits in an instance are not asked for if it has one mask, which its rays have passed.
    """
    return given._replace(masks=NULL if store.has_masks_by_instance else table, entered=table)


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
def _skips(filter_, ray, prim_id):
    """Whether a ray skips a triangle, for a `HitFilter`."""
    at = filter_.skipped + ray * filter_.skip_count * BYTES_32
    end = at + filter_.skip_count * BYTES_32
    while at != end:
        if load(np.int32, at) == prim_id:
            return True
        at += BYTES_32
    return False


@device
def may_hit(own, ray, number):
    """Whether masks and skipped triangles of a `HitFilter` let a ray hit what has a number."""
    if own.masks != NULL and not is_admitted(own.masks, ray, number):
        return False
    return own.skip_count == ZERO_U64 or not _skips(own, ray, number)


@device
def kept_hits(filter_, bits, hits, prim_id, first):
    """The hits of up to 16 consecutive rays with a triangle that exist, if none skips it.

    Parameters
    ----------
    filter_ : HitFilter
    bits : uint64
        Bits of the rays that hit it.
    hits : uint64
        Address of the hits: 16 t in world direction lengths, 16 u, 16 v.
    prim_id : int32
    first : uint64
        Batch index of the first ray.

    Returns
    -------
    uint64
        Bits of the hits that exist.
    """
    if filter_.function == NULL:
        return bits
    return call_filter(filter_.function, (filter_.context, bits, hits, prim_id, first))


@device_call
def _keeps(filter_, t, u, v, prim_id):
    no_inline()
    own = filter_.filter
    if _skips(own, filter_.ray, prim_id):
        return False
    hits = scratch(FILTERED_BYTES)
    store(hits, world_t(t, filter_.t_scale, filter_.t_offset))
    store(hits + U_AT, u)
    store(hits + V_AT, v)
    return kept_hits(own, ONE_U64, hits, prim_id, filter_.ray) != ZERO_U64


@device
def asks_at_hits(own):
    """Whether a `HitFilter` may ignore hits, not only rays that enter instances."""
    return own.masks != NULL or own.function != NULL or own.skip_count != ZERO_U64


@device
def keeps(filter_, t, u, v, prim_id):
    """Whether a ray's hit at a local t exists, for a `RayFilter`; all do if it is None."""
    if filter_ is None:
        return True
    own = filter_.filter
    # Masks are asked for without a call, which takes longer than they do.
    if own.masks != NULL and not is_admitted(own.masks, filter_.ray, prim_id):
        return False
    return _keeps_if_asked(own.function, filter_, t, u, v, prim_id)


@device
def _keeps_if_asked(function, filter_, t, u, v, prim_id):
    if function is None:
        return True
    if function == NULL and filter_.filter.skip_count == ZERO_U64:
        return True
    return _keeps(filter_, t, u, v, prim_id)


@device
def may_enter(filter_, mask):
    """Whether a ray may hit what has a mask, for a `RayFilter` or None."""
    if filter_ is None:
        return True
    own = filter_.filter
    return own.entered == NULL or has_bit(own.entered, filter_.ray, mask)


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
    while bits != ZERO_U64:
        lane = count_trailing_zeros(bits)
        bits &= bits - ONE_U64
        if keeps(filter_, lanes.t[lane], lanes.u[lane], lanes.v[lane], block.prim_ids[lane]):
            return True
    return False

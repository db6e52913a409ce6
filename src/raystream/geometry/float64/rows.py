"""Rows of hits in float64, by address: read, written, and kept in order as those of float32."""

from __future__ import annotations

import numpy as np

from raystream.geometry.float64.ray import reported
from raystream.jit.constants import SHIFT_32, SHIFT_64
from raystream.jit.copies import Copies
from raystream.jit.cpu import device
from raystream.jit.simd import load, store
from raystream.kernels.search import get_hit, offer, put_hit, sort_hits, t_of
from raystream.structures.bvh.packets import hits as packet_hits
from raystream.structures.bvh.packets import multi_hit as packet_multi_hit


@device
def row_t(out, row):
    """Read the t of a row's hit."""
    return load(np.float64, out.t + (row << SHIFT_64))


@device
def put_row(out, row, t, u, v, prim_id):
    """Write a hit to a row of `kernels.hits.HitAddresses`."""
    at = row << SHIFT_64
    store(out.t + at, t)
    store(out.u + at, u)
    store(out.v + at, v)
    store(out.prim_id + (row << SHIFT_32), prim_id)


@device
def get_row(out, row):
    """Read the hit of a row: t, u, v, prim_id."""
    at = row << SHIFT_64
    return (
        load(np.float64, out.t + at),
        load(np.float64, out.u + at),
        load(np.float64, out.v + at),
        load(np.int32, out.prim_id + (row << SHIFT_32)),
    )


@device
def _number_at(column, row):
    return column + (row << SHIFT_64)


@device
def tell_row(t, row, lengths):
    """Convert the t of a row to lengths of the given direction; see `ray.reported`."""
    at = _number_at(t, row)
    store(at, reported(load(np.float64, at), lengths))


#: What functions for rows of float32 call, and what their copies for float64 call instead.
FLOAT64_ROWS = {
    t_of: row_t,
    put_hit: put_row,
    get_hit: get_row,
    packet_hits.number_at: _number_at,
    packet_multi_hit.tell_row: tell_row,
}
_of_float64 = Copies("of_float64", FLOAT64_ROWS).of

#: Keep or count a hit: `kernels.search.offer`.
offer_row = _of_float64(offer)

#: Sort rows by t, then prim_id: `kernels.search.sort_hits`.
sort_rows = _of_float64(sort_hits)

#: Append hits of 16 rays, or of one: see `structures.bvh.packets.hits`.
collect = _of_float64(packet_hits.collect)
collect_one = _of_float64(packet_hits.collect_one)

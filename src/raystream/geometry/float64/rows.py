"""Rows of hits in float64, by address: read, written, and kept in order as those of float32."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from raystream.geometry.float64.ray import reported
from raystream.jit.constants import INF_F64, SHIFT_64
from raystream.jit.copies import Copies
from raystream.jit.cpu import device
from raystream.jit.simd import load, store
from raystream.kernels.ray import local_limit, world_t
from raystream.kernels.search import (
    ROW_NUMBER,
    ROW_SHIFT,
    enter_instance,
    leave_instance,
    offer,
    put_hit,
    sort_hits,
)
from raystream.structures.bvh.packets.hits import collect, collect_one
from raystream.structures.bvh.packets.multi_hit import tell_row

_LARGEST = np.float64(np.finfo(np.float64).max)
_STEP, _TINY = 2.0**-52, np.float64(np.finfo(np.float64).smallest_subnormal)


@device
def tell_float64_row(t, row, lengths):
    """Convert the t of a row to lengths of the given direction; see `ray.reported`."""
    at = t + (row << SHIFT_64)
    store(at, reported(load(np.float64, at), lengths))


@device
def float64_t(t, t_scale, t_offset):
    """The world distance of a hit in an instance: a power of two as much; see `world_t`."""
    return min(max(t * t_scale + t_offset, -_LARGEST), _LARGEST)


@device
def float64_limit(t, t_scale, t_offset):
    """See `kernels.ray.local_limit`: where the quotient is rounded, the next number above."""
    if t >= _LARGEST:
        return INF_F64
    limit = (t - t_offset) / t_scale
    return limit if limit * t_scale == t else limit + abs(limit) * _STEP + _TINY


def _constant(value: Any) -> Any:
    if value is ROW_NUMBER:
        return np.float64
    return SHIFT_64 if value is ROW_SHIFT else value


def rows_of_float64(instead: Mapping[Any, Any]) -> Copies:
    """Makes copies, for rows of float64, of functions for those of float32; see `Copies`."""
    own = {tell_row: tell_float64_row, world_t: float64_t, local_limit: float64_limit}
    return Copies("of_float64", {**own, **instead}, _constant)


_copy = rows_of_float64({}).of

#: See `kernels.search`, and `structures.bvh.packets.hits`.
put_row, offer_row, sort_rows = _copy(put_hit), _copy(offer), _copy(sort_hits)
enter_float64, leave_float64 = _copy(enter_instance), _copy(leave_instance)
collect_rows, collect_row = _copy(collect), _copy(collect_one)

"""Rows of hits in float64, by address: read, written, and kept in order as those of float32."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from raystream.geometry.float64.ray import reported
from raystream.jit.constants import SHIFT_64
from raystream.jit.copies import Copies
from raystream.jit.cpu import device
from raystream.jit.simd import load, store
from raystream.kernels.search import ROW_NUMBER, ROW_SHIFT, offer, put_hit, sort_hits
from raystream.structures.bvh.packets.hits import collect, collect_one
from raystream.structures.bvh.packets.multi_hit import tell_row


@device
def tell_float64_row(t, row, lengths):
    """Convert the t of a row to lengths of the given direction; see `ray.reported`."""
    at = t + (row << SHIFT_64)
    store(at, reported(load(np.float64, at), lengths))


def _constant(value: Any) -> Any:
    if value is ROW_NUMBER:
        return np.float64
    return SHIFT_64 if value is ROW_SHIFT else value


def rows_of_float64(instead: Mapping[Any, Any]) -> Copies:
    """Makes copies, for rows of float64, of functions for those of float32; see `Copies`."""
    return Copies("of_float64", {tell_row: tell_float64_row, **instead}, _constant)


_copy = rows_of_float64({}).of

#: See `kernels.search`, and `structures.bvh.packets.hits`.
put_row, offer_row, sort_rows = _copy(put_hit), _copy(offer), _copy(sort_hits)
collect_rows, collect_row = _copy(collect), _copy(collect_one)

"""Masks in kernels: one of a ray, or those of 16, against that of what they hit."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.core.masks import MaskRuns
from raystream.jit.constants import BYTES_32
from raystream.jit.cpu import device
from raystream.jit.simd import i32x16, load
from raystream.jit.views import view
from raystream.kernels.intervals import halvings_of, interval_of

#: The masks of a query: addresses of the first ray's, and bytes from one ray's to the next one's;
#: of the runs of `core.masks.MaskRuns`, their masks and number, and the steps of a search.
_NAMES = "rays", "step", "starts", "masks", "count", "halvings"
_Table = view([(name, "u8") for name in _NAMES])

#: Rays whose masks are read at once.
_LANES = 16


class MaskTable(NamedTuple):
    """The masks of a query's rays and geometry, in memory.

    Attributes
    ----------
    address : uint64
        Of the numbers that kernels read.
    kept : tuple
        Keeps alive what they read.
    """

    address: np.uint64
    kept: tuple[NDArray[Any], ...]

    @classmethod
    def of(cls, rays: NDArray[np.uint32], runs: MaskRuns) -> MaskTable:
        """For the masks of rays, one for each or one for all."""
        step = 4 if len(rays) > 1 else 0
        # Of the last rays' group, 16 lanes are read.
        padded = np.append(rays, np.full(_LANES, rays[-1]) if len(rays) else [])
        padded = np.ascontiguousarray(padded, np.uint32)
        count = len(runs.starts)
        at = [one.ctypes.data for one in (padded, *runs)]
        row = np.array([at[0], step, *at[1:], count, halvings_of(count)], np.uint64)
        return cls(np.uint64(row.ctypes.data), (row, padded, *runs))


@device
def _mask_of(table, number):
    """The mask of what has a number."""
    run = interval_of(table.starts, table.count, table.halvings, np.int64(number))
    return load(np.int32, table.masks + run * BYTES_32)


@device
def is_admitted(masks, ray, number):
    """Whether a ray may hit what has a number, by the address of a `MaskTable`."""
    table = _Table(masks)
    own = load(np.int32, table.rays + ray * table.step)
    return own & _mask_of(table, number) != np.int32(0)


@device
def admitted_lanes(masks, first, number):
    """The mask of those of 16 consecutive rays that may hit what has a number."""
    table = _Table(masks)
    own = load(i32x16, table.rays + first * table.step)
    return (own & i32x16(_mask_of(table, number))) != i32x16(np.int32(0))

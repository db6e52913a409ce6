"""Masks in kernels: one of a ray, or those of 16, against that of what they hit."""

from __future__ import annotations

from collections.abc import Sequence
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
        # Of the last rays' group, 16 lanes are read.
        padded = np.append(rays, np.full(_LANES, rays[-1]) if len(rays) else [])
        padded = np.ascontiguousarray(padded, np.uint32)
        row = mask_numbers([one.ctypes.data for one in (padded, *runs)], len(rays), runs)
        return cls(np.uint64(row.ctypes.data), (row, padded, *runs))


def mask_numbers(
    places: Sequence[int | np.uint64], ray_count: int, runs: MaskRuns
) -> NDArray[np.uint64]:
    """What a `MaskTable` has at its address: where the rays' masks and the runs are, and sizes."""
    step, count = 4 if ray_count > 1 else 0, len(runs.starts)
    return np.array([places[0], step, *places[1:], count, halvings_of(count)], np.uint64)


@device
def _mask_of(table, number):
    """The mask of what has a number."""
    run = interval_of(table.starts, table.count, table.halvings, np.int64(number))
    return load(np.int32, table.masks + run * BYTES_32)


@device
def has_bit(masks, ray, mask):
    """Whether the masks of a ray and of a part have a bit in common; see `MaskTable.address`."""
    table = _Table(masks)
    return load(np.int32, table.rays + ray * table.step) & mask != np.int32(0)


@device
def lanes_with_bit(masks, first, mask):
    """The same for 16 consecutive rays."""
    table = _Table(masks)
    own = load(i32x16, table.rays + first * table.step)
    return (own & i32x16(mask)) != i32x16(np.int32(0))


@device
def is_admitted(masks, ray, number):
    """Whether a ray may hit what has a number, by the address of a `MaskTable`."""
    return has_bit(masks, ray, _mask_of(_Table(masks), number))


@device
def admitted_lanes(masks, first, number):
    """The mask of those of 16 consecutive rays that may hit what has a number."""
    return lanes_with_bit(masks, first, _mask_of(_Table(masks), number))

"""Choice of split planes for a level's cells by the CPU's costs, for all references in parallel.

In a small cell, one thread per reference tries the planes at both ends of its box, and counts the
boxes on either side by brute force. In a large cell, references are binned, with sums that do not
depend on order. Then one thread per cell keeps the plane that the CPU's sweep would have kept: the
cheapest; ties go to the first axis, then to the lowest position.

References
----------
Zhou, Hou, Wang and Guo, "Real-Time KD-Tree Construction on Graphics Hardware", ACM Transactions on
Graphics 27(5), 2008, who split all nodes of a level together.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from raystream.jit.atomics import atomic_add_aggregated, atomic_max
from raystream.jit.constants import BYTES_64, INF_F32, ONE_U64, ZERO_F32, ZERO_U64
from raystream.jit.cpu import device
from raystream.jit.cuda import DeviceArray, Gpu, gpu_kernel
from raystream.jit.simd import load, scratch, store
from raystream.structures.clip import BOX_BYTES, HIGH, WORD
from raystream.structures.kdtree.split import (
    BIN_COUNT,
    BIN_SHARE,
    LEAF,
    MOST_EXACT,
    Costs,
    axis_of,
    bin_of,
    find_in_bins,
    pays,
    split_cost,
)

_SIGN = np.uint32(0x80000000)
_ALL = np.uint32(0xFFFFFFFF)

#: Layout of an axis' bins in bytes: boxes that begin and end in each, then their two ends.
_ENDS_AT = WORD * BIN_COUNT
_LOWEST_AT = _ENDS_AT + _ENDS_AT
_HIGHEST_AT = _LOWEST_AT + WORD
_AXIS_BYTES = _HIGHEST_AT + WORD

#: Bytes of a cell's bins. Cells with bins have more than `MOST_EXACT` references, so the index of
#: the first, divided by `MOST_EXACT`, is different for each cell.
BIN_BYTES = 3 * int(_AXIS_BYTES)


class References(NamedTuple):
    """A level's references, cell after cell.

    Attributes
    ----------
    boxes : DeviceArray of shape (R, 6), float32
    ids : DeviceArray of shape (R,), int32
        prim_ids.
    cells : DeviceArray of shape (R,), uint32
        The cell of each: its row in the level.
    """

    boxes: DeviceArray
    ids: DeviceArray
    cells: DeviceArray

    @classmethod
    def allocate(cls, gpu: Gpu, count: int) -> References:
        """Allocate them for `count` references."""
        return cls(
            gpu.pooled("boxes of references", (count, 6), np.float32),
            gpu.pooled("references", count, np.int32),
            gpu.pooled("cells of references", count, np.uint32),
        )


class Level(NamedTuple):
    """A level's cells, with a row for each.

    Attributes
    ----------
    boxes : DeviceArray of shape (C, 6), float32
    begins : DeviceArray of shape (C + 1,), uint32
        The first reference of each, then the number of references.
    bads : DeviceArray of shape (C,), uint32
        Bad splits above them.
    rooms : DeviceArray of shape (C,), uint64
        Maximum number of references in their leaves.
    """

    boxes: DeviceArray
    begins: DeviceArray
    bads: DeviceArray
    rooms: DeviceArray

    @classmethod
    def allocate(cls, gpu: Gpu, count: int) -> Level:
        """Allocate them for `count` cells."""
        return cls(
            gpu.pooled("boxes of cells", (count, 6), np.float32),
            gpu.pooled("references of cells", count + 1, np.uint32),
            gpu.pooled("bad splits", count, np.uint32),
            gpu.pooled("rooms of cells", count, np.uint64),
        )


class Tried(NamedTuple):
    """Candidate planes, and bins.

    Attributes
    ----------
    costs, positions, axes : DeviceArray of shape (R,), float64, float32, uint32
        The best plane of each reference.
    bins : DeviceArray of uint8
        See `BIN_BYTES`; initially zero.
    """

    costs: DeviceArray
    positions: DeviceArray
    axes: DeviceArray
    bins: DeviceArray

    @classmethod
    def allocate(cls, gpu: Gpu, count: int) -> Tried:
        """Allocate them for `count` references."""
        # Only cells of more than `MOST_EXACT` references have bins.
        slots = count // int(MOST_EXACT) + 1 if count > int(MOST_EXACT) else 0
        bins = gpu.pooled("bins", slots * BIN_BYTES, np.uint8)
        gpu.clear(bins, bins.stream)
        return cls(
            gpu.pooled("costs of planes", count, np.float64),
            gpu.pooled("planes", count, np.float32),
            gpu.pooled("axes of planes", count, np.uint32),
            bins,
        )


class Choices(NamedTuple):
    """The planes chosen for a level's cells.

    Attributes
    ----------
    axes : DeviceArray of shape (C,), uint32
        0 to 2, or 3 for a leaf.
    positions : DeviceArray of shape (C,), float32
    bads : DeviceArray of shape (C,), uint32
        Bad splits above its parts.
    cut_counts : DeviceArray of shape (C,), uint32
        References that the plane cuts; initially zero.
    """

    axes: DeviceArray
    positions: DeviceArray
    bads: DeviceArray
    cut_counts: DeviceArray

    @classmethod
    def allocate(cls, gpu: Gpu, count: int) -> Choices:
        """Allocate them for `count` cells."""
        types = np.uint32, np.float32, np.uint32, np.uint32
        made = cls(*(gpu.pooled("choices", count, dtype) for dtype in types))
        gpu.clear(made.cut_counts, made.cut_counts.stream)
        return made


@device
def cell_range(level, cell):
    """First reference of a cell, and of the next one."""
    at = level.begins + cell * WORD
    return np.uint64(load(np.uint32, at)), np.uint64(load(np.uint32, at + WORD))


@device
def _ordered(number):
    """A uint32 in the order of float32 numbers, never 0."""
    place = scratch(4)
    store(place, number)
    bits = load(np.uint32, place)
    return bits ^ _ALL if bits & _SIGN else bits | _SIGN


@device
def _number(ordered):
    """The inverse of `_ordered`."""
    place = scratch(4)
    store(place, np.uint32(ordered ^ _SIGN if ordered & _SIGN else ordered ^ _ALL))
    return load(np.float32, place)


@device
def _width(along):
    """Width of an axis' bins, its inverse, and whether there are any."""
    width = (along.high - along.low) * BIN_SHARE
    scale = np.float32(1.0) / width
    return width, scale, width > ZERO_F32 and scale < INF_F32


@device
def _bins_of(tried, begin, axis):
    return tried.bins + (begin // MOST_EXACT) * np.uint64(BIN_BYTES) + axis * _AXIS_BYTES


@device
def _count_in_bins(box, begin, cell, tried):
    """Count a reference in its cell's bins."""
    for axis in range(np.uint64(3)):
        along = axis_of(cell, axis)
        _, scale, has_bins = _width(along)
        if not has_bins:
            continue
        low = load(np.float32, box + axis * WORD)
        high = load(np.float32, box + HIGH + axis * WORD)
        bins = _bins_of(tried, begin, axis)
        # The lowest position is the greatest of all complements: bins are zero at first.
        atomic_add_aggregated(bins + bin_of(low, along.low, scale) * WORD, np.uint32(1))
        atomic_add_aggregated(bins + _ENDS_AT + bin_of(high, along.low, scale) * WORD, np.uint32(1))
        atomic_max(bins + _LOWEST_AT, np.uint32(_ordered(low) ^ _ALL))
        atomic_max(bins + _HIGHEST_AT, np.uint32(_ordered(high)))


@device
def _try_plane(position, boxes, begin, end, along, step, costs):
    """Cost of a plane at a position; infinite if it is not inside the cell."""
    if not (position > along.low and position < along.high):
        return np.inf
    # A box that begins at the plane is above it, one that ends there below.
    begun, ended = ZERO_U64, ZERO_U64
    for i in range(begin, end):
        box = boxes + i * BOX_BYTES + step
        begun += ONE_U64 if load(np.float32, box) < position else ZERO_U64
        ended += ONE_U64 if load(np.float32, box + HIGH) <= position else ZERO_U64
    return split_cost(costs, along, position, begun, end - begin - ended)


@device
def _try_own(i, boxes, begin, end, cell, costs, tried):
    """Try the planes of reference i, and store the best one."""
    best_axis, best_position, best_cost = LEAF, ZERO_F32, np.inf
    for axis in range(np.uint64(3)):
        along, step = axis_of(cell, axis), axis * WORD
        for side in range(np.uint64(2)):
            position = load(np.float32, boxes + i * BOX_BYTES + step + side * HIGH)
            cost = _try_plane(position, boxes, begin, end, along, step, costs)
            if _is_better(cost, axis, position, best_cost, best_axis, best_position):
                best_axis, best_position, best_cost = axis, position, cost
    store(tried.costs + i * BYTES_64, best_cost)
    store(tried.positions + i * WORD, best_position)
    store(tried.axes + i * WORD, np.uint32(best_axis))


@device
def _is_better(cost, axis, position, best_cost, best_axis, best_position):
    """Whether the CPU's sweep would prefer a plane to the best one so far."""
    if cost != best_cost:
        return cost < best_cost
    if not cost < np.inf or axis != best_axis:
        return cost < np.inf and axis < best_axis
    return position < best_position


@gpu_kernel(refs=References, level=Level, costs=Costs, tried=Tried)
def try_planes(i, refs, level, costs, max_leaf_size, tried):
    """Try the planes of reference i, or bin it."""
    cell = np.uint64(load(np.uint32, refs.cells + i * WORD))
    begin, end = cell_range(level, cell)
    box = level.boxes + cell * BOX_BYTES
    if end - begin <= max_leaf_size:
        return
    if end - begin <= MOST_EXACT:
        _try_own(i, refs.boxes, begin, end, box, costs, tried)
    else:
        _count_in_bins(refs.boxes + i * BOX_BYTES, begin, box, tried)


@device
def _best_tried(begin, end, tried):
    """The best plane of a cell's references: axis, position, cost."""
    best_axis, best_position, best_cost = LEAF, ZERO_F32, np.inf
    for i in range(begin, end):
        axis = np.uint64(load(np.uint32, tried.axes + i * WORD))
        position = load(np.float32, tried.positions + i * WORD)
        cost = load(np.float64, tried.costs + i * BYTES_64)
        if _is_better(cost, axis, position, best_cost, best_axis, best_position):
            best_axis, best_position, best_cost = axis, position, cost
    return best_axis, best_position, best_cost


@device
def _best_of_bins(begin, end, cell, costs, tried):
    """The best plane between a cell's bins, and at their ends: axis, position, cost."""
    best_axis, best_position, best_cost = LEAF, ZERO_F32, np.inf
    for axis in range(np.uint64(3)):
        along = axis_of(cell, axis)
        width, _, has_bins = _width(along)
        if not has_bins:
            continue
        bins = _bins_of(tried, begin, axis)
        lowest = _number(np.uint32(load(np.uint32, bins + _LOWEST_AT) ^ _ALL))
        highest = _number(load(np.uint32, bins + _HIGHEST_AT))
        ends = lowest, highest
        position, cost = find_in_bins(
            along, width, bins, bins + _ENDS_AT, ends, end - begin, costs, best_cost
        )
        if cost < best_cost:
            best_axis, best_position, best_cost = axis, position, cost
    return best_axis, best_position, best_cost


@gpu_kernel(level=Level, costs=Costs, tried=Tried, choices=Choices)
def choose_plane(cell, level, costs, max_leaf_size, tried, choices):
    """Choose the plane of a cell, or make it a leaf."""
    begin, end = cell_range(level, cell)
    bad = np.uint64(load(np.uint32, level.bads + cell * WORD))
    axis, position = LEAF, ZERO_F32
    if end - begin > max_leaf_size:
        if end - begin <= MOST_EXACT:
            axis, position, cost = _best_tried(begin, end, tried)
        else:
            box = level.boxes + cell * BOX_BYTES
            axis, position, cost = _best_of_bins(begin, end, box, costs, tried)
        is_worth_it, bad = pays(cost, end - begin, bad, costs)
        if not is_worth_it:
            axis = LEAF
    store(choices.axes + cell * WORD, np.uint32(axis))
    store(choices.positions + cell * WORD, position)
    store(choices.bads + cell * WORD, np.uint32(bad))

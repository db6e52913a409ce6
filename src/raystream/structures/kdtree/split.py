"""Choosing split planes by the surface area heuristic.

For few references, every plane at which a box begins or ends is tried; for many, equidistant
planes and the two ends of the cell's content. A plane that cuts off empty space gets a
bonus.

References
----------
MacDonald and Booth, "Heuristics for ray tracing using space subdivision", The Visual Computer
6(3), 1990. Havran and Bittner, "On improving kd-trees for ray shooting", WSCG 2002. Pharr and
Humphreys, "Physically Based Rendering: From Theory to Implementation", 2004, the source of
the rules for the bonus and for splits that do not pay at once.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from raystream.jit.constants import INF_F32, ONE_U64, ZERO_F32, ZERO_U64
from raystream.jit.cpu import device, device_call
from raystream.jit.simd import load, store
from raystream.structures.clip import BOX_BYTES, HIGH, WORD

#: Cells of at most this many references try every plane.
_EXACT = 128

#: Bins per axis, between equidistant planes.
_BINS = 64

#: Scratch memory of `choose_split`: two lists of numbers, or two rows of bins.
WORK_BYTES = 2 * 4 * _EXACT

#: In place of an axis: no split.
LEAF = np.uint64(3)

#: Splits in a row that may cost more than a leaf; cells of fewer references than `_FEW` are never
#: split at more than `_TOO_COSTLY` times the cost of a leaf (pbrt's numbers).
_MAX_BAD_SPLITS = np.uint64(3)
_FEW = np.uint64(16)
_TOO_COSTLY = 4.0

_LAST_BIN = np.uint64(_BINS - 1)
#: The same, for kernels.
MOST_EXACT, BIN_COUNT = np.uint64(_EXACT), np.uint64(_BINS)
_HALF_WORK = np.uint64(4 * _EXACT)
BIN_SHARE = np.float32(1.0 / _BINS)


class Costs(NamedTuple):
    """The cost model.

    Attributes
    ----------
    traversal, intersection : float
        Cost of a traversal step and of a triangle test; only their ratio matters.
    empty_bonus : float
        Discount where one side is empty.
    crossing : float
        Cost of crossing the plane of a split: 0 for a tree, whose rays pay at the split.
    """

    traversal: float
    intersection: float
    empty_bonus: float
    crossing: float = 0.0


class _Axis(NamedTuple):
    """A cell along one axis: its ends, and half its surface area as base + length * side."""

    low: np.float32
    high: np.float32
    base: np.float64
    side: np.float64


@device
def axis_of(cell, axis):
    """The cell at an address, along an axis."""
    step = axis * WORD
    other = (axis + ONE_U64 if axis < np.uint64(2) else ZERO_U64) * WORD
    third = np.uint64(12) - step - other  # the offsets 0, 4 and 8 add up to it
    low, high = load(np.float32, cell + step), load(np.float32, cell + HIGH + step)
    d = np.float64(load(np.float32, cell + HIGH + other)) - load(np.float32, cell + other)
    e = np.float64(load(np.float32, cell + HIGH + third)) - load(np.float32, cell + third)
    return _Axis(low, high, d * e, d + e)


@device
def split_cost(costs, along, position, below, above):
    """Expected cost of a split with given numbers of references below and above."""
    length_below = np.float64(position) - along.low
    length_above = np.float64(along.high) - position
    area = along.base + (length_below + length_above) * along.side
    tests = (along.base + length_below * along.side) * np.float64(below)
    tests += (along.base + length_above * along.side) * np.float64(above)
    if below == ZERO_U64 or above == ZERO_U64:
        tests *= 1.0 - costs.empty_bonus
    crossings = costs.crossing * along.base
    return costs.traversal + (costs.intersection * tests + crossings) / area


@device
def _sort(at, count):
    """Sort a few float32 numbers by insertion."""
    for i in range(ONE_U64, count):
        number = load(np.float32, at + i * WORD)
        hole = i
        while hole != ZERO_U64:
            before = load(np.float32, at + (hole - ONE_U64) * WORD)
            if not before > number:
                break
            store(at + hole * WORD, before)
            hole -= ONE_U64
        store(at + hole * WORD, number)


@device
def _at(list_, place, count):
    return load(np.float32, list_ + place * WORD) if place < count else INF_F32


@device_call
def _find_exact(boxes, begin, end, cell, costs, work):
    """The best of all planes at which a box begins or ends: axis, position, cost."""
    count = end - begin
    best_axis, best_position, best_cost = LEAF, ZERO_F32, np.inf
    starts, ends = work, work + _HALF_WORK
    for axis in range(np.uint64(3)):
        along = axis_of(cell, axis)
        for i in range(count):
            box = boxes + (begin + i) * BOX_BYTES + axis * WORD
            store(starts + i * WORD, load(np.float32, box))
            store(ends + i * WORD, load(np.float32, box + HIGH))
        _sort(starts, count)
        _sort(ends, count)
        begun, ended = ZERO_U64, ZERO_U64
        while begun < count or ended < count:
            position = min(_at(starts, begun, count), _at(ends, ended, count))
            while ended < count and load(np.float32, ends + ended * WORD) <= position:
                ended += ONE_U64
            if position > along.low and position < along.high:
                cost = split_cost(costs, along, position, begun, count - ended)
                if cost < best_cost:
                    best_axis, best_position, best_cost = axis, position, cost
            while begun < count and load(np.float32, starts + begun * WORD) <= position:
                begun += ONE_U64
    return best_axis, best_position, best_cost


@device
def bin_of(number, low, scale):
    """The bin of a number, clamped to the first and last one."""
    return min(np.uint64(max((number - low) * scale, ZERO_F32)), _LAST_BIN)


@device
def find_in_bins(along, width, starts, ends, ends_of, count, costs, best_cost):
    """The best plane along an axis, from boxes counted in bins.

    Parameters
    ----------
    along : _Axis
    width : float32
        Of a bin.
    starts, ends : uint64
        Addresses of the numbers of boxes that begin and end in each bin, int32.
    ends_of : (float32, float32)
        The minimum of their low sides, and the maximum of their high ones.
    count : uint64
        Boxes.
    costs : Costs
    best_cost : float64
        Cost of the best plane so far.

    Returns
    -------
    position : float32
    cost : float64
        `best_cost` if no plane is cheaper.
    """
    best_position = ZERO_F32
    lowest, highest = ends_of
    begun, ended = ZERO_U64, ZERO_U64
    for k in range(BIN_COUNT):
        begun += np.uint64(load(np.int32, starts + k * WORD))
        ended += np.uint64(load(np.int32, ends + k * WORD))
        position = along.low + np.float32(k + ONE_U64) * width
        if position > along.low and position < along.high:
            cost = split_cost(costs, along, position, begun, count - ended)
            if cost < best_cost:
                best_position, best_cost = position, cost
    if lowest > along.low and lowest < along.high:
        cost = split_cost(costs, along, lowest, ZERO_U64, count)
        if cost < best_cost:
            best_position, best_cost = lowest, cost
    if highest > along.low and highest < along.high:
        cost = split_cost(costs, along, highest, count, ZERO_U64)
        if cost < best_cost:
            best_position, best_cost = highest, cost
    return best_position, best_cost


@device
def _count_one(at):
    store(at, np.int32(load(np.int32, at) + np.int32(1)))


@device_call
def _find_binned(boxes, begin, end, cell, costs, work):
    """The best of the binned planes: axis, position, cost."""
    count = end - begin
    best_axis, best_position, best_cost = LEAF, ZERO_F32, np.inf
    starts, ends = work, work + _HALF_WORK
    for axis in range(np.uint64(3)):
        along = axis_of(cell, axis)
        width = (along.high - along.low) * BIN_SHARE
        scale = np.float32(1.0) / width
        if not (width > ZERO_F32 and scale < INF_F32):
            continue
        for k in range(BIN_COUNT):
            store(starts + k * WORD, np.int32(0))
            store(ends + k * WORD, np.int32(0))
        lowest, highest = INF_F32, -INF_F32
        for i in range(begin, end):
            box = boxes + i * BOX_BYTES + axis * WORD
            low, high = load(np.float32, box), load(np.float32, box + HIGH)
            lowest, highest = min(lowest, low), max(highest, high)
            _count_one(starts + bin_of(low, along.low, scale) * WORD)
            _count_one(ends + bin_of(high, along.low, scale) * WORD)
        ends_of = lowest, highest
        position, cost = find_in_bins(along, width, starts, ends, ends_of, count, costs, best_cost)
        if cost < best_cost:
            best_axis, best_position, best_cost = axis, position, cost
    return best_axis, best_position, best_cost


@device
def pays(cost, count, bad_splits, costs):
    """Whether to make a split of a given cost, and the number of bad splits of its children."""
    leaf_cost = costs.intersection * np.float64(count)
    if cost > leaf_cost:
        bad_splits += ONE_U64
    is_too_costly = cost > _TOO_COSTLY * leaf_cost and count < _FEW
    return bad_splits < _MAX_BAD_SPLITS and not is_too_costly, bad_splits


@device_call
def _count_sides(boxes, begin, end, axis, position):
    """References below plus references above a plane; those that it cuts count twice."""
    total = ZERO_U64
    for i in range(begin, end):
        box = boxes + i * BOX_BYTES + axis * WORD
        low, high = load(np.float32, box), load(np.float32, box + HIGH)
        total += ONE_U64
        if low < position and high > position:
            total += ONE_U64
    return total


@device_call
def choose_split(boxes, begin, end, cell, bad_splits, room, costs, work):
    """Choose where to split a cell, if at all.

    Parameters
    ----------
    boxes : uint64
        Address of all references' boxes.
    begin, end : uint64
        The cell's range.
    cell : uint64
        Address of its box.
    bad_splits : uint64
        Splits above it, in a row, that cost more than a leaf.
    room : uint64
        Most references that its leaves may have.
    costs : Costs
    work : uint64
        Address of `WORK_BYTES` of scratch.

    Returns
    -------
    axis : uint64
        0 to 2, or `LEAF`.
    position : float32
    bad_splits : uint64
        Of its children.
    """
    count = end - begin
    if count <= MOST_EXACT:
        axis, position, cost = _find_exact(boxes, begin, end, cell, costs, work)
    else:
        axis, position, cost = _find_binned(boxes, begin, end, cell, costs, work)
    is_worth_it, bad_splits = pays(cost, count, bad_splits, costs)
    if axis == LEAF or not is_worth_it:
        return LEAF, position, bad_splits
    if _count_sides(boxes, begin, end, axis, position) > room:
        return LEAF, position, bad_splits
    return axis, position, bad_splits

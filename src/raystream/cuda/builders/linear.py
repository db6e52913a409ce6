"""Linear BVH (LBVH): the hierarchy given by the bits of sorted Morton keys.

References
----------
Karras, "Maximizing Parallelism in the Construction of BVHs, Octrees, and k-d Trees", High
Performance Graphics 2012.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from raystream.cuda.builders.binary_tree import Nodes, join
from raystream.jit.atomics import atomic_add, fence
from raystream.jit.constants import ONE_U64, SHIFT_32, SHIFT_64, ZERO_U64
from raystream.jit.cpu import device, kernel
from raystream.jit.cuda import DeviceArray, Gpu, RangeKernel
from raystream.jit.simd import load, store
from raystream.structures.bvh.binary_tree import Link

_BITS = np.uint64(64)


@device
def _leading_zeros(number):
    """Leading zeros of a uint64; 64 for 0."""
    if number == ZERO_U64:
        return _BITS
    zeros, step = ZERO_U64, np.uint64(32)
    while step != ZERO_U64:
        if number >> (_BITS - step) == ZERO_U64:
            zeros += step
            number <<= step
        step >>= ONE_U64
    return zeros


@device
def _shared_bits(keys, i, j):
    """Length of the common prefix of two keys, which continues with the rows of equal keys."""
    differs = load(np.uint64, keys + (i << SHIFT_64)) ^ load(np.uint64, keys + (j << SHIFT_64))
    if differs == ZERO_U64:
        return _BITS + _leading_zeros(i ^ j)
    return _leading_zeros(differs)


@device
def _last_row(keys, i, count, ahead):
    """The other end of the range of inner node i, which extends up or down from row i."""
    if ahead:
        room = count - ONE_U64 - i
        outside = _shared_bits(keys, i, i - ONE_U64) if i != ZERO_U64 else ZERO_U64
        is_first = i == ZERO_U64
    else:
        room = i
        outside = _shared_bits(keys, i, i + ONE_U64)
        is_first = False
    # Rows whose common prefix with row i is longer than that of the row outside: a bound, then
    # the end.
    step = ONE_U64
    while step < room and (
        is_first or _shared_bits(keys, i, i + step if ahead else i - step) > outside
    ):
        step <<= ONE_U64
    length = ZERO_U64
    while step != ZERO_U64:
        tried = length + step
        if tried <= room and (
            is_first or _shared_bits(keys, i, i + tried if ahead else i - tried) > outside
        ):
            length = tried
        step >>= ONE_U64
    return i + length if ahead else i - length


@kernel
def _link(i, keys, count, links, parents):
    """Find the children of inner node i, in row count + i."""
    ahead = i == ZERO_U64
    if not ahead:
        ahead = _shared_bits(keys, i, i + ONE_U64) > _shared_bits(keys, i, i - ONE_U64)
    other = _last_row(keys, i, count, ahead)
    first, last = min(i, other), max(i, other)
    # The split is after the last row that shares a longer prefix with the first than the last does.
    shared = _shared_bits(keys, first, last)
    low, high = first, last
    while high - low > ONE_U64:
        middle = (low + high) >> ONE_U64
        if _shared_bits(keys, first, middle) > shared:
            low = middle
        else:
            high = middle
    left = low if low == first else count + low
    right = high if high == last else count + high
    link = Link(links, count + i)
    link.left, link.right = np.int32(left), np.int32(right)
    store(parents + (left << SHIFT_32), np.uint32(i))
    store(parents + (right << SHIFT_32), np.uint32(i))


@kernel
def _climb(i, count, nodes, parents, visits):
    """Climb from leaf i, writing each inner node whose other child is already written."""
    row = i
    while row != count:  # the root's row
        parent = np.uint64(load(np.uint32, parents + (row << SHIFT_32)))
        fence()
        if atomic_add(visits + (parent << SHIFT_32), np.uint32(1)) == np.uint32(0):
            return  # the thread that arrives from the other child writes it
        fence()
        row = count + parent
        link = Link(nodes.links, row)
        join(nodes, row, np.uint64(link.left), np.uint64(link.right))


@kernel
def _clear(i, visits):
    store(visits + (i << SHIFT_32), np.uint32(0))


class _Kernels(NamedTuple):
    link: RangeKernel
    clear: RangeKernel
    climb: RangeKernel


KERNELS = _Kernels(RangeKernel(_link), RangeKernel(_clear), RangeKernel(_climb))


def link_by_keys(gpu: Gpu, keys: DeviceArray, nodes: Nodes) -> int:
    """Launch the kernels that write a tree's inner nodes; returns the root's row at once.

    Parameters
    ----------
    gpu : Gpu
    keys : DeviceArray of shape (N,), uint64
        In increasing order.
    nodes : Nodes
        With its leaves.

    Notes
    -----
    The depth is at most the number of bits in which keys and rows differ.

    Raises
    ------
    CudaError
        If device memory runs out.
    """
    if nodes.leaf_count == 1:
        return 0
    count = np.uint64(nodes.leaf_count)
    parents = gpu.empty("parents", 2 * nodes.leaf_count, np.uint32)
    visits = gpu.empty("visits", nodes.leaf_count, np.uint32)
    KERNELS.clear.launch(gpu, nodes.leaf_count, (visits.address,))
    inner = keys.address, count, nodes.at.links, parents.address
    KERNELS.link.launch(gpu, nodes.leaf_count - 1, inner)
    KERNELS.climb.launch(gpu, nodes.leaf_count, (count, nodes.at, parents.address, visits.address))
    return nodes.leaf_count

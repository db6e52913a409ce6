"""Radix sort of key-value pairs on the device.

Each pass is a stable sort by four bits: tiles count their digits, a scan turns counts into output
offsets, and tiles are sorted in shared memory and written.

References
----------
Satish, Harris and Garland, "Designing Efficient Sorting Algorithms for Manycore GPUs", IEEE
International Parallel and Distributed Processing Symposium 2009.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numba import cuda

from raystream.jit.constants import ONE_U64, ZERO_U64
from raystream.jit.cuda.block_kernel import BlockKernel, get_32, get_64, put_32, put_64
from raystream.jit.cuda.device_array import DeviceArray
from raystream.jit.cuda.gpu import Gpu
from raystream.jit.cuda.scan import DEFAULT_TILE, Scan, TileSize

#: Bits per pass.
DIGIT_BITS = 4

_DIGITS = np.uint64(1 << DIGIT_BITS)
_MASK = np.uint64((1 << DIGIT_BITS) - 1)
_SHIFT = np.uint64(DIGIT_BITS)


class SortKernels(NamedTuple):
    """The steps of a pass, made by `sort_kernels`."""

    count_digits: BlockKernel
    scatter: BlockKernel


@cache
def sort_kernels(dtype: Any, size: TileSize = DEFAULT_TILE) -> SortKernels:
    """Make the kernels for keys of a dtype: uint32 or uint64."""
    is_long = np.dtype(dtype).itemsize == 8
    get, put = (get_64, put_64) if is_long else (get_32, put_32)
    return SortKernels(
        BlockKernel(_counting(get, size), 5, size.threads),
        BlockKernel(_scattering(get, put, size), 8, size.threads),
    )


def _counting(get: Callable[..., Any], size: TileSize) -> Callable[..., Any]:
    threads, items = np.uint64(size.threads), np.uint64(size.items)
    room = _counter_room(size)

    def count_digits(keys: Any, count: Any, shift: Any, tiles: Any, found: Any) -> None:
        """Count the digits of each tile, ordered by digit and then by tile."""
        counters = cuda.shared.array(room, np.uint32)
        t, tile = np.uint64(cuda.threadIdx.x), np.uint64(cuda.blockIdx.x)
        for digit in range(_DIGITS):
            e = np.uint64(digit) * threads + t
            counters[e + (e >> _SHIFT)] = 0
        first = (tile * threads + t) * items
        for k in range(items):
            i = first + np.uint64(k)
            if i < count:
                digit = (np.uint64(get(keys, i)) >> shift) & _MASK
                e = digit * threads + t
                counters[e + (e >> _SHIFT)] += 1
        cuda.syncthreads()
        # Each digit's counters are summed over the threads by halving.
        step = threads >> ONE_U64
        while step != ZERO_U64:
            if t < step:
                for digit in range(_DIGITS):
                    e = np.uint64(digit) * threads + t
                    other = e + step
                    counters[e + (e >> _SHIFT)] += counters[other + (other >> _SHIFT)]
            cuda.syncthreads()
            step >>= ONE_U64
        if t < _DIGITS:
            e = t * threads
            put_32(found, t * tiles + tile, np.uint64(counters[e + (e >> _SHIFT)]))

    return count_digits


def _scattering(
    get: Callable[..., Any], put: Callable[..., Any], size: TileSize
) -> Callable[..., Any]:
    threads, items = np.uint64(size.threads), np.uint64(size.items)
    room, thread_room, tile_room = _counter_room(size), size.threads, size.numbers

    def scatter(
        keys: Any,
        values: Any,
        count: Any,
        shift: Any,
        tiles: Any,
        begins: Any,
        to_keys: Any,
        to_values: Any,
    ) -> None:
        """Write the pairs of each tile to the offsets of their digits."""
        # Counters are ordered by digit and then by thread, with a gap after each 16, so that
        # threads that sum 16 of them have no bank conflicts.
        counters = cuda.shared.array(room, np.uint32)
        sums = cuda.shared.array(thread_room, np.uint32)
        starts = cuda.shared.array(16, np.uint32)
        own_keys = cuda.shared.array(tile_room, np.uint64)
        own_values = cuda.shared.array(tile_room, np.uint32)
        t, tile = np.uint64(cuda.threadIdx.x), np.uint64(cuda.blockIdx.x)

        # Step 1: each thread counts the digits of its own pairs.
        for digit in range(_DIGITS):
            e = np.uint64(digit) * threads + t
            counters[e + (e >> _SHIFT)] = 0
        first = (tile * threads + t) * items
        for k in range(items):
            i = first + np.uint64(k)
            if i < count:
                digit = (np.uint64(get(keys, i)) >> shift) & _MASK
                e = digit * threads + t
                counters[e + (e >> _SHIFT)] += 1
        cuda.syncthreads()

        # Step 2: scan the counters, 16 per thread, then the threads' sums.
        total = np.uint64(0)
        for k in range(_DIGITS):
            e = t * _DIGITS + np.uint64(k)
            total += np.uint64(counters[e + (e >> _SHIFT)])
        sums[t] = total
        cuda.syncthreads()
        step = ONE_U64
        while step < threads:
            before = np.uint64(0)
            if t >= step:
                before = np.uint64(sums[t - step])
            cuda.syncthreads()
            sums[t] += np.uint32(before)
            cuda.syncthreads()
            step <<= ONE_U64
        running = np.uint64(sums[t]) - total
        for k in range(_DIGITS):
            e = t * _DIGITS + np.uint64(k)
            at = e + (e >> _SHIFT)
            number = np.uint64(counters[at])
            counters[at] = running
            running += number
        cuda.syncthreads()
        if t < _DIGITS:
            e = t * threads
            starts[t] = counters[e + (e >> _SHIFT)]
        cuda.syncthreads()

        # Step 3: sort the tile.
        for k in range(items):
            i = first + np.uint64(k)
            if i < count:
                key = np.uint64(get(keys, i))
                e = ((key >> shift) & _MASK) * threads + t
                at = e + (e >> _SHIFT)
                place = np.uint64(counters[at])
                counters[at] = place + ONE_U64
                own_keys[place] = key
                own_values[place] = get_32(values, i)
        cuda.syncthreads()

        # Step 4: write the tile, with coalesced writes.
        in_tile = min(count - tile * threads * items, threads * items)
        for k in range(items):
            j = np.uint64(k) * threads + t
            if j < in_tile:
                key = np.uint64(own_keys[j])
                digit = (key >> shift) & _MASK
                begin = np.uint64(get_32(begins, digit * tiles + tile))
                to = begin + j - np.uint64(starts[digit])
                put(to_keys, to, key)
                put_32(to_values, to, np.uint64(own_values[j]))

    return scatter


def _counter_room(size: TileSize) -> int:
    count = size.threads << DIGIT_BITS
    return count + (count >> DIGIT_BITS)


def sort_pairs(
    gpu: Gpu,
    keys: DeviceArray,
    values: DeviceArray,
    bits: int,
    size: TileSize = DEFAULT_TILE,
) -> tuple[DeviceArray, DeviceArray]:
    """Sort pairs by their keys, asynchronously and stably.

    Parameters
    ----------
    gpu : Gpu
    keys : DeviceArray of shape (N,), uint32 or uint64
        Used as scratch.
    values : DeviceArray of shape (N,), uint32 or int32
        Used as scratch.
    bits : int
        Number of low bits that differ; higher bits must be 0.
    size : TileSize, optional

    Returns
    -------
    keys, values : DeviceArray
        Sorted.

    Raises
    ------
    CudaError
        If there is no scratch memory.
    """
    (count,) = keys.shape
    if count < 2 or bits < 1:
        return keys, values
    tiles = -(-count // size.numbers)
    counter_count = int(_DIGITS) * tiles
    found = gpu.empty("digits of tiles", counter_count + 1, np.uint32)
    scan = Scan(gpu, counter_count, size)
    others = (
        gpu.empty("sorted keys", count, keys.dtype),
        gpu.empty("sorted values", count, values.dtype),
    )
    own = keys, values
    count_digits, scatter = sort_kernels(keys.dtype.name, size)
    for shift in range(0, bits, DIGIT_BITS):
        to = found.address
        count_digits.launch(gpu, tiles, own[0].address, count, shift, tiles, to)
        scan.run(to, counter_count, to, np.uint32)
        addresses = [one.address for one in (*own, *others)]
        more = count, shift, tiles, to
        scatter.launch(gpu, tiles, *addresses[:2], *more, *addresses[2:])
        own, others = others, own
    return own

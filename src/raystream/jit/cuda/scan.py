"""Scan: the exclusive prefix sum of an array on the device.

Tiles are summed, their sums are scanned recursively, and then each tile is scanned from its offset:
two reads and one write of the array.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numba import cuda
from numpy.typing import DTypeLike

from raystream.jit.constants import NULL, ONE_U64, ZERO_U64
from raystream.jit.cuda.block_kernel import BlockKernel, Number, get_32, get_64, put_32, put_64
from raystream.jit.cuda.device_array import DeviceArray
from raystream.jit.cuda.gpu import Gpu
from raystream.jit.cuda.simulation import is_simulated


class TileSize(NamedTuple):
    """The part of an array that a block of threads processes.

    Attributes
    ----------
    threads : int
        Threads per block; a power of two, at least 16.
    items : int
        Numbers per thread.
    """

    threads: int = 256
    items: int = 8

    @property
    def numbers(self) -> int:
        """Numbers per tile."""
        return self.threads * self.items


#: Few threads in the simulator, where each one is a thread of the host.
DEFAULT_TILE = TileSize(16, 64) if is_simulated() else TileSize()


class ScanKernels(NamedTuple):
    """The two steps of a scan, made by `scan_kernels`."""

    add_tiles: BlockKernel
    scan_tiles: BlockKernel


@cache
def scan_kernels(dtype: DTypeLike, size: TileSize = DEFAULT_TILE) -> ScanKernels:
    """Make the kernels for arrays of a dtype: uint32 or uint64."""
    is_long = np.dtype(dtype).itemsize == 8
    get, put = (get_64, put_64) if is_long else (get_32, put_32)
    return ScanKernels(
        BlockKernel(_adding(get, size), 3, size.threads),
        BlockKernel(_scanning(get, put, size), 4, size.threads),
    )


def _adding(get: Callable[..., Any], size: TileSize) -> Callable[..., Any]:
    room, threads, items = size.threads, np.uint64(size.threads), np.uint64(size.items)

    def add_tiles(values: Any, count: Any, sums: Any) -> None:
        """Sum each tile of `values`."""
        shared = cuda.shared.array(room, np.uint64)
        t, tile = np.uint64(cuda.threadIdx.x), np.uint64(cuda.blockIdx.x)
        first = (tile * threads + t) * items
        total = np.uint64(0)
        for k in range(items):
            i = first + np.uint64(k)
            if i < count:
                total += np.uint64(get(values, i))
        shared[t] = total
        cuda.syncthreads()
        step = threads >> ONE_U64
        while step != ZERO_U64:
            if t < step:
                shared[t] += shared[t + step]
            cuda.syncthreads()
            step >>= ONE_U64
        if t == ZERO_U64:
            put_64(sums, tile, shared[0])

    return add_tiles


def _scanning(
    get: Callable[..., Any], put: Callable[..., Any], size: TileSize
) -> Callable[..., Any]:
    room, threads, items = size.threads, np.uint64(size.threads), np.uint64(size.items)

    def scan_tiles(values: Any, count: Any, sums: Any, out: Any) -> None:
        """Scan each tile from its row of `sums`, or from 0 without `sums`."""
        shared = cuda.shared.array(room, np.uint64)
        t, tile = np.uint64(cuda.threadIdx.x), np.uint64(cuda.blockIdx.x)
        first = (tile * threads + t) * items
        total = np.uint64(0)
        for k in range(items):
            i = first + np.uint64(k)
            if i < count:
                total += np.uint64(get(values, i))
        shared[t] = total
        cuda.syncthreads()
        # Hillis-Steele scan of the threads' sums.
        step = ONE_U64
        while step < threads:
            before = np.uint64(0)
            if t >= step:
                before = shared[t - step]
            cuda.syncthreads()
            shared[t] += before
            cuda.syncthreads()
            step <<= ONE_U64
        running = shared[t] - total
        if sums != NULL:
            running += np.uint64(get_64(sums, tile))
        for k in range(items):
            i = first + np.uint64(k)
            if i < count:
                number = np.uint64(get(values, i))
                put(out, i, running)
                running += number
                if i + ONE_U64 == count:
                    put(out, count, running)

    return scan_tiles


class Scan:
    """Scans arrays on a device, with reusable scratch memory.

    Parameters
    ----------
    gpu : Gpu
    max_count : int
        Length of the longest array.
    size : TileSize, optional
    empty : callable, optional
        Allocates scratch memory [default: `Gpu.empty`].

    Raises
    ------
    CudaError
        If there is no memory for it.
    """

    def __init__(
        self,
        gpu: Gpu,
        max_count: int,
        size: TileSize = DEFAULT_TILE,
        empty: Callable[..., DeviceArray] | None = None,
    ) -> None:
        empty = empty or gpu.empty
        self.gpu, self.max_count, self.size = gpu, max_count, size
        self._sums = []
        tiles = self._tiles(max_count)
        while tiles > 1:
            self._sums.append(empty("sums of tiles", tiles + 1, np.uint64))
            tiles = self._tiles(tiles)

    def _tiles(self, count: int) -> int:
        return -(-count // self.size.numbers)

    def run(
        self, values: Number, count: int, out: Number, dtype: DTypeLike, stream: Any = None
    ) -> None:
        """Scan an array asynchronously.

        Parameters
        ----------
        values : uint64
            Address of `count` numbers.
        count : int
            At least 1.
        out : uint64
            Address of ``count + 1`` numbers, which may be that of `values`: element i becomes
            the sum of the first i.
        dtype : uint32, int64 or uint64
            Of both arrays. Sums wrap around.
        stream : cuda.core.Stream, optional
            [default: the device's stream]

        Raises
        ------
        ValueError
            If the array is empty, or longer than `max_count`.
        """
        if not 1 <= count <= self.max_count:
            raise ValueError(f"count: expected 1 to {self.max_count:,}, got {count:,}")
        self._run(values, count, out, np.dtype(dtype).itemsize, 0, stream)

    def _run(
        self, values: Number, count: int, out: Number, itemsize: int, level: int, stream: Any
    ) -> None:
        add_tiles, scan_tiles = scan_kernels(f"uint{8 * itemsize}", self.size)
        tiles = self._tiles(count)
        sums = np.uint64(0)
        if tiles > 1:
            sums = self._sums[level].address
            add_tiles.launch(self.gpu, tiles, values, count, sums, stream=stream)
            self._run(sums, tiles, sums, 8, level + 1, stream)
        scan_tiles.launch(self.gpu, tiles, values, count, sums, out, stream=stream)


def scan(gpu: Gpu, counts: DeviceArray, empty: Callable[..., DeviceArray] | None = None) -> None:
    """Scan an array of counts in place, asynchronously; its last number becomes their sum.

    Raises
    ------
    CudaError
        If there is no memory; see `Scan`.
    """
    count = len(counts) - 1
    if count == 0:
        gpu.clear(counts, counts.stream)
    else:
        Scan(gpu, count, empty=empty).run(counts.address, count, counts.address, counts.dtype)


def scan_in_place(
    gpu: Gpu, counts: DeviceArray, empty: Callable[..., DeviceArray] | None = None
) -> int:
    """Scan an array of counts as `scan` does, and wait for the sum; returns it."""
    scan(gpu, counts, empty)
    return int(counts.part(len(counts) - 1, 1).host()[0])

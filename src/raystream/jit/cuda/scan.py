"""Scan: sums of all that comes before each number of an array, on the device.

Tiles are added up, their sums are scanned in the same way, and then each tile is scanned from its
sum on: two readings and one writing of the array.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numba import cuda
from numpy.typing import DTypeLike

from raystream.jit.cuda.block_kernel import BlockKernel, Number, get_32, get_64, put_32, put_64
from raystream.jit.cuda.device_array import DeviceArray
from raystream.jit.cuda.gpu import Gpu
from raystream.jit.cuda.simulation import is_simulated

__all__ = ["USUAL_TILE", "Scan", "TileSize", "scan_kernels"]


class TileSize(NamedTuple):
    """What a block of threads works on.

    Attributes
    ----------
    threads : int
        Of a block; a power of two, at least 16.
    items : int
        Numbers for each of them.
    """

    threads: int = 256
    items: int = 8

    @property
    def numbers(self) -> int:
        """Of a tile."""
        return self.threads * self.items


#: In the simulator each thread costs a thread of the host's, so that there are few.
USUAL_TILE = TileSize(16, 64) if is_simulated() else TileSize()

_NONE = np.uint64(0)
_ONE = np.uint64(1)


class ScanKernels(NamedTuple):
    """Two steps of a scan; `scan_kernels` makes them."""

    add_tiles: BlockKernel
    scan_tiles: BlockKernel


@cache
def scan_kernels(dtype: DTypeLike, size: TileSize = USUAL_TILE) -> ScanKernels:
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
        """Add up each tile of `values`."""
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
        step = threads >> _ONE
        while step != _NONE:
            if t < step:
                shared[t] += shared[t + step]
            cuda.syncthreads()
            step >>= _ONE
        if t == _NONE:
            put_64(sums, tile, shared[0])

    return add_tiles


def _scanning(
    get: Callable[..., Any], put: Callable[..., Any], size: TileSize
) -> Callable[..., Any]:
    room, threads, items = size.threads, np.uint64(size.threads), np.uint64(size.items)

    def scan_tiles(values: Any, count: Any, sums: Any, out: Any) -> None:
        """Scan each tile, from its row of `sums` on, or from 0 if there are none."""
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
        # Hillis and Steele's scan of the threads' sums.
        step = _ONE
        while step < threads:
            before = np.uint64(0)
            if t >= step:
                before = shared[t - step]
            cuda.syncthreads()
            shared[t] += before
            cuda.syncthreads()
            step <<= _ONE
        running = shared[t] - total
        if sums != _NONE:
            running += np.uint64(get_64(sums, tile))
        for k in range(items):
            i = first + np.uint64(k)
            if i < count:
                number = np.uint64(get(values, i))
                put(out, i, running)
                running += number
                if i + _ONE == count:
                    put(out, count, running)

    return scan_tiles


class Scan:
    """Scans arrays on a device, again and again in the same scratch memory.

    Parameters
    ----------
    gpu : Gpu
    most : int
        Length of the longest array.
    size : TileSize, optional
    empty : callable, optional
        Makes its memory, as `Gpu.empty` does, which is what it is without it.

    Raises
    ------
    CudaError
        If there is no memory for it.
    """

    def __init__(
        self,
        gpu: Gpu,
        most: int,
        size: TileSize = USUAL_TILE,
        empty: Callable[..., DeviceArray] | None = None,
    ) -> None:
        empty = empty or gpu.empty
        self.gpu, self.most, self.size = gpu, most, size
        self._sums = []
        tiles = self._tiles(most)
        while tiles > 1:
            self._sums.append(empty("sums of tiles", tiles + 1, np.uint64))
            tiles = self._tiles(tiles)

    def _tiles(self, count: int) -> int:
        return -(-count // self.size.numbers)

    def run(
        self, values: Number, count: int, out: Number, dtype: DTypeLike, stream: Any = None
    ) -> None:
        """Begin to scan an array; nothing waits for it.

        Parameters
        ----------
        values : uint64
            Address of `count` numbers.
        count : int
            At least 1.
        out : uint64
            Address of ``count + 1`` numbers, which may be that of `values`: row i becomes the
            sum of the first i.
        dtype : uint32, int64 or uint64
            Of both arrays. Sums that are too large lose their upper bits.
        stream : cuda.core.Stream, optional
            Without it, the device's own.

        Raises
        ------
        ValueError
            If the array is empty, or longer than was said.
        """
        if not 1 <= count <= self.most:
            raise ValueError(f"count: expected 1 to {self.most:,}, got {count:,}")
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

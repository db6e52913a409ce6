"""The kernels that a structure declares for its batches; `machines.batch` chooses and runs them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from raystream.core.query import Kind, Query
from raystream.core.rays import RayBatch
from raystream.jit.constants import NULL
from raystream.jit.threads import thread_count
from raystream.kernels.aligned import array_address
from raystream.kernels.hits import Sink
from raystream.kernels.ray import SceneFrame
from raystream.kernels.ray_source import RaySource, ResultAddresses
from raystream.structures.bvh.packets.rays import PacketOrder, PacketSource

#: The name of the kernels that trace rays one by one.
SINGLE = "single"

if TYPE_CHECKING:
    from raystream.structures.bvh.coherence import Coherence


class Batch(NamedTuple):
    """A batch of rays and its results: each kernel takes what it needs.

    Attributes
    ----------
    query : Query
        Its filter is a `HitFilter` or None.
    rays : RayBatch
    sink : Sink
    source : RaySource
        Of these rays; see `BatchKernel.by_packets` for the limits.
    order : PacketOrder
        Their packets.
    """

    query: Query
    rays: RayBatch
    sink: Sink
    source: RaySource
    order: PacketOrder

    @property
    def wants_any(self) -> bool:
        """Whether any hit is wanted, not the nearest one."""
        return self.query.kind is Kind.ANY_HIT

    @property
    def results(self) -> ResultAddresses:
        """Where the kernels of nearest and any hits write."""
        sink = self.sink
        status = np.uint64(array_address(sink.status))
        if self.query.kind is Kind.ANY_HIT:
            seen = np.uint64(array_address(sink.seen))
            return ResultAddresses(NULL, NULL, NULL, NULL, seen, status)
        memory = getattr(sink, "memory", None)
        if memory is None:
            return ResultAddresses(*sink.nearest, NULL, status)
        # One by one, as calls of one ray are short: a microsecond faster than by `nearest`.
        t, step = array_address(memory), memory.strides[0]
        u, v, prim_id = np.uint64(t + step), np.uint64(t + 2 * step), np.uint64(t + 3 * step)
        return ResultAddresses(np.uint64(t), u, v, prim_id, NULL, status)

    def packets(self, frame: SceneFrame) -> PacketSource:
        """The rays as packets."""
        status = np.uint64(array_address(self.sink.status))
        return PacketSource(self.source, self.order, frame, status)


#: The calls of a kernel for parts of a batch; see `BatchKernel`.
Calls = tuple[Callable[..., object], tuple[Any, ...]]


class CallSize(NamedTuple):
    """How a range of rays, packets or points is divided into calls of a kernel.

    Attributes
    ----------
    least, most : int
        Items per call, least <= most: enough to hide the start and the end of a call; few enough
        that the threads finish together and Ctrl-C is noticed.
    block : int
        Calls for more are for a multiple of it.
    share : int
        Calls of each thread, if these limits allow.
    memory_bytes : int
        Memory of a call.
    joins_chunks : bool
        See `parallel_for`.
    """

    least: int
    most: int
    block: int = 1
    share: int = 8
    memory_bytes: int = 0
    joins_chunks: bool = True

    def of(self, count: int) -> int:
        """Items of a call for a range of `count`.

        Small ranges are divided among the threads, too, but not so far that starting a call costs
        more than its items.
        """
        if count <= self.least:  # without counting threads: that takes 2 us
            return self.least
        size = -(-count // (self.share * thread_count()))
        if size > self.block:  # whole blocks
            size -= size % self.block
        return min(self.most, max(self.least, size))


class BatchKernel(NamedTuple):
    """A kernel that traces the rays of a batch.

    Attributes
    ----------
    bind : callable
        ``bind(structure, batch)`` returns a function and arguments: ``function(begin, end,
        *arguments)`` traces these rays, or packets. If it needs memory, its address follows, a
        multiple of 64.
    size : CallSize
    by_packets : bool
        Whether it traces packets, of limits that are adjacent numbers. Otherwise it has the limits
        in the precision that it traces in.
    is_tiled : bool
        Whether packets should be tiles of the rows of a flat image.
    """

    bind: Callable[[Any, Batch], Calls]
    size: CallSize
    by_packets: bool = True
    is_tiled: bool = False


#: Chooses kernels by coherence, rays and bytes of the tree; see `BatchKernels`.
Suited = Callable[["Coherence", int, int], tuple[str, ...]]


class BatchKernels(NamedTuple):
    """A structure's kernels for a query.

    Attributes
    ----------
    kernels : mapping of str to BatchKernel
        By the value of the structure's option ``kernel``. The structure adds `SINGLE`, which
        traces the rays one by one, and for which other values stand.
    suited : callable or None
        ``suited(coherence, ray_count, byte_count)`` returns the name of the kernel that suits such
        rays, and those of others that may be faster. None if there is only `SINGLE`.
    few : int
        Smaller batches, and those of as many rays, are traced by `kernel_for_few`.
    kernel_for_few : str
    """

    kernels: Mapping[str, BatchKernel]
    suited: Suited | None = None
    few: int = 0
    kernel_for_few: str = SINGLE

    def named(self, options: Any, ray_count: int) -> str:
        """The kernel for a number of rays; "auto" if the rays decide."""
        if self.suited is None:
            return SINGLE
        name: str = options.kernel
        if name == "auto":
            return self.kernel_for_few if ray_count <= self.few else name
        return name if name in self.kernels else SINGLE


def by_kind(
    nearest: BatchKernels,
    all_hits: tuple[BatchKernel, BatchKernel],
    suited: Suited | None = None,
    others: Mapping[str, tuple[BatchKernel, BatchKernel]] | None = None,
) -> dict[Kind, BatchKernels]:
    """A structure's kernels by the kind of query.

    Parameters
    ----------
    nearest : BatchKernels
        For first and any hits.
    all_hits : tuple of two BatchKernel
        By packets: for all hits, and for their numbers.
    suited : callable, optional
        See `BatchKernels`, for these two [default: that of `nearest`].
    others : mapping of str to tuple of two BatchKernel, optional
        The same by other kernels, by name.
    """
    suited, few = suited or nearest.suited, nearest.few
    named = {"packet": all_hits, **(others or {})}
    tables = ({name: pair[k] for name, pair in named.items()} for k in range(2))
    visited, counted = (BatchKernels(table, suited, few) for table in tables)
    return {
        Kind.FIRST_HIT: nearest,
        Kind.ANY_HIT: nearest,
        Kind.MULTI_HIT: visited,
        Kind.COUNT_HITS: counted,
    }

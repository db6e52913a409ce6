"""The kernels for many rays that a structure declares; `machines.batch` chooses and runs them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from raystream.core.query import Kind, Query
from raystream.core.rays import RayBatch
from raystream.kernels.aligned import array_address
from raystream.kernels.hits import Sink
from raystream.kernels.ray import SceneFrame
from raystream.kernels.ray_source import RaySource, ResultAddresses
from raystream.structures.bvh.packets.rays import PacketOrder, PacketSource

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
        Of these rays.
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
        """Where the kernels of nearest and any hits in float32 write."""
        if self.wants_any:
            return ResultAddresses.of_any(self.sink.seen, self.sink.status)
        return ResultAddresses.of_first(self.sink.memory, self.sink.status)

    def packets(self, frame: SceneFrame) -> PacketSource:
        """The rays as packets."""
        status = np.uint64(array_address(self.sink.status))
        return PacketSource(self.source, self.order, frame, status)


#: The calls of a kernel for parts of a batch; see `BatchKernel`.
Calls = tuple[Callable[..., object], tuple[Any, ...]]


class BatchKernel(NamedTuple):
    """A kernel that traces many rays at a time, and the size of its calls.

    Attributes
    ----------
    bind : callable
        ``bind(structure, batch)`` returns a function and arguments: ``function(begin, end,
        *arguments)`` traces these rays, or packets. If it needs memory, its address follows, a
        multiple of 64.
    least, most : int
        Rays or packets per call: enough to hide the start and the end of a call; few enough that
        the threads finish together and Ctrl-C is noticed.
    block : int
        Calls for more are for a multiple of it.
    share : int
        Calls of each thread, if these limits allow.
    by_packets : bool
        Whether it traces packets, of limits that are adjacent numbers.
    is_tiled : bool
        Whether packets should be tiles of the rows of a flat image.
    takes_filter : bool
        Whether it calls the query's filter.
    memory_bytes : int
        Memory of a call.
    joins_chunks : bool
        See `parallel_for`.
    """

    bind: Callable[[Any, Batch], Calls]
    least: int
    most: int
    block: int = 1
    share: int = 8
    by_packets: bool = True
    is_tiled: bool = False
    takes_filter: bool = False
    memory_bytes: int = 0
    joins_chunks: bool = True


class BatchKernels(NamedTuple):
    """A structure's kernels for a query.

    Attributes
    ----------
    kernels : mapping of str to BatchKernel
        By the value of the structure's option ``kernel``. Others mean ray by ray.
    suited : callable
        ``suited(coherence, ray_count, byte_count)`` returns the name of the kernel that suits such
        rays, and those of others that may be faster.
    few : int
        Smaller batches, and those of as many rays, are traced by `kernel_for_few`.
    kernel_for_few : str
    """

    kernels: Mapping[str, BatchKernel]
    suited: Callable[[Coherence, int, int], tuple[str, ...]]
    few: int
    kernel_for_few: str = "single"

    def named(self, options: Any, ray_count: int) -> str:
        """The kernel for a number of rays; "auto" if the rays decide."""
        is_few = options.kernel == "auto" and ray_count <= self.few
        return self.kernel_for_few if is_few else str(options.kernel)

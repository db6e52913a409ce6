"""The kernels for many rays of a BVH, and which of them suits a batch."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from raystream.core.query import Kind
from raystream.kernels.queries import output_of
from raystream.structures.batch_kernels import Batch, BatchKernel, BatchKernels, Calls
from raystream.structures.bvh.coherence import Coherence, choose_kernel, rivals
from raystream.structures.bvh.group_queries import trace_groups
from raystream.structures.bvh.group_rays import BLOCK_PACKETS, MEMORY_BYTES
from raystream.structures.bvh.options import Bvh
from raystream.structures.bvh.packet_multi_hit import counting_kernel, visiting_kernel
from raystream.structures.bvh.packet_queries import NEAREST, TREES, NearestWanted, packet_kernel
from raystream.structures.bvh.wavefront import trace_wavefront

if TYPE_CHECKING:
    from raystream.structures.base import Structure
    from raystream.structures.bvh.structure import BvhStructure

_trace_packets = packet_kernel(TREES, NEAREST)

#: Kernels: chosen for each batch; many single rays in flight; packets of rays; streams of groups of
#: rays, in the order of the batch; one ray after another.
KERNELS = Bvh.choices("kernel")

#: Batches of at most this many rays are traced by the calling thread: waking others takes longer.
SMALL_BATCH = 1024

#: Larger trees do not stay in the cache: their nodes are prefetched.
CACHED_BYTES = 1 << 21


def _wavefront(bvh: BvhStructure, batch: Batch) -> Calls:
    filter_, out = output_of(batch.query, batch.sink)
    rays = bvh.arrays, bvh.frame, batch.source
    prefetching = bvh.report.byte_count > CACHED_BYTES
    return trace_wavefront, (*rays, batch.wants_any, prefetching, filter_, out)


def _packets(bvh: BvhStructure, batch: Batch) -> Calls:
    return _trace_packets, nearest_of_packets(bvh, batch)


def _groups(bvh: BvhStructure, batch: Batch) -> Calls:
    return trace_groups, nearest_of_packets(bvh, batch)


def nearest_of_packets(structure: Structure, batch: Batch) -> tuple[Any, ...]:
    """The arguments of kernels that find the nearest or any hits of packets."""
    wanted = NearestWanted(batch.wants_any, *output_of(batch.query, batch.sink))
    return structure.arrays, batch.packets(structure.frame), wanted


def _suited(coherence: Coherence, count: int, byte_count: int) -> tuple[str, ...]:
    guess = choose_kernel(coherence, count, byte_count)
    return guess, *rivals(coherence, guess)


_NEAREST = {
    "packet": BatchKernel(_packets, 4, 64, is_tiled=True, takes_filter=True),
    "groups": BatchKernel(
        _groups, 4, 64, BLOCK_PACKETS, takes_filter=True, memory_bytes=MEMORY_BYTES
    ),
    # Fewer rays would not use all slots at the start and the end of a call.
    "wavefront": BatchKernel(_wavefront, 1024, 8192, by_packets=False, takes_filter=True),
}
_FIRST_OR_ANY = BatchKernels(_NEAREST, _suited, SMALL_BATCH, "wavefront")
_VISITED = visiting_kernel(TREES)
_COUNTED = counting_kernel(TREES)

#: The kernels by the kind of query, for trees that are not empty.
BATCH_KERNELS = {
    Kind.FIRST_HIT: _FIRST_OR_ANY,
    Kind.ANY_HIT: _FIRST_OR_ANY,
    Kind.MULTI_HIT: BatchKernels({"packet": _VISITED}, _suited, SMALL_BATCH),
    Kind.COUNT_HITS: BatchKernels({"packet": _COUNTED}, _suited, SMALL_BATCH),
}

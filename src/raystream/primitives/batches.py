"""The kernels for many rays through triangles, height fields and spheres."""

from __future__ import annotations

from typing import TYPE_CHECKING

from raystream.core.query import Kind
from raystream.primitives.packets import PRIMITIVES
from raystream.structures.batch_kernels import Batch, BatchKernel, BatchKernels, Calls
from raystream.structures.bvh.coherence import Coherence, choose_kernel
from raystream.structures.bvh.kernel_choice import SMALL_BATCH, nearest_of_packets
from raystream.structures.bvh.packet_multi_hit import counting_kernel, visiting_kernel
from raystream.structures.bvh.packet_queries import NEAREST, packet_kernel

if TYPE_CHECKING:
    from raystream.primitives.structure import PrimitiveBvh

_trace_packets = packet_kernel(PRIMITIVES, NEAREST)


def _packets(scene: PrimitiveBvh, batch: Batch) -> Calls:
    return _trace_packets, nearest_of_packets(scene, batch)


def _suited(coherence: Coherence, count: int, byte_count: int) -> tuple[str, ...]:
    return (choose_kernel(coherence, count, byte_count),)


_NEAREST = BatchKernels(
    {"packet": BatchKernel(_packets, 4, 64, is_tiled=True)}, _suited, SMALL_BATCH
)

#: The kernels by the kind of query.
BATCH_KERNELS = {
    Kind.FIRST_HIT: _NEAREST,
    Kind.ANY_HIT: _NEAREST,
    Kind.MULTI_HIT: BatchKernels({"packet": visiting_kernel(PRIMITIVES)}, _suited, SMALL_BATCH),
    Kind.COUNT_HITS: BatchKernels({"packet": counting_kernel(PRIMITIVES)}, _suited, SMALL_BATCH),
}

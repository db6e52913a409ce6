"""The kernels for many rays in float64, and which of them suits a batch."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from raystream.core.query import Kind
from raystream.float64.group_rays import Float64Packets
from raystream.float64.packets import trace_float64_packets
from raystream.float64.stream import BLOCK_RAYS, WORKING_BYTES, trace_float64_groups
from raystream.jit.constants import ZERO_U64
from raystream.kernels.hits import HitAddresses
from raystream.kernels.ray_source import ResultAddresses
from raystream.structures.batch_kernels import Batch, BatchKernel, BatchKernels, Calls
from raystream.structures.bvh.coherence import Coherence, choose_kernel
from raystream.structures.bvh.packet_rays import PACKET_RAYS

if TYPE_CHECKING:
    from raystream.float64.structure import Float64Structure

#: Smaller batches, and those of as many rays, are traced ray by ray.
_FEW = 256


def _groups(bvh: Float64Structure, batch: Batch) -> Calls:
    return trace_float64_groups, _arguments(bvh, batch)


def _packets(bvh: Float64Structure, batch: Batch) -> Calls:
    return trace_float64_packets, _arguments(bvh, batch)


def _arguments(bvh: Float64Structure, batch: Batch) -> tuple[Any, ...]:
    rays: Any = batch.rays
    source = Float64Packets.of(batch.packets(bvh.frame), *rays.float64_limits)
    sink = batch.sink
    if batch.wants_any:
        out = ResultAddresses.of_any(sink.seen, sink.status)
    else:
        at = HitAddresses.of(sink.hits)
        out = ResultAddresses(*at, ZERO_U64, np.uint64(sink.status.ctypes.data))
    return bvh.arrays, source, batch.wants_any, out


def _suited(coherence: Coherence, count: int, byte_count: int) -> tuple[str, ...]:
    is_packet = choose_kernel(coherence, count, byte_count) == "packet"
    return ("packet",) if is_packet else ("groups",)


#: Least packets of a call. To pass the arguments of a call takes as long as to trace half a packet
#: through a small mesh, and to wake another thread as long as several: 1,000 rays on one thread
#: take three quarters of the time that they take on two.
_LEAST = 4

_KERNELS = {
    "packet": BatchKernel(_packets, _LEAST, 64, share=4, is_tiled=True),
    "groups": BatchKernel(
        _groups, _LEAST, BLOCK_RAYS // PACKET_RAYS, share=4, memory_bytes=WORKING_BYTES
    ),
}

#: The kernels by the kind of query, for trees that are not empty.
BATCH_KERNELS = dict.fromkeys((Kind.FIRST_HIT, Kind.ANY_HIT), BatchKernels(_KERNELS, _suited, _FEW))

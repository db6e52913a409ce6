"""The kernels for many rays in float64, and which of them suits a batch."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from raystream.core.query import Kind
from raystream.float64.packets import trace_float64_packets
from raystream.float64.queries import Float64Source
from raystream.float64.stream import BLOCK_RAYS, WORKING_BYTES, trace_float64_groups
from raystream.kernels.hits import HitArrays
from raystream.structures.batch_kernels import Batch, BatchKernel, BatchKernels, Calls
from raystream.structures.bvh.coherence import Coherence, choose_kernel
from raystream.structures.bvh.packet_rays import PACKET_RAYS

if TYPE_CHECKING:
    from raystream.float64.structure import Float64Structure

#: Smaller batches, and those of as many rays, are traced ray by ray.
_FEW = 256


def _groups(bvh: Float64Structure, batch: Batch) -> Calls:
    rays = bvh.arrays, _source(batch), batch.packets(bvh.frame)
    return trace_float64_groups, (*rays, *_results(batch))


def _packets(bvh: Float64Structure, batch: Batch) -> Calls:
    rays = bvh.arrays, bvh.frame, _source(batch), batch.order
    return trace_float64_packets, (*rays, *_results(batch))


def _source(batch: Batch) -> Float64Source:
    rays: Any = batch.rays
    return Float64Source(batch.source, *rays.float64_limits)


def _results(batch: Batch) -> tuple[Any, ...]:
    sink = batch.sink
    if not batch.wants_any:
        return False, sink.status, sink.hits
    rows = HitArrays.empty(0, np.float64)._replace(prim_id=sink.seen.view(np.int8))
    return True, sink.status, rows


def _suited(coherence: Coherence, count: int, byte_count: int) -> tuple[str, ...]:
    is_packet = choose_kernel(coherence, count, byte_count) == "packet"
    return ("packet",) if is_packet else ("groups",)


_KERNELS = {
    "packet": BatchKernel(_packets, 1, 64, share=4, is_tiled=True),
    "groups": BatchKernel(
        _groups, 1, BLOCK_RAYS // PACKET_RAYS, share=4, memory_bytes=WORKING_BYTES
    ),
}

#: The kernels by the kind of query, for trees that are not empty.
BATCH_KERNELS = dict.fromkeys((Kind.FIRST_HIT, Kind.ANY_HIT), BatchKernels(_KERNELS, _suited, _FEW))

"""The kernels for many rays in float64, and which of them suits a batch."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from raystream.core.query import Kind
from raystream.geometry.float64.group_rays import Float64Packets
from raystream.geometry.float64.groups import (
    BLOCK_PACKETS,
    WORKING_BYTES,
    count_in_groups,
    trace_groups,
)
from raystream.geometry.float64.packets import FLOAT64_ALL, trace_packets
from raystream.jit.constants import ZERO_U64
from raystream.kernels.aligned import array_address
from raystream.kernels.hits import HitAddresses
from raystream.kernels.ray_source import ResultAddresses
from raystream.structures.batch_kernels import Batch, BatchKernel, BatchKernels, Calls
from raystream.structures.bvh.coherence import Coherence, choose_kernel
from raystream.structures.bvh.packets.multi_hit import all_hits_kernels, count_all
from raystream.structures.bvh.packets.queries import TREES, NearestWanted

if TYPE_CHECKING:
    from raystream.structures.base import Structure

#: Smaller batches, and those of as many rays, are traced ray by ray.
_FEW = 256


def _source(bvh: Structure, batch: Batch) -> Float64Packets:
    # Positions are the batch's, whose copies are kept until the rays are traced.
    low, high = batch.rays.exact_limits
    exact = batch.source._replace(
        t_min=np.uint64(array_address(low)),
        t_min_step=np.uint64(8 if len(low) > 1 else 0),
        t_max=np.uint64(array_address(high)),
        t_max_step=np.uint64(8 if len(high) > 1 else 0),
    )
    return Float64Packets(*batch.packets(bvh.frame), exact)


def _arguments(bvh: Structure, batch: Batch) -> tuple[Any, ...]:
    sink = batch.sink
    if batch.wants_any:
        out = ResultAddresses.of_any(sink.seen, sink.status)
    else:
        at = HitAddresses.of(sink.hits)
        out = ResultAddresses(*at, ZERO_U64, np.uint64(sink.status.ctypes.data))
    return bvh.view, _source(bvh, batch), NearestWanted(batch.wants_any, None, out)


def _packets(bvh: Structure, batch: Batch) -> Calls:
    return trace_packets, _arguments(bvh, batch)


def _groups(bvh: Structure, batch: Batch) -> Calls:
    return trace_groups, _arguments(bvh, batch)


def _suited(coherence: Coherence, count: int, byte_count: int) -> tuple[str, ...]:
    is_packet = choose_kernel(coherence, count, byte_count) == "packet"
    return ("packet",) if is_packet else ("groups",)


#: Least packets of a call. To pass the arguments of a call takes as long as to trace half a packet
#: through a small mesh, and to wake another thread as long as several: 1,000 rays on one thread
#: take three quarters of the time that they take on two.
_LEAST = 4


def _of_groups(bind: Callable[..., Calls]) -> BatchKernel:
    return BatchKernel(bind, _LEAST, BLOCK_PACKETS, share=4, memory_bytes=WORKING_BYTES)


_KERNELS = {
    "packet": BatchKernel(_packets, _LEAST, 64, share=4, is_tiled=True),
    "groups": _of_groups(_groups),
}

_NEAREST = BatchKernels(_KERNELS, _suited, _FEW)
_VISITED, _COUNTED_BY_PACKETS = all_hits_kernels(TREES, FLOAT64_ALL, _source)
_COUNTED = {
    "packet": _COUNTED_BY_PACKETS,
    "groups": _of_groups(partial(count_all, count_in_groups, _source)),
}

#: The kernels by the kind of query, for trees that are not empty.
BATCH_KERNELS = {
    Kind.FIRST_HIT: _NEAREST,
    Kind.ANY_HIT: _NEAREST,
    Kind.MULTI_HIT: BatchKernels({"packet": _VISITED}, _suited, _FEW),
    Kind.COUNT_HITS: BatchKernels(_COUNTED, _suited, _FEW),
}

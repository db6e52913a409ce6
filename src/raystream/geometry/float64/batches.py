"""The kernels for many rays in float64, and which of them suits a batch."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from raystream.geometry.float64.group_rays import Float64Packets
from raystream.geometry.float64.groups import (
    BLOCK_PACKETS,
    WORKING_BYTES,
    trace_groups,
    trace_rows,
)
from raystream.geometry.float64.packets import FLOAT64_ALL, trace_packets
from raystream.kernels.aligned import array_address
from raystream.structures.batch_kernels import (
    Batch,
    BatchKernel,
    BatchKernels,
    CallSize,
    by_kind,
)
from raystream.structures.bvh.batches import nearest_kernel
from raystream.structures.bvh.coherence import Coherence, choose_kernel
from raystream.structures.bvh.packets.multi_hit import all_hits_kernels, count_all, deliver_all
from raystream.structures.bvh.packets.queries import TREES

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


def _suited(coherence: Coherence, count: int, byte_count: int) -> tuple[str, ...]:
    is_packet = choose_kernel(coherence, count, byte_count) == "packet"
    return ("packet",) if is_packet else ("groups",)


#: Least packets of a call. To pass the arguments of a call takes as long as to trace half a packet
#: through a small mesh, and to wake another thread as long as several: 1,000 rays on one thread
#: take three quarters of the time that they take on two.
_LEAST = 4


_GROUPS_SIZE = CallSize(_LEAST, BLOCK_PACKETS, share=4, memory_bytes=WORKING_BYTES)

_KERNELS = {
    "packet": nearest_kernel(trace_packets, CallSize(_LEAST, 64, share=4), True, _source),
    "groups": nearest_kernel(trace_groups, _GROUPS_SIZE, False, _source),
}

_NEAREST = BatchKernels(_KERNELS, _suited, _FEW)
_ALL_HITS = all_hits_kernels(TREES, FLOAT64_ALL, _source)
_BY_GROUPS = (
    BatchKernel(
        partial(deliver_all, trace_rows, _source, by_ray=True),
        _GROUPS_SIZE._replace(joins_chunks=False),
    ),
    BatchKernel(partial(count_all, trace_rows, _source), _GROUPS_SIZE),
)

#: The kernels by the kind of query, for trees that are not empty.
BATCH_KERNELS = by_kind(_NEAREST, _ALL_HITS, others={"groups": _BY_GROUPS})

"""The kernels for many rays through instances, and which of them suits a batch."""

from __future__ import annotations

from typing import TYPE_CHECKING

from raystream.geometry.instances.groups import BLOCK_PACKETS, CALL_BYTES, trace_instances
from raystream.geometry.instances.in_flight import trace_instance_wavefront
from raystream.geometry.instances.packets import INSTANCES
from raystream.structures.batch_kernels import (
    Batch,
    BatchKernel,
    BatchKernels,
    Calls,
    CallSize,
    by_kind,
)
from raystream.structures.bvh.batches import NEAREST_SIZE, nearest_kernel
from raystream.structures.bvh.coherence import Coherence
from raystream.structures.bvh.packets.multi_hit import all_hits_kernels
from raystream.structures.bvh.packets.queries import NEAREST, packet_kernel

if TYPE_CHECKING:
    from raystream.geometry.instances.structure import InstancedStructure

#: Batches of at most this many rays are traced ray by ray: lists of few rays share few instances.
_FEW = 2047


def _wavefront(scene: InstancedStructure, batch: Batch) -> Calls:
    rays = scene.view, scene.frame, batch.source
    shared = batch.wants_any, batch.query.on_hit, batch.results
    return trace_instance_wavefront, (*rays, *shared)


def _suited(coherence: Coherence, count: int, byte_count: int) -> tuple[str, ...]:
    del count, byte_count
    if coherence.narrow >= 0.5:
        return "groups", "packet"
    return ("groups", "wavefront") if coherence.near >= 0.5 else ("wavefront", "groups")


_GROUPS_SIZE = NEAREST_SIZE._replace(block=BLOCK_PACKETS, memory_bytes=CALL_BYTES)

_KERNELS = {
    "groups": nearest_kernel(trace_instances, _GROUPS_SIZE),
    "packet": nearest_kernel(packet_kernel(INSTANCES, NEAREST)),
    "wavefront": BatchKernel(_wavefront, CallSize(4096, 4096), by_packets=False),
}


def _suited_to_all(coherence: Coherence, count: int, byte_count: int) -> tuple[str, ...]:
    del count, byte_count
    return ("packet",) if coherence.narrow >= 0.5 else ("single",)


#: The kernels by the kind of query, for trees that are not empty.
BATCH_KERNELS = by_kind(
    BatchKernels(_KERNELS, _suited, _FEW), all_hits_kernels(INSTANCES), _suited_to_all
)

"""The kernels for many rays through instances, and which of them suits a batch."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from raystream.geometry.instances.groups import BLOCK_PACKETS, CALL_BYTES, trace_instances
from raystream.geometry.instances.in_flight import (
    instance_hits_in_flight,
    trace_instance_wavefront,
)
from raystream.geometry.instances.packets import INSTANCES
from raystream.structures.batch_kernels import (
    Batch,
    BatchKernels,
    CallSize,
    by_kind,
)
from raystream.structures.bvh.batches import (
    NEAREST_SIZE,
    in_flight_if_large,
    nearest_in_flight,
    nearest_kernel,
)
from raystream.structures.bvh.coherence import Coherence
from raystream.structures.bvh.packets.multi_hit import all_hits_kernels
from raystream.structures.bvh.packets.queries import NEAREST, packet_kernel
from raystream.structures.bvh.walks.all_hits import all_hits_in_flight

if TYPE_CHECKING:
    from raystream.geometry.instances.structure import InstancedStructure

#: Batches of at most this many rays are traced ray by ray: lists of few rays share few instances.
_FEW = 2047


def _scene_of(scene: InstancedStructure, batch: Batch) -> tuple[Any, ...]:
    return scene.view, scene.frame, batch.source


def _suited(coherence: Coherence, count: int, byte_count: int) -> tuple[str, ...]:
    del count, byte_count
    if coherence.narrow >= 0.5:
        return "groups", "packet"
    return ("groups", "wavefront") if coherence.near >= 0.5 else ("wavefront", "groups")


_GROUPS_SIZE = NEAREST_SIZE._replace(block=BLOCK_PACKETS, memory_bytes=CALL_BYTES)

#: Calls of rays in flight.
_IN_FLIGHT_SIZE = CallSize(4096, 4096)

_KERNELS = {
    "groups": nearest_kernel(trace_instances, _GROUPS_SIZE),
    "packet": nearest_kernel(packet_kernel(INSTANCES, NEAREST)),
    "wavefront": nearest_in_flight(trace_instance_wavefront, _scene_of, _IN_FLIGHT_SIZE),
}


def _suited_to_all(coherence: Coherence, count: int, byte_count: int) -> tuple[str, ...]:
    del count
    return ("packet",) if coherence.narrow >= 0.5 else (in_flight_if_large(byte_count),)


_ALL_IN_FLIGHT = all_hits_in_flight(
    instance_hits_in_flight, _scene_of, _IN_FLIGHT_SIZE, in_world=True
)


#: The kernels by the kind of query, for trees that are not empty.
BATCH_KERNELS = by_kind(
    BatchKernels(_KERNELS, _suited, _FEW),
    all_hits_kernels(INSTANCES),
    _suited_to_all,
    {"wavefront": _ALL_IN_FLIGHT},
)

"""The kernels for many rays through instances, and which of them suits a batch."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from raystream.core.query import Kind
from raystream.instances.packets import trace_instance_packets
from raystream.instances.streams import BLOCK_PACKETS, CALL_BYTES, trace_instances
from raystream.instances.wavefront import trace_instance_wavefront
from raystream.structures.batch_kernels import Batch, BatchKernel, BatchKernels, Calls
from raystream.structures.bvh.coherence import Coherence

if TYPE_CHECKING:
    from raystream.instances.structure import InstancedStructure

#: Batches of at most this many rays are traced ray by ray: lists of few rays share few instances.
_FEW = 2047


def _groups(scene: InstancedStructure, batch: Batch) -> Calls:
    return trace_instances, _of_packets(scene, batch)


def _packets(scene: InstancedStructure, batch: Batch) -> Calls:
    return trace_instance_packets, _of_packets(scene, batch)


def _of_packets(scene: InstancedStructure, batch: Batch) -> tuple[Any, ...]:
    rays = scene.arrays, batch.packets(scene.frame)
    return (*rays, batch.wants_any, batch.query.on_hit, batch.results)


def _wavefront(scene: InstancedStructure, batch: Batch) -> Calls:
    rays = scene.arrays, scene.frame, batch.source
    shared = batch.wants_any, batch.query.on_hit, batch.results
    return trace_instance_wavefront, (*rays, *shared)


def _suited(coherence: Coherence, count: int, byte_count: int) -> tuple[str, ...]:
    del count, byte_count
    if coherence.narrow >= 0.5:
        return "groups", "packet"
    return ("groups", "wavefront") if coherence.near >= 0.5 else ("wavefront", "groups")


_KERNELS = {
    "groups": BatchKernel(
        _groups,
        4,
        64,
        BLOCK_PACKETS,
        is_tiled=True,
        takes_filter=True,
        memory_bytes=CALL_BYTES,
    ),
    "packet": BatchKernel(_packets, 4, 64, is_tiled=True, takes_filter=True),
    "wavefront": BatchKernel(_wavefront, 4096, 4096, by_packets=False, takes_filter=True),
}

#: The kernels by the kind of query, for trees that are not empty.
BATCH_KERNELS = dict.fromkeys((Kind.FIRST_HIT, Kind.ANY_HIT), BatchKernels(_KERNELS, _suited, _FEW))

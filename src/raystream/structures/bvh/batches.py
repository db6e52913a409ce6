"""The kernels for many rays of a BVH, and which of them suits a batch."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any

from raystream.structures.batch_kernels import (
    SINGLE,
    Batch,
    BatchKernel,
    BatchKernels,
    Calls,
    CallSize,
    by_kind,
)
from raystream.structures.bvh.coherence import Coherence, choose_kernel, rivals
from raystream.structures.bvh.options import Bvh
from raystream.structures.bvh.packets.multi_hit import SourceOf, all_hits_kernels, plain_source
from raystream.structures.bvh.packets.queries import NEAREST, TREES, NearestWanted, packet_kernel
from raystream.structures.bvh.ray_groups.queries import trace_groups
from raystream.structures.bvh.ray_groups.rays import BLOCK_PACKETS, MEMORY_BYTES
from raystream.structures.bvh.walks.all_hits import SceneOf, all_hits_in_flight, triangles_in_flight
from raystream.structures.bvh.walks.in_flight import trace_wavefront

if TYPE_CHECKING:
    from raystream.structures.base import Structure
    from raystream.structures.bvh.structure import BvhStructure

#: Kernels: chosen for each batch; many single rays in flight; packets of rays; streams of groups of
#: rays, in the order of the batch; one ray after another.
KERNELS = Bvh.choices("kernel")

#: Batches of at most this many rays are traced by the calling thread: waking others takes longer.
SMALL_BATCH = 1024

#: Larger trees do not stay in the cache: their nodes are prefetched.
CACHED_BYTES = 1 << 21


#: Calls of packets.
NEAREST_SIZE = CallSize(4, 64)


def _nearest_of(
    trace: Callable[..., object], scene_of: SceneOf, structure: Structure, batch: Batch
) -> Calls:
    wanted = NearestWanted(batch.wants_any, batch.query.on_hit, batch.results)
    return trace, (*scene_of(structure, batch), wanted)


def _packets(source_of: SourceOf, structure: Structure, batch: Batch) -> tuple[Any, ...]:
    return structure.view, source_of(structure, batch)


def nearest_kernel(
    trace: Callable[..., object],
    size: CallSize = NEAREST_SIZE,
    is_tiled: bool = True,
    source_of: SourceOf = plain_source,
) -> BatchKernel:
    """The kernel that finds the nearest or any hits, as a function for a `NearestWanted`."""
    scene_of = partial(_packets, source_of)
    return BatchKernel(partial(_nearest_of, trace, scene_of), size, is_tiled=is_tiled)


def nearest_in_flight(
    trace: Callable[..., object], scene_of: SceneOf, size: CallSize
) -> BatchKernel:
    """The same for rays in flight."""
    return BatchKernel(partial(_nearest_of, trace, scene_of), size, by_packets=False)


def _suited(coherence: Coherence, count: int, byte_count: int) -> tuple[str, ...]:
    guess = choose_kernel(coherence, count, byte_count)
    return guess, *rivals(coherence, guess)


def _scene_of(bvh: BvhStructure, batch: Batch) -> tuple[Any, ...]:
    return bvh.view, bvh.frame, batch.source, bvh.report.byte_count > CACHED_BYTES


#: Calls of rays in flight: fewer would not use all slots at the start and the end of a call.
IN_FLIGHT_SIZE = CallSize(1024, 8192)

_GROUPS_SIZE = NEAREST_SIZE._replace(block=BLOCK_PACKETS, memory_bytes=MEMORY_BYTES)

_NEAREST = {
    "packet": nearest_kernel(packet_kernel(TREES, NEAREST)),
    "groups": nearest_kernel(trace_groups, _GROUPS_SIZE, is_tiled=False),
    "wavefront": nearest_in_flight(trace_wavefront, _scene_of, IN_FLIGHT_SIZE),
}
_FIRST_OR_ANY = BatchKernels(_NEAREST, _suited, SMALL_BATCH, "wavefront")


def in_flight_if_large(byte_count: int) -> str:
    """How incoherent rays are best traced whose hits are all wanted, by the bytes of the trees.

    (In flight, random rays take 0.46 to 0.76 of the time of one by one in trees of 8 to 30 MB, and
    0.93 to 1.13 in small ones.)
    """
    return "wavefront" if byte_count > CACHED_BYTES else SINGLE


def _suited_to_all(coherence: Coherence, count: int, byte_count: int) -> tuple[str, ...]:
    is_packet = choose_kernel(coherence, count, byte_count) == "packet"
    return ("packet",) if is_packet else (in_flight_if_large(byte_count),)


#: The kernels by the kind of query, for trees that are not empty.
BATCH_KERNELS = by_kind(
    _FIRST_OR_ANY,
    all_hits_kernels(TREES),
    _suited_to_all,
    {"wavefront": all_hits_in_flight(triangles_in_flight, _scene_of, IN_FLIGHT_SIZE)},
)

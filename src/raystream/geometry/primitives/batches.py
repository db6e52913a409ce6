"""The kernels for many rays through triangles, height fields and spheres."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from raystream.core.query import Kind
from raystream.geometry.primitives.in_flight import (
    PrimitiveTrees,
    primitive_wavefront,
    trace_primitive_wavefront,
)
from raystream.geometry.primitives.packets import PRIMITIVES
from raystream.jit.constants import ZERO_U64
from raystream.structures.batch_kernels import (
    SINGLE,
    Batch,
    BatchKernels,
    by_kind,
)
from raystream.structures.bvh.batches import (
    IN_FLIGHT_SIZE,
    SMALL_BATCH,
    nearest_in_flight,
    nearest_kernel,
)
from raystream.structures.bvh.coherence import Coherence, choose_kernel
from raystream.structures.bvh.packets.multi_hit import all_hits_kernels
from raystream.structures.bvh.packets.queries import NEAREST, packet_kernel
from raystream.structures.bvh.walks.all_hits import all_hits_in_flight

if TYPE_CHECKING:
    from raystream.geometry.primitives.structure import PrimitiveBvh


def _scene_of(scene: PrimitiveBvh, batch: Batch) -> tuple[Any, ...]:
    held = scene.view
    others = held._replace(sphere_nodes=ZERO_U64)
    trees = PrimitiveTrees(held.sphere_nodes, held.sphere_blocks, others)
    return trees, scene.frame, batch.source, True


#: Smaller trees of spheres are in the nearest cache.
_LEAST_BYTES = 1 << 18

_PACKET = nearest_kernel(packet_kernel(PRIMITIVES, NEAREST))
_IN_FLIGHT = nearest_in_flight(trace_primitive_wavefront, _scene_of, IN_FLIGHT_SIZE)
_ALL_HITS = all_hits_kernels(PRIMITIVES)
_ALL_IN_FLIGHT = all_hits_in_flight(primitive_wavefront, _scene_of, IN_FLIGHT_SIZE)


def batch_kernels(sphere_bytes: int) -> dict[Kind, BatchKernels]:
    """The kernels by the kind of query, of a scene whose spheres take some bytes with their tree.

    Incoherent rays are traced one by one unless the spheres' tree is large: a terrain's nodes take
    few bytes. (Random rays in flight take 0.95 to 1.03 of the time of one by one with 1,000
    spheres, 0.79 to 0.86 with 10,000, 0.64 to 0.69 with 30,000, 0.4 to 0.53 with 100,000.)
    """
    otherwise = "wavefront" if sphere_bytes > _LEAST_BYTES else SINGLE

    def suited(coherence: Coherence, count: int, byte_count: int) -> tuple[str, ...]:
        is_packet = choose_kernel(coherence, count, byte_count) == "packet"
        return ("packet",) if is_packet else (otherwise,)

    if not sphere_bytes:
        return by_kind(BatchKernels({"packet": _PACKET}, suited, SMALL_BATCH), _ALL_HITS)
    kernels = {"packet": _PACKET, "wavefront": _IN_FLIGHT}
    nearest = BatchKernels(kernels, suited, SMALL_BATCH)
    return by_kind(nearest, _ALL_HITS, others={"wavefront": _ALL_IN_FLIGHT})

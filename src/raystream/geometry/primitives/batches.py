"""The kernels for many rays through triangles, height fields, spheres and shapes."""

from __future__ import annotations

from typing import TYPE_CHECKING

from raystream.core.query import Kind
from raystream.geometry.primitives.in_flight import PrimitiveTrees, trace_primitive_wavefront
from raystream.geometry.primitives.packets import PRIMITIVES
from raystream.jit.constants import ZERO_U64
from raystream.structures.batch_kernels import (
    Batch,
    BatchKernel,
    BatchKernels,
    Calls,
    by_kind,
)
from raystream.structures.bvh.batches import (
    CACHED_BYTES,
    IN_FLIGHT_SIZE,
    SMALL_BATCH,
    nearest_kernel,
)
from raystream.structures.bvh.coherence import Coherence, choose_kernel
from raystream.structures.bvh.packets.multi_hit import all_hits_kernels
from raystream.structures.bvh.packets.queries import NEAREST, packet_kernel

if TYPE_CHECKING:
    from raystream.geometry.primitives.structure import PrimitiveBvh


def _wavefront(scene: PrimitiveBvh, batch: Batch) -> Calls:
    held = scene.view
    others = held._replace(sphere_nodes=ZERO_U64)
    trees = PrimitiveTrees(held.sphere_nodes, held.sphere_blocks, others)
    rays = trees, scene.frame, batch.source
    shared = batch.wants_any, True, batch.query.on_hit, batch.results
    return trace_primitive_wavefront, (*rays, *shared)


_PACKET = nearest_kernel(packet_kernel(PRIMITIVES, NEAREST))
_IN_FLIGHT = BatchKernel(_wavefront, IN_FLIGHT_SIZE, by_packets=False)
_ALL_HITS = all_hits_kernels(PRIMITIVES)


def batch_kernels(sphere_bytes: int) -> dict[Kind, BatchKernels]:
    """The kernels by the kind of query, of a scene whose spheres take some bytes with their tree.

    Incoherent rays are traced one by one unless the spheres' tree is too large for the cache: a
    terrain's nodes take few bytes. (Random rays in flight against one by one: 0.9 to 1.2 times as
    fast with 10,000 spheres, 1.25 to 1.4 with 30,000, 3.1 to 3.3 with 1,000,000.)
    """
    otherwise = "wavefront" if sphere_bytes > CACHED_BYTES else "single"

    def suited(coherence: Coherence, count: int, byte_count: int) -> tuple[str, ...]:
        is_packet = choose_kernel(coherence, count, byte_count) == "packet"
        return ("packet",) if is_packet else (otherwise,)

    in_flight = {"wavefront": _IN_FLIGHT} if sphere_bytes else {}
    nearest = BatchKernels({"packet": _PACKET, **in_flight}, suited, SMALL_BATCH)
    return by_kind(nearest, _ALL_HITS)

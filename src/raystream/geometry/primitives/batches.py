"""The kernels for many rays through triangles, height fields, spheres and shapes."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NamedTuple

from raystream.core.query import Kind
from raystream.geometry.primitives.fields_in_flight import MOST_CELLS, field_in_flight
from raystream.geometry.primitives.in_flight import (
    NEAREST_IN_SLOT,
    PrimitiveTrees,
    spheres_in_flight,
)
from raystream.geometry.primitives.packets import PRIMITIVES
from raystream.jit.constants import NULL, ZERO_U64
from raystream.structures.batch_kernels import (
    SINGLE,
    Batch,
    BatchKernel,
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
from raystream.structures.bvh.walks.all_hits import SceneOf, SlotSearches, all_hits_in_flight

if TYPE_CHECKING:
    from raystream.geometry.primitives.structure import PrimitiveBvh


def _spheres_of(scene: PrimitiveBvh, batch: Batch) -> tuple[Any, ...]:
    held = scene.view
    others = held._replace(sphere_nodes=ZERO_U64)
    trees = PrimitiveTrees(held.sphere_nodes, held.sphere_blocks, others)
    return trees, scene.frame, batch.source, True


def _field_of(scene: PrimitiveBvh, batch: Batch) -> tuple[Any, ...]:
    held = scene.view
    trees = PrimitiveTrees(held.fields, NULL, held._replace(field_count=ZERO_U64))
    return trees, scene.frame, batch.source, True


class _InFlight(NamedTuple):
    """Kernels with one of the trees in flight: of the nearest or any hits, and of all hits."""

    nearest: BatchKernel
    all_hits: tuple[BatchKernel, BatchKernel]

    @classmethod
    def of(cls, kernel_of: Callable[[SlotSearches], Any], scene_of: SceneOf) -> _InFlight:
        nearest = nearest_in_flight(kernel_of(NEAREST_IN_SLOT), scene_of, IN_FLIGHT_SIZE)
        return cls(nearest, all_hits_in_flight(kernel_of, scene_of, IN_FLIGHT_SIZE))


_SPHERES = _InFlight.of(spheres_in_flight, _spheres_of)
_FIELD = _InFlight.of(field_in_flight, _field_of)
_PACKET, _ALL_HITS = (
    nearest_kernel(packet_kernel(PRIMITIVES, NEAREST)),
    all_hits_kernels(PRIMITIVES),
)

#: Smaller trees of spheres, and fields of fewer cells, are in the nearest cache.
_LEAST_BYTES, _LEAST_CELLS = 1 << 18, 1 << 19


def batch_kernels(sphere_bytes: int, sides: tuple[int, int] | None) -> dict[Kind, BatchKernels]:
    """The kernels by the kind of query.

    Incoherent rays are traced one by one unless the spheres' tree or a height field is large.
    (Random rays in flight take 0.95 to 1.03 of the time of one by one with 1,000 spheres, 0.79 to
    0.86 with 10,000, 0.64 to 0.69 with 30,000, 0.4 to 0.53 with 100,000; 0.76 to 0.85 with a field
    of 800 x 800 samples, 0.61 to 0.66 with 2,000 x 2,000.)

    Parameters
    ----------
    sphere_bytes : int
        Of the spheres with their tree.
    sides : tuple of two int, or None
        Cells along the sides of the only height field; None if there is none, or several.
    """
    is_large = sphere_bytes > _LEAST_BYTES
    fits = sides is not None and max(sides) <= MOST_CELLS
    in_flight = _SPHERES if sphere_bytes else None
    if not is_large and sides is not None and fits:
        is_large = sides[0] * sides[1] >= _LEAST_CELLS
        in_flight = _FIELD if is_large or not sphere_bytes else _SPHERES

    def suited(coherence: Coherence, count: int, byte_count: int) -> tuple[str, ...]:
        is_packet = choose_kernel(coherence, count, byte_count) == "packet"
        return ("packet",) if is_packet else ("wavefront" if is_large else SINGLE,)

    kernels, others = {"packet": _PACKET}, {}
    if in_flight:
        kernels["wavefront"], others["wavefront"] = in_flight.nearest, in_flight.all_hits
    return by_kind(BatchKernels(kernels, suited, SMALL_BATCH), _ALL_HITS, others=others)

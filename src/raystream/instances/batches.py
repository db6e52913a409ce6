"""Choose the kernel for a batch of rays through instances, and run it on all threads."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.core.query import Kind, Query
from raystream.core.rays import RayBatch
from raystream.instances.packets import trace_instance_packets
from raystream.instances.streams import BLOCK_PACKETS, CALL_BYTES, trace_instances
from raystream.instances.traversal import TopAddresses
from raystream.instances.wavefront import trace_instance_wavefront
from raystream.jit.threads import Progress, parallel_for, thread_count
from raystream.kernels.aligned import aligned_array
from raystream.kernels.hit_filter import HitFilter
from raystream.kernels.hits import Sink
from raystream.kernels.ray import SceneFrame
from raystream.kernels.ray_source import RaySource, ResultAddresses
from raystream.structures.bvh.coherence import Coherence, probe
from raystream.structures.bvh.image_rows import BatchOrder
from raystream.structures.bvh.kernel_choice import packet_order, reported_rays
from raystream.structures.bvh.packet_rays import PacketOrder, PacketSource
from raystream.structures.bvh.race import LEAST_RACE, Races, run_race

#: Batches of fewer rays are traced ray by ray: lists of few rays share few instances.
_LEAST_RAYS = 2048

#: Rays per call of the wavefront.
_WAVEFRONT_CHUNK = 4096

#: Most packets per call of the kernel for groups.
_MOST_PACKETS = 64


class InstanceTree(NamedTuple):
    """The instances of a scene as `trace_batch` takes them.

    Attributes
    ----------
    top : TopAddresses
        Of a scene without worlds.
    frame : SceneFrame
    byte_count : int
        Size of all trees.
    queries : RayQueries
        Those of single rays.
    """

    top: TopAddresses
    frame: SceneFrame
    byte_count: int
    queries: Any


def trace_batch(
    tree: InstanceTree,
    query: Query,
    batch: RayBatch,
    sink: Sink,
    progress: Progress | None,
    kernel: str,
    races: Races,
) -> bool:
    """Find the nearest hit of each ray, or whether there is one; see `Structure.trace_batch`.

    Parameters
    ----------
    tree : InstanceTree
        Not empty.
    query : Query
    batch : RayBatch
    sink : Sink
    progress : callable, optional
        Called with (rays done, rays).
    kernel : str
        See `Bvh`.
    races : Races
        Results of earlier races on this tree; updated.

    Returns
    -------
    bool
        False for batches that are traced ray by ray, and other queries.
    """
    count, wants_any = len(batch), query.kind is Kind.ANY_HIT
    if query.kind not in (Kind.FIRST_HIT, Kind.ANY_HIT) or kernel == "single":
        return False
    if count == 0 or (kernel == "auto" and count < _LEAST_RAYS):
        return False
    source, kept = RaySource.of(batch.origins, batch.directions, batch.limits, True)
    order = packet_order(BatchOrder(PacketOrder.of(batch.shape)), source, tree.frame)
    out = (
        ResultAddresses.of_any(sink.seen, sink.status)
        if wants_any
        else ResultAddresses.of_first(sink.memory, sink.status)
    )
    runs = _runs(tree, source, order, wants_any, query.on_hit, out)
    if kernel != "auto":
        runs[kernel](0, count, progress)
        return True
    found = probe(source, order.packets, tree.frame, tree.byte_count)
    names = _candidates(found)
    if count < LEAST_RACE:
        runs[names[0]](0, count, progress)
        return True
    has_filter = query.on_hit is not None
    kind = wants_any, has_filter, count.bit_length(), *found.kind()
    cold = [name for name in names if (name, has_filter) not in _loaded]
    name, is_due = races.plan(kind, names, not cold)
    if is_due:

        def run(name: str, begin: int, end: int, progress: Progress | None) -> None:
            runs[name](begin, end, progress)
            _loaded.add((name, has_filter))

        run_race(names, count, lambda ray: order.cut(ray).ray, run, races, kind, progress, cold)
    else:
        runs[name](0, count, progress)
    del kept  # the kernels read it by address
    return True


#: Kernels that have traced a race in this process, without or with a filter: those are loaded.
_loaded: set[tuple[str, bool]] = set()


def _candidates(found: Coherence) -> tuple[str, str]:
    """Kernels for rays of a coherence: the one that is thought the fastest, and a rival."""
    if found.narrow >= 0.5:
        return "groups", "packet"
    return ("groups", "wavefront") if found.near >= 0.5 else ("wavefront", "groups")


def _runs(
    tree: InstanceTree,
    source: RaySource,
    order: BatchOrder,
    wants_any: bool,
    filter_: HitFilter | None,
    out: ResultAddresses,
) -> dict[str, Callable[[int, int, Progress | None], None]]:
    """What traces the rays between two cuts of an order, by kernel."""
    packets = PacketSource(source, order.packets, tree.frame, out.status)

    def by_groups(begin: int, end: int, progress: Progress | None) -> None:
        free: list[NDArray[np.float32]] = []  # for each thread: new pages take a tenth of the time

        def body(low: int, high: int) -> None:
            try:
                memory = free.pop()
            except IndexError:
                memory = aligned_array(1, CALL_BYTES // 4)
            at = memory.ctypes.data
            trace_instances(low, high, tree.top, packets, wants_any, filter_, at, out)
            free.append(memory)

        trace(body, begin, end, BLOCK_PACKETS, progress)

    def by_packets(begin: int, end: int, progress: Progress | None) -> None:
        def body(low: int, high: int) -> None:
            trace_instance_packets(low, high, tree.top, packets, wants_any, filter_, out)

        trace(body, begin, end, 1, progress)

    def trace(
        body: Callable[[int, int], None],
        begin: int,
        end: int,
        block: int,
        progress: Progress | None,
    ) -> None:
        """Trace the packets between two cuts, in whole blocks of some where there are many."""
        start = order.cut(begin).packet
        packet_count = order.cut(end).packet - start
        share = -(-packet_count // (8 * thread_count()))
        if share > block:
            share = min(share // block * block, _MOST_PACKETS)
        report = reported_rays(progress, end - begin, packet_count)
        parallel_for(
            lambda low, high: body(start + low, start + high),
            packet_count,
            max(4, share),
            report,
            joins_chunks=True,
        )

    def in_flight(begin: int, end: int, progress: Progress | None) -> None:
        def body(low: int, high: int) -> None:
            trace_instance_wavefront(
                begin + low, begin + high, tree.top, tree.frame, source, wants_any, filter_, out
            )

        parallel_for(body, end - begin, _WAVEFRONT_CHUNK, progress)

    return {"groups": by_groups, "packet": by_packets, "wavefront": in_flight}


def instance_bytes(ray_count: int) -> int:
    """Most bytes that `trace_batch` needs: tables of rows and packets, and lists of rays."""
    return 2 * ray_count + thread_count() * CALL_BYTES

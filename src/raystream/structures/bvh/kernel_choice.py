"""Choose the kernel for a batch of rays, and run it on all threads."""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np

from raystream.core.query import Query
from raystream.core.rays import RayBatch
from raystream.jit.threads import Progress, parallel_for, thread_count
from raystream.kernels.hit_filter import HitFilter
from raystream.kernels.hits import Sink
from raystream.kernels.ray import SceneFrame
from raystream.kernels.ray_source import RaySource, ResultAddresses
from raystream.structures.bvh.coherence import choose_kernel, probe, rivals
from raystream.structures.bvh.group_rays import MEMORY_BYTES
from raystream.structures.bvh.group_stream import BLOCK_PACKETS, trace_groups
from raystream.structures.bvh.image_rows import LEAST_RAYS, BatchOrder, find_order
from raystream.structures.bvh.layout import BvhArrays, TreeAddresses
from raystream.structures.bvh.options import Bvh
from raystream.structures.bvh.packet import trace_packets
from raystream.structures.bvh.packet_multi_hit import count_all, visit_all
from raystream.structures.bvh.packet_rays import PacketOrder, PacketSource
from raystream.structures.bvh.race import LEAST_RACE, Races, run_race
from raystream.structures.bvh.wavefront import trace_wavefront

#: Kernels: chosen for each batch; many single rays in flight; packets of rays; streams of groups of
#: rays, in the order of the batch; one ray after another.
KERNELS = Bvh.choices("kernel")

#: Batches of at most this many rays are traced by the calling thread: waking others takes longer.
SMALL_BATCH = 1024

#: Rays per call of a kernel: enough to hide the start and the end of a call, where not all slots of
#: a wavefront are in use; few enough that the threads finish together and Ctrl-C is noticed.
LEAST_CHUNK = 1024
MOST_CHUNK = 8192

#: The same for packets of 256 rays.
MOST_PACKETS = 64

#: Larger trees do not stay in the cache: their nodes are prefetched.
PREFETCHED_BYTES = 1 << 21


class Tree(NamedTuple):
    """A tree as the kernels take it.

    Attributes
    ----------
    addresses : TreeAddresses
    frame : SceneFrame
    byte_count : int
    """

    addresses: TreeAddresses
    frame: SceneFrame
    byte_count: int

    @property
    def prefetching(self) -> bool:
        """Whether nodes are prefetched."""
        return self.byte_count > PREFETCHED_BYTES

    @classmethod
    def of(cls, arrays: BvhArrays, frame: SceneFrame) -> Tree:
        """A tree whose arrays the caller keeps alive."""
        nodes, leaves = (array.ctypes.data if len(array) else 0 for array in arrays)
        byte_count = sum(array.nbytes for array in arrays)
        return cls(TreeAddresses(np.uint64(nodes), np.uint64(leaves)), frame, byte_count)


class _Batch(NamedTuple):
    """A batch, and where its results go, for the kernels of `_TRACERS`."""

    tree: Tree
    source: RaySource
    order: BatchOrder
    wants_any: bool
    filter_: HitFilter | None
    results: ResultAddresses


def trace_batch(
    tree: Tree,
    batch: RayBatch,
    wants_any: bool,
    filter_: HitFilter | None,
    results: ResultAddresses,
    progress: Progress | None,
    kernel: str = "auto",
    races: Races | None = None,
) -> None:
    """Find the nearest hit of each ray, or whether there is one.

    Parameters
    ----------
    tree : Tree
        Not empty.
    batch : RayBatch
    wants_any : bool
    filter_ : HitFilter, optional
        Decides which hits exist.
    results : ResultAddresses
    progress : callable, optional
        Called with (rays done, rays).
    kernel : {"auto", "wavefront", "packet", "groups"}
        "auto" takes the wavefront for at most `SMALL_BATCH` rays; for more, the kernel that suits
        a sample of them, or is the fastest of those that may.
    races : Races, optional
        Results of earlier races on this tree; updated. No races without.
    """
    count = len(batch)
    if kernel == "auto" and count <= SMALL_BATCH:
        kernel = "wavefront"
    source, kept = RaySource.of(
        batch.origins, batch.directions, batch.limits, kernel != "wavefront"
    )
    order = BatchOrder(PacketOrder.of(batch.shape))
    work = _Batch(tree, source, order, wants_any, filter_, results)
    if kernel == "wavefront" or count == 0:  # without further preparation, for small batches
        _trace_wavefront(work, 0, count, progress)
        return
    if kernel == "packet":
        work = work._replace(order=packet_order(work.order, source, tree.frame))
    if kernel != "auto":
        _TRACERS[kernel](work, 0, count, progress)
        return
    found = probe(source, order.packets, tree.frame, tree.byte_count)
    guess = choose_kernel(found, count, tree.byte_count)
    names: tuple[str, ...] = (guess,)
    if races is not None and count >= LEAST_RACE:
        names += rivals(found, guess)
    if "packet" in names:
        work = work._replace(order=packet_order(work.order, source, tree.frame))
    if len(names) > 1 and races is not None:
        kind = (wants_any, filter_ is not None, count.bit_length(), *found.kind())
        _trace_raced(names, kind, work, races, progress)
    else:
        _TRACERS[names[0]](work, 0, count, progress)
    del kept  # the kernels read it by address


def _trace_raced(
    names: tuple[str, ...],
    kind: tuple[int, ...],
    work: _Batch,
    races: Races,
    progress: Progress | None,
) -> None:
    """Trace a batch by the fastest kernel, as far as that is known."""
    count, has_filter = int(work.order.packets.ray_count), work.filter_ is not None
    cold = [name for name in names if (name, has_filter) not in _loaded]
    name, is_due = races.plan(kind, names, not cold)

    def run(name: str, begin: int, end: int, progress: Progress | None) -> None:
        _TRACERS[name](work, begin, end, progress)
        _loaded.add((name, has_filter))

    def cut(ray: int) -> int:
        return work.order.cut(ray).ray

    if is_due:
        run_race(names, count, cut, run, races, kind, progress, cold)
    else:
        run(name, 0, count, progress)


def packet_order(order: BatchOrder, source: RaySource, frame: SceneFrame) -> BatchOrder:
    """The order of a batch's packets: tiles of its rows, if it is flat and they are found."""
    count = int(order.packets.ray_count)
    if order.packets.width or count < LEAST_RAYS:
        return order
    return find_order(source, count, frame)


def kernel_bytes(kernel: str, ray_count: int) -> int:
    """Most bytes that `trace_batch` needs: of the kernel, or of those that "auto" chooses from."""
    if kernel == "wavefront" or (kernel == "auto" and ray_count <= SMALL_BATCH):
        return 0
    order = 2 * ray_count  # the tables of rows and packets
    needed = {"packet": order, "groups": thread_count() * MEMORY_BYTES}
    return order + max(needed.values()) if kernel == "auto" else needed[kernel]


def visit_batch(
    tree: Tree,
    query: Query,
    rays: RayBatch,
    sink: Sink,
    progress: Progress | None,
    only_if_narrow: bool,
) -> bool:
    """Deliver all hits of each ray to the sink's visitor, by packets.

    Parameters
    ----------
    tree : Tree
        Not empty.
    query : Query
    rays : RayBatch
    sink : Sink
    progress : callable, optional
        Called with (rays done, rays).
    only_if_narrow : bool
        Do nothing, and return False, unless packets suit the rays.
    """
    source, kept = _packets_of(tree, rays, sink)
    if only_if_narrow and not _suits_packets(tree, source):
        return False
    source, order = _tiled(source)
    report = reported_rays(progress, len(rays), source.order.packet_count)
    visit_all(tree.addresses, source, query, sink, report)
    del kept, order
    return True


def count_batch(
    tree: Tree,
    query: Query,
    rays: RayBatch,
    sink: Sink,
    progress: Progress | None,
    only_if_narrow: bool,
) -> bool:
    """Count all hits of each ray, by packets; see `visit_batch`."""
    source, kept = _packets_of(tree, rays, sink)
    if only_if_narrow and not _suits_packets(tree, source):
        return False
    source, order = _tiled(source)
    report = reported_rays(progress, len(rays), source.order.packet_count)
    sink.counts = count_all(tree.addresses, source, query, report)
    del kept, order
    return True


def _packets_of(tree: Tree, rays: RayBatch, sink: Sink) -> tuple[PacketSource, object]:
    """A batch as packets of consecutive rays or tiles, and the arrays to keep until traced."""
    source, kept = RaySource.of(rays.origins, rays.directions, rays.limits, True)
    status = np.uint64(sink.status.ctypes.data)
    return PacketSource(source, PacketOrder.of(rays.shape), tree.frame, status), kept


def _suits_packets(tree: Tree, source: PacketSource) -> bool:
    found = probe(source.rays, source.order, tree.frame, tree.byte_count)
    return choose_kernel(found, int(source.order.ray_count), tree.byte_count) == "packet"


def _tiled(source: PacketSource) -> tuple[PacketSource, object]:
    """The same rays in tiles, if they are a flat image, and what to keep until traced."""
    order = packet_order(BatchOrder(source.order), source.rays, source.frame)
    return source._replace(order=order.packets), order


def _trace_wavefront(work: _Batch, first: int, end: int, progress: Progress | None) -> None:
    tree, source, wants_any, results = work.tree, work.source, work.wants_any, work.results
    addresses, frame, prefetching = tree.addresses, tree.frame, tree.prefetching
    count = end - first

    def body(low: int, high: int) -> None:
        trace_wavefront(
            first + low,
            first + high,
            addresses,
            frame,
            source,
            wants_any,
            prefetching,
            work.filter_,
            results,
        )

    if count <= SMALL_BATCH and progress is None:
        body(0, count)
    else:
        share = -(-count // (8 * thread_count()))
        chunk = max(LEAST_CHUNK, min(share, MOST_CHUNK))
        parallel_for(body, count, chunk, progress, joins_chunks=True)


def _trace_packets(work: _Batch, first: int, end: int, progress: Progress | None) -> None:
    """Trace rays between two cuts of the batch's order."""
    addresses, wants_any, results = work.tree.addresses, work.wants_any, work.results
    order = work.order
    source = PacketSource(work.source, order.packets, work.tree.frame, results.status)
    start = order.cut(first).packet
    packet_count = order.cut(end).packet - start

    def body(low: int, high: int) -> None:
        trace_packets(
            start + low, start + high, addresses, source, wants_any, work.filter_, results
        )

    share = -(-packet_count // (8 * thread_count()))
    report = reported_rays(progress, end - first, packet_count)
    chunk = max(4, min(share, MOST_PACKETS))
    parallel_for(body, packet_count, chunk, report, joins_chunks=True)


def _trace_groups(work: _Batch, first: int, end: int, progress: Progress | None) -> None:
    """Trace rays between two cuts of the batch's order."""
    addresses, wants_any, results = work.tree.addresses, work.wants_any, work.results
    order = work.order
    source = PacketSource(work.source, order.packets, work.tree.frame, results.status)
    start = order.cut(first).packet
    packet_count = order.cut(end).packet - start

    def body(low: int, high: int) -> None:
        trace_groups(start + low, start + high, addresses, source, wants_any, work.filter_, results)

    share = -(-packet_count // (8 * thread_count()))
    if share > BLOCK_PACKETS:  # whole blocks
        share = min(share // BLOCK_PACKETS * BLOCK_PACKETS, MOST_PACKETS)
    report = reported_rays(progress, end - first, packet_count)
    parallel_for(body, packet_count, max(4, share), report, joins_chunks=True)


def reported_rays(progress: Progress | None, ray_count: int, packet_count: int) -> Progress | None:
    """A callback that takes packets done, and reports rays done."""
    if progress is None:
        return None
    whole = progress
    return lambda done, _: whole(done * ray_count // max(packet_count, 1), ray_count)


class _Tracer(Protocol):
    """Traces the rays from `first` to `end` of a batch; between two cuts of its order."""

    def __call__(self, work: _Batch, first: int, end: int, progress: Progress | None) -> None: ...


#: The kernels that trace large batches, which `coherence.rivals` lets race.
_TRACERS: dict[str, _Tracer] = {
    "packet": _trace_packets,
    "groups": _trace_groups,
    "wavefront": _trace_wavefront,
}

#: Kernels that have traced a batch in this process, without or with a filter: those are loaded.
_loaded: set[tuple[str, bool]] = set()

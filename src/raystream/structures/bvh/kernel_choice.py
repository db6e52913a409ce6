"""Choose the kernel for a batch of rays, and run it on all threads."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from raystream.core.query import Query
from raystream.core.rays import RayBatch
from raystream.jit.threads import Progress, parallel_for, thread_count
from raystream.kernels.hits import Sink
from raystream.kernels.ray import SceneFrame
from raystream.kernels.ray_source import RaySource, ResultAddresses
from raystream.structures.bvh.coherence import choose_kernel, probe
from raystream.structures.bvh.group_stream import BLOCK_PACKETS, trace_groups
from raystream.structures.bvh.layout import BvhArrays, TreeAddresses
from raystream.structures.bvh.options import Bvh
from raystream.structures.bvh.packet import trace_packets
from raystream.structures.bvh.packet_multi_hit import count_all, visit_all
from raystream.structures.bvh.packet_rays import PacketOrder, PacketSource
from raystream.structures.bvh.stream_batch import trace_sorted
from raystream.structures.bvh.wavefront import trace_wavefront

__all__ = [
    "KERNELS",
    "SMALL_BATCH",
    "Tree",
    "count_batch",
    "trace_batch",
    "visit_batch",
]

#: Kernels: chosen for each batch; many single rays in flight; packets of rays; streams of groups of
#: rays, in the order of the batch; streams of rays of one octant, sorted; one ray after another.
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


def trace_batch(
    tree: Tree,
    batch: RayBatch,
    wants_any: bool,
    results: ResultAddresses,
    progress: Progress | None,
    kernel: str = "auto",
) -> None:
    """Find the nearest hit of each ray, or whether there is one.

    Parameters
    ----------
    tree : Tree
        Not empty.
    batch : RayBatch
    wants_any : bool
    results : ResultAddresses
    progress : callable, optional
        Called with (rays done, rays).
    kernel : {"auto", "wavefront", "packet", "groups", "stream"}
        "auto" takes the wavefront for at most `SMALL_BATCH` rays; for more, the kernel that suits
        a sample of them.
    """
    count = len(batch)
    if kernel == "auto" and count <= SMALL_BATCH:
        kernel = "wavefront"
    source, kept = RaySource.of(
        batch.origins, batch.directions, batch.limits, kernel != "wavefront"
    )
    if kernel == "wavefront":  # without further preparation, for small batches
        _trace_wavefront(tree, count, source, wants_any, results, progress)
        return
    order = PacketOrder.of(batch.shape)
    if kernel == "auto" and count:
        found = probe(source, order, tree.frame, tree.byte_count)
        kernel = choose_kernel(found, count, tree.byte_count)
    if kernel == "wavefront":
        _trace_wavefront(tree, count, source, wants_any, results, progress)
    elif kernel == "stream":
        addresses, frame = tree.addresses, tree.frame
        trace_sorted(addresses, frame, count, source, wants_any, results, progress)
    elif kernel == "groups":
        packets = PacketSource(source, order, tree.frame, results.status)
        _trace_groups(tree, packets, wants_any, results, progress)
    else:
        packets = PacketSource(source, order, tree.frame, results.status)
        _trace_packets(tree, packets, wants_any, results, progress)
    del kept  # the kernels read it by address


def visit_batch(
    tree: Tree,
    query: Query,
    rays: RayBatch,
    has_duplicates: bool,
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
    has_duplicates : bool
        Whether a triangle may be in several leaves.
    sink : Sink
    progress : callable, optional
        Called with (rays done, rays).
    only_if_narrow : bool
        Do nothing, and return False, unless packets suit the rays.
    """
    source, kept = _packets_of(tree, rays, sink)
    if only_if_narrow and not _suits_packets(tree, source):
        return False
    report = _of_rays(progress, source.order)
    visit_all(tree.addresses, source, query, sink, has_duplicates, report)
    del kept
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
    report = _of_rays(progress, source.order)
    sink.counts = count_all(tree.addresses, source, query, report)
    del kept
    return True


def _packets_of(tree: Tree, rays: RayBatch, sink: Sink) -> tuple[PacketSource, object]:
    """A batch as packets, and the arrays to keep until they are traced."""
    source, kept = RaySource.of(rays.origins, rays.directions, rays.limits, True)
    status = np.uint64(sink.status.ctypes.data)
    return PacketSource(source, PacketOrder.of(rays.shape), tree.frame, status), kept


def _suits_packets(tree: Tree, source: PacketSource) -> bool:
    found = probe(source.rays, source.order, tree.frame, tree.byte_count)
    return choose_kernel(found, int(source.order.ray_count), tree.byte_count) == "packet"


def _trace_wavefront(
    tree: Tree,
    count: int,
    source: RaySource,
    wants_any: bool,
    results: ResultAddresses,
    progress: Progress | None,
) -> None:
    addresses, frame, prefetching = tree.addresses, tree.frame, tree.prefetching

    def body(begin: int, end: int) -> None:
        trace_wavefront(begin, end, addresses, frame, source, wants_any, prefetching, results)

    if count <= SMALL_BATCH and progress is None:
        body(0, count)
    else:
        share = -(-count // (8 * thread_count()))
        parallel_for(body, count, max(LEAST_CHUNK, min(share, MOST_CHUNK)), progress)


def _trace_packets(
    tree: Tree,
    source: PacketSource,
    wants_any: bool,
    results: ResultAddresses,
    progress: Progress | None,
) -> None:
    addresses, packet_count = tree.addresses, source.order.packet_count

    def body(begin: int, end: int) -> None:
        trace_packets(begin, end, addresses, source, wants_any, results)

    share = -(-packet_count // (8 * thread_count()))
    report = _of_rays(progress, source.order)
    parallel_for(body, packet_count, max(4, min(share, MOST_PACKETS)), report)


def _trace_groups(
    tree: Tree,
    source: PacketSource,
    wants_any: bool,
    results: ResultAddresses,
    progress: Progress | None,
) -> None:
    addresses, packet_count = tree.addresses, source.order.packet_count

    def body(begin: int, end: int) -> None:
        trace_groups(begin, end, addresses, source, wants_any, results)

    share = -(-packet_count // (8 * thread_count()))
    if share > BLOCK_PACKETS:  # whole blocks
        share = min(share // BLOCK_PACKETS * BLOCK_PACKETS, MOST_PACKETS)
    report = _of_rays(progress, source.order)
    parallel_for(body, packet_count, max(4, share), report)


def _of_rays(progress: Progress | None, order: PacketOrder) -> Progress | None:
    """A callback that takes packets done, and reports rays done."""
    if progress is None:
        return None
    whole, ray_count, packet_count = progress, int(order.ray_count), max(order.packet_count, 1)
    return lambda done, _: whole(done * ray_count // packet_count, ray_count)

"""Batches of rays on the CPU: their order, their kernels, and the calls of these on all threads.

A structure declares its kernels for many rays (`structures.batch_kernels`). Which of them traces a
batch is said by the structure's option, or by a sample of the rays and, for large batches, by a
race of those that may be the fastest.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from raystream.core.query import Kind, Query
from raystream.core.rays import RayBatch
from raystream.jit.threads import Progress, parallel_for, thread_count
from raystream.kernels.aligned import ALIGNMENT, aligned_array
from raystream.kernels.hits import Sink
from raystream.kernels.ray_source import RaySource
from raystream.machines.race import LEAST_RACE, Races, run_fastest
from raystream.structures import Structure
from raystream.structures.batch_kernels import Batch, BatchKernel
from raystream.structures.bvh.coherence import probe
from raystream.structures.bvh.image_rows import BatchOrder, find_order
from raystream.structures.bvh.packet_rays import PacketOrder

#: Bytes of spare memory that are kept, of which calls have written a small part.
_SPARE_BYTES = 1 << 27

#: Memory of calls that have ended, for later ones: new pages took a tenth of the time. Several
#: threads append and pop.
_spare: list[NDArray[np.float32]] = []

#: Kernels that have traced a batch in this process, without or with a filter: those are loaded.
_loaded: set[tuple[Callable[..., object], bool]] = set()


def trace_batch(
    structure: Structure,
    query: Query,
    rays: RayBatch,
    sink: Sink,
    progress: Progress | None = None,
) -> bool:
    """Run a query with a structure's kernels for many rays, if one suits them.

    Parameters
    ----------
    structure : Structure
    query : Query
        Without counters. Its filter is a `HitFilter` or None.
    rays : RayBatch
    sink : Sink
        Of `Kind.MULTI_HIT` with a visitor.
    progress : callable, optional
        Called with (rays done, rays).

    Returns
    -------
    bool
        False if it did nothing: the machine traces the rays one by one.
    """
    known = None if rays.worlds is not None else structure.batch_kernels(query)
    count = len(rays)
    if known is None or count == 0:
        return False
    name, kernels = known.named(structure.options, count), known.kernels
    if name != "auto" and name not in kernels:
        return False
    is_packed = name == "auto" or kernels[name].by_packets
    source, kept = RaySource.of(rays.origins, rays.directions, rays.limits, is_packed)
    order, has_filter = BatchOrder(PacketOrder.of(rays.shape)), query.on_hit is not None
    names: tuple[str, ...] = (name,)
    kind: tuple[int, ...] = ()
    if name == "auto":
        size = structure.traced_bytes
        found = probe(source, order.packets, structure.frame, size)
        names = known.suited(found, count, size)[: None if count >= LEAST_RACE else 1]
        kind = query.kind is Kind.ANY_HIT, has_filter, count.bit_length(), *found.kind()
    usable = [one for one in names if one in kernels and has_filter <= kernels[one].takes_filter]
    if usable[:1] != [names[0]]:
        return False
    if not order.packets.width and any(kernels[one].is_tiled for one in usable):
        order = find_order(source, count, structure.frame)
    batch = Batch(query, rays, sink, source, order.packets)

    def run(name: str, begin: int, end: int, progress: Progress | None) -> None:
        body = kernels[name].bind(structure, batch)
        _call_kernel(kernels[name], body, order, (begin, end), progress)
        _loaded.add((kernels[name].bind, has_filter))

    if len(usable) == 1:
        run(usable[0], 0, count, progress)
    else:
        cold = [one for one in usable if (kernels[one].bind, has_filter) not in _loaded]
        races = Races(structure.kernel_times)
        run_fastest(usable, count, lambda ray: order.cut(ray).ray, run, races, kind, progress, cold)
    del kept  # the kernels read it by address
    return True


def batch_bytes(structure: Structure, kind: Kind, ray_count: int) -> int:
    """Most bytes that `trace_batch` needs besides the results and the hits of `Kind.MULTI_HIT`."""
    known = structure.batch_kernels(Query(kind))
    if known is None:
        return 0
    name = known.named(structure.options, ray_count)
    used = [one for key, one in known.kernels.items() if name in ("auto", key)]
    tables = 2 * ray_count if any(one.is_tiled for one in used) else 0  # of rows and packets
    return tables + thread_count() * max((one.memory_bytes for one in used), default=0)


def call_size(count: int, least: int, most: int, share: int = 4, block: int = 1) -> int:
    """Rays or packets of a call; see `BatchKernel`.

    Small batches are split among the threads, too, but not so far that starting a call costs more
    than its rays.
    """
    if count <= least:  # without counting threads: that takes 2 us
        return min(least, most)
    size = -(-count // (share * thread_count()))
    if size > block:  # whole blocks
        size -= size % block
    return min(most, max(least, size))


def _call_kernel(
    kernel: BatchKernel,
    body: Callable[..., object],
    order: BatchOrder,
    rays: tuple[int, int],
    progress: Progress | None,
) -> None:
    """Trace the rays between two cuts of an order on all threads."""
    first, end = (order.cut(ray).packet for ray in rays) if kernel.by_packets else rays
    count, ray_count = end - first, rays[1] - rays[0]

    def call(low: int, high: int) -> None:
        if not kernel.memory_bytes:
            body(first + low, first + high)
            return
        memory = _memory_of(kernel.memory_bytes)
        body(first + low, first + high, memory.ctypes.data)
        if sum(one.nbytes for one in _spare) + memory.nbytes <= _SPARE_BYTES:
            _spare.append(memory)

    def report(done: int, _: int) -> object:
        assert progress is not None
        return progress(done * ray_count // count, ray_count)

    size = call_size(count, kernel.least, kernel.most, kernel.share, kernel.block)
    shown = None if progress is None else report
    parallel_for(call, count, size, shown, joins_chunks=kernel.joins_chunks)


def _memory_of(byte_count: int) -> NDArray[np.float32]:
    """Memory for a call, of one that has ended if there is any."""
    try:
        memory = _spare.pop()
    except IndexError:
        memory = aligned_array(0, 1)
    is_enough = memory.nbytes >= byte_count
    return memory if is_enough else aligned_array(-(-byte_count // ALIGNMENT), ALIGNMENT // 4)

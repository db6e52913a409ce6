"""Batches of rays on the CPU: their order, their kernels, and the calls of these on all threads.

A structure declares its kernels for many rays (`structures.batch_kernels`). Which of them traces a
batch is said by the structure's option, or by a sample of the rays and, for large batches, by a
race of those that may be the fastest.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from raystream.core.query import UNLIMITED, Kind, Query
from raystream.core.rays import RayBatch
from raystream.jit.entries import entry_of
from raystream.jit.threads import Progress, check_stopped, parallel_for, part_of, thread_count
from raystream.kernels.aligned import ALIGNMENT, aligned_array, array_address
from raystream.kernels.hits import Sink
from raystream.kernels.ray_source import RaySource
from raystream.machines.race import LEAST_RACE, Races, run_fastest
from raystream.structures import Structure
from raystream.structures.batch_kernels import Batch, BatchKernel, Calls
from raystream.structures.bvh.coherence import probe
from raystream.structures.bvh.packets.image_rows import LEAST_RAYS, BatchOrder, find_order
from raystream.structures.bvh.packets.rays import PacketOrder

#: Most spare memories, and bytes of each: up to 42 MB for instances, of which calls have written a
#: small part.
#: Those for very many nearest triangles of a point are not kept.
_MOST_SPARE, _MOST_SPARE_BYTES = 4, 1 << 26

#: Memory of calls that have ended, for later ones: new pages took a tenth of the time. Several
#: threads append and pop.
_spare: list[NDArray[np.float32]] = []

#: Of kernels for single rays.
_NO_ORDER = BatchOrder(PacketOrder.of_rows(0, 0))

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
    count, has_filter = len(rays), query.on_hit is not None
    known = structure.batch_kernels.get(query.kind)
    # Worlds and numbers of hits are for single rays.
    if known is None or count == 0 or rays.worlds is not None or query.limit != UNLIMITED:
        return False
    kernels, name = known.kernels, known.named(structure.options, count)
    if has_filter:
        kernels = {key: one for key, one in kernels.items() if one.takes_filter}
    is_open = name == "auto"
    if not is_open and name not in kernels:
        return False
    is_packed = is_open or kernels[name].by_packets
    source, kept = RaySource.of(rays.origins, rays.directions, rays.limits, is_packed)
    order = BatchOrder(PacketOrder.of(rays.shape)) if is_packed else _NO_ORDER
    names = [name]
    kind: tuple[int, ...] = ()
    if is_open:
        # What the tree would take in float32 decides how many rays share a node.
        size = structure.report.byte_count * 4 // np.dtype(structure.precision).itemsize
        found = probe(source, order.packets, structure.frame, size)
        suited = known.suited(found, count, size)[: None if count >= LEAST_RACE else 1]
        if suited[0] not in kernels:
            return False
        names = [one for one in suited if one in kernels]
        kind = query.kind is Kind.ANY_HIT, has_filter, count.bit_length(), *found.kind()
    is_long = count >= LEAST_RAYS and not order.packets.width
    if is_long and any(kernels[one].is_tiled for one in names):
        order = find_order(source, count, structure.frame)
    batch = Batch(query, rays, sink, source, order.packets)

    def run(name: str, begin: int, end: int, progress: Progress | None) -> None:
        kernel = kernels[name]
        _call_kernel(kernel, kernel.bind(structure, batch), order, (begin, end), progress)
        _loaded.add((kernel.bind, has_filter))

    if len(names) == 1:
        run(names[0], 0, count, progress)
    else:
        cold = [one for one in names if (kernels[one].bind, has_filter) not in _loaded]
        races = Races(structure.kernel_times)
        run_fastest(names, count, lambda ray: order.cut(ray).ray, run, races, kind, progress, cold)
    del kept  # the kernels read it by address
    return True


def batch_bytes(structure: Structure, kind: Kind, ray_count: int) -> int:
    """Most bytes that `trace_batch` needs besides the results and the hits of `Kind.MULTI_HIT`."""
    known = structure.batch_kernels.get(kind)
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


def run_calls(
    calls: Calls,
    items: tuple[int, int],
    least: int,
    most: int,
    progress: Progress | None = None,
    *,
    block: int = 1,
    share: int = 4,
    memory_bytes: int = 0,
    joins_chunks: bool = False,
) -> None:
    """Call a kernel for rays, packets or points, parts of them at a time, on all threads.

    Parameters
    ----------
    calls : Calls
        The kernel and its arguments after `begin` and `end`.
    items : tuple of two int
        Begin and end.
    least, most, block, share, memory_bytes, joins_chunks
        See `BatchKernel`. The kernel's last argument is the address of its memory, if it needs any.
    progress : callable, optional
        Called with (items done, items).
    """
    trace, arguments = calls
    first, end = items
    count = end - first
    size = call_size(count, least, most, share, block)
    if count <= size and not memory_bytes and progress is None:  # small batches
        check_stopped()
        trace(first, end, *arguments)
        return
    if count > size:
        trace = entry_of(trace, (first, end, *arguments, *((0,) if memory_bytes else ())))

    def body(low: int, high: int) -> None:
        if not memory_bytes:
            trace(first + low, first + high, *arguments)
            return
        memory = _memory_of(memory_bytes)
        trace(first + low, first + high, *arguments, array_address(memory))
        if len(_spare) < _MOST_SPARE and memory.nbytes <= _MOST_SPARE_BYTES:
            _spare.append(memory)

    parallel_for(body, count, size, progress, joins_chunks=joins_chunks)


def run_in_turn(
    kernels: Sequence[Callable[[NDArray[np.int64], Progress | None], NDArray[np.bool_]]],
    count: int,
    progress: Progress | None = None,
) -> None:
    """Run kernels one after another, each for what those before left undecided.

    Parameters
    ----------
    kernels : sequence of callable
        ``kernel(items, progress)`` takes the numbers of items, and returns which it has decided.
    count : int
        Items.
    progress : callable, optional
        Called with (items done, items).
    """
    left = np.arange(count)
    for run in kernels:
        if len(left):
            decided = run(left, part_of(progress, count - len(left), count))
            left = left[~decided]


def _call_kernel(
    kernel: BatchKernel,
    calls: Calls,
    order: BatchOrder,
    rays: tuple[int, int],
    progress: Progress | None,
) -> None:
    """Trace the rays between two cuts of an order."""
    begin, end = (order.cut(ray).packet for ray in rays) if kernel.by_packets else rays
    if end - begin <= kernel.least and not kernel.memory_bytes and progress is None:
        check_stopped()
        calls[0](begin, end, *calls[1])  # at once: a ray alone takes 17 us
        return

    def report(done: int, count: int) -> object:
        assert progress is not None
        return progress(done * (rays[1] - rays[0]) // count, rays[1] - rays[0])

    run_calls(
        calls,
        (begin, end),
        kernel.least,
        kernel.most,
        None if progress is None else report,
        block=kernel.block,
        share=kernel.share,
        memory_bytes=kernel.memory_bytes,
        joins_chunks=kernel.joins_chunks,
    )


def _memory_of(byte_count: int) -> NDArray[np.float32]:
    """Memory for a call: of one that has ended, if there is enough of it."""
    try:
        memory = _spare.pop()
    except IndexError:
        memory = aligned_array(0, 1)
    is_enough = memory.nbytes >= byte_count
    return memory if is_enough else aligned_array(-(-byte_count // ALIGNMENT), ALIGNMENT // 4)

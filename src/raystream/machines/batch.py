"""Batches of rays on the CPU: their order, their kernels, and the calls of these on all threads.

A structure declares its kernels (`structures.batch_kernels`). Which of them traces a batch is said
by the structure's option, or by a sample of the rays and, for large batches, by a race of those
that may be the fastest.

All kernels give the same bits, so no ray of a race is traced twice. The kernel that is thought the
fastest traces two pieces of an eighth of the batch; its rivals trace smaller ones between them, so
that a rival of half the speed costs a few percent. A rival that was not much slower traces a larger
piece: lists of few rays share few nodes. The fastest traces the rest.
"""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable, Generator, Hashable, Iterable, Sequence
from contextlib import closing
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.core.query import UNLIMITED, Kind, Query
from raystream.core.rays import RayBatch
from raystream.jit.entries import entry_of
from raystream.jit.threads import Progress, check_stopped, parallel_for, part_of, thread_count
from raystream.kernels.aligned import ALIGNMENT, aligned_array, array_address
from raystream.kernels.hits import Sink
from raystream.kernels.ray_source import RaySource
from raystream.machines.race import Races
from raystream.structures import Structure
from raystream.structures.batch_kernels import (
    SINGLE,
    Batch,
    BatchKernel,
    BatchKernels,
    Calls,
    CallSize,
)
from raystream.structures.bvh.coherence import probe
from raystream.structures.bvh.packets.image_rows import LEAST_RAYS, BatchOrder, find_order
from raystream.structures.bvh.packets.rays import PacketOrder

#: Spare memories to keep, about, and the most bytes of each: up to 42 MB for instances, of which
#: calls have written a small part. Those for very many nearest triangles of a point are not kept.
_MOST_SPARE, _MOST_SPARE_BYTES = 4, 1 << 26

#: Memory of calls that have ended, for later ones: new pages took a tenth of the time. Several
#: threads append and pop.
_spare: list[NDArray[np.float32]] = []

#: Batches of fewer rays are not raced: threads would start and end too often.
LEAST_RACE = 1 << 16

#: Pieces of the kernel that is thought the fastest, of its rivals, and of rivals in doubt, relative
#: to the batch.
_FAVOURITE = 1 / 8
_RIVAL = 1 / 48
_IN_DOUBT = 1 / 12

#: Least rays of a piece.
_LEAST_PIECE = 4096

#: A rival is in doubt if it took at most this many times as long as the favourite.
_NEAR = 2.0

#: Rays of a batch to trace by a kernel: (kernel, first ray, end).
Piece = tuple[str, int, int]

#: The last place at or before a ray where a batch may be divided.
Cut = Callable[[int], int]

#: Held by a race.
_racing = threading.Lock()


#: The time, in seconds.
clock = time.perf_counter

#: Of kernels for single rays.
_NO_ORDER = BatchOrder(PacketOrder.of_rows(0, 0))

#: Kernels that have traced a batch in this process, without or with a filter: those are loaded.
_loaded: set[tuple[Callable[..., object], bool]] = set()


def _forget_race() -> None:
    """A race of the parent's does not end in a forked child."""
    global _racing
    _racing = threading.Lock()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_forget_race)


def trace_batch(
    structure: Structure,
    query: Query,
    rays: RayBatch,
    sink: Sink,
    progress: Progress | None = None,
) -> None:
    """Run a query with a structure's kernels.

    Parameters
    ----------
    structure : Structure
    query : Query
        Its filter is a `HitFilter` or None.
    rays : RayBatch
    sink : Sink
        Of `Kind.MULTI_HIT` with a visitor; or with `splits` and `hits`, to be traced one by one.
    progress : callable, optional
        Called with (rays done, rays).
    """
    table, count = structure.batch_kernels[query.kind], len(rays)
    # Worlds, counters and numbers of hits are for single rays.
    is_single = rays.worlds is not None or sink.tallies is not None or query.limit != UNLIMITED
    name = SINGLE if is_single or count == 0 else table.named(structure.options, count)
    kernel = table.kernels.get(name)  # None: the rays decide
    is_packed = kernel is None or kernel.by_packets
    source, kept = _source_of(rays, is_packed)
    order = BatchOrder(PacketOrder.of(rays.shape)) if is_packed else _NO_ORDER
    names: tuple[str, ...] = (name,)
    kind: tuple[int, ...] = ()
    if kernel is None:
        kind, names = _suited(structure, query, table, source, order.packets)
        kernel = table.kernels[names[0]]
        if names == (SINGLE,):
            source, kept = _source_of(rays, False)
    is_long = is_packed and count >= LEAST_RAYS and not order.packets.width
    if is_long and any(table.kernels[name].is_tiled for name in names):
        order = find_order(source, count, structure.frame)
    batch = Batch(query, rays, sink, source, order.packets)
    if len(names) == 1:
        report = progress and part_of(progress, 0, count, count)  # it may count packets
        _trace_piece(kernel, structure, batch, order, (0, count), report)
    else:
        cold = [name for name in names if _key_of(table.kernels[name], query) not in _loaded]
        races, done = Races(structure.kernel_times), 0
        with closing(
            race(races, kind, names, cold, count, lambda ray: order.cut(ray).ray)
        ) as pieces:
            for name, begin, end in pieces:
                report = part_of(progress, done, end - begin, count)
                _trace_piece(table.kernels[name], structure, batch, order, (begin, end), report)
                done += end - begin
    del kept  # the kernels read it by address


def _source_of(rays: RayBatch, is_packed: bool) -> tuple[RaySource, object]:
    """The rays for packets, or for single ones; and what to keep alive."""
    limits = rays.limits if is_packed else rays.exact_limits
    return RaySource.of(rays.origins, rays.directions, limits, is_packed)


def _suited(
    structure: Structure, query: Query, table: BatchKernels, source: RaySource, order: PacketOrder
) -> tuple[tuple[int, ...], tuple[str, ...]]:
    """The kind of a batch, and the kernels that may be the fastest for it, the likeliest first."""
    count = int(order.ray_count)
    # What the tree would take in float32 decides how many rays share a node.
    size = structure.report.byte_count * 4 // np.dtype(structure.precision).itemsize
    found = probe(source, order, structure.frame, size)
    assert table.suited is not None
    best, *rivals = table.suited(found, count, size)
    if best not in table.kernels:
        best, rivals = SINGLE, []
    known = [name for name in rivals if name in table.kernels and count >= LEAST_RACE]
    kind = query.kind is Kind.ANY_HIT, query.on_hit is not None, count.bit_length(), *found.kind()
    return kind, (best, *known)


def race(
    races: Races, kind: Hashable, names: Sequence[str], cold: Sequence[str], count: int, cut: Cut
) -> Generator[Piece, None, None]:
    """Decide which kernel traces which rays of a batch; the caller traces each piece at once.

    Parameters
    ----------
    races : Races
    kind : hashable
        Of the batch.
    names : sequence of str
        Kernels; the first one is the guess.
    cold : sequence of str
        Kernels to run before they are timed, as they must be loaded.
    count : int
        Rays of the batch.
    cut : callable

    Notes
    -----
    One race at a time: two would measure each other. A batch that is due meanwhile is not raced.
    """
    held = _racing
    if not races.is_due(kind, not cold) or not held.acquire(blocking=False):
        yield races.fastest(kind, names), 0, count
        return
    try:
        yield from _pieces(races, kind, names, cold, count, cut)
    finally:
        held.release()


def _pieces(
    races: Races, kind: Hashable, names: Sequence[str], cold: Sequence[str], count: int, cut: Cut
) -> Generator[Piece, None, None]:
    """Pieces by each kernel, the rest by the fastest."""
    at = first = cut(int((0.5 - _FAVOURITE) * count))

    def timed(name: str, share: float) -> Generator[Piece, None, float]:
        """The next piece; returns its seconds per ray, 0 if it has none."""
        nonlocal at
        begin, at = at, cut(at + max(int(share * count), _LEAST_PIECE))
        if begin >= at:
            return 0.0
        started = clock()
        yield name, begin, at
        return (clock() - started) / (at - begin)

    for name in cold:
        yield from timed(name, 0.0)
    favourite, rates = races.fastest(kind, names), {}
    before = yield from timed(favourite, _FAVOURITE)
    for name in names:
        if name == favourite:
            continue
        rates[name] = yield from timed(name, _RIVAL)
        if rates[name] <= _NEAR * before:
            # Alone: the first piece may have been too small.
            rates[name] = yield from timed(name, _IN_DOUBT)
    behind = yield from timed(favourite, _FAVOURITE)
    # The faster of its pieces: another program that runs during one of them does not decide.
    rates[favourite] = min(filter(None, (before, behind)), default=0.0)
    races.learn(kind, {name: rate for name, rate in rates.items() if rate})
    winner = races.fastest(kind, names)
    for begin, end in ((0, first), (at, count)):
        if begin < end:
            yield winner, begin, end


def _key_of(kernel: BatchKernel, query: Query) -> tuple[Callable[..., object], bool]:
    """What is loaded together; see `_loaded`."""
    return kernel.bind, query.on_hit is not None


def _trace_piece(
    kernel: BatchKernel,
    structure: Structure,
    batch: Batch,
    order: BatchOrder,
    rays: tuple[int, int],
    progress: Progress | None,
) -> None:
    """Trace the rays between two cuts of an order."""
    begin, end = rays
    if kernel.by_packets:
        begin, end = order.cut(begin).packet, order.cut(end).packet
    run_calls(kernel.bind(structure, batch), (begin, end), kernel.size, progress)
    _loaded.add((kernel.bind, batch.query.on_hit is not None))


def batch_bytes(structure: Structure, kind: Kind, ray_count: int) -> int:
    """Most bytes that `trace_batch` needs besides the results and the hits of `Kind.MULTI_HIT`."""
    table = structure.batch_kernels[kind]
    name = table.named(structure.options, ray_count)
    used = [one for key, one in table.kernels.items() if name in ("auto", key)]
    tables = 2 * ray_count if any(one.is_tiled for one in used) else 0  # of rows and packets
    return tables + thread_count() * max(one.size.memory_bytes for one in used)


def run_calls(
    calls: Calls, items: tuple[int, int], size: CallSize, progress: Progress | None = None
) -> None:
    """Call a kernel for rays, packets or points, parts of them at a time, on all threads.

    Parameters
    ----------
    calls : Calls
        The kernel and its arguments after `begin` and `end`; the address of its memory follows, if
        it needs any.
    items : tuple of two int
        Begin and end.
    size : CallSize
    progress : callable, optional
        Called with (items done, items).
    """
    trace, arguments = calls
    first, end = items
    memory_bytes = size.memory_bytes
    if end - first <= size.least and not memory_bytes and progress is None:
        check_stopped()
        trace(first, end, *arguments)  # at once: a ray alone takes 17 us
        return
    count, most = end - first, size.of(end - first)
    if count > most:
        trace = entry_of(trace, (first, end, *arguments, *((0,) if memory_bytes else ())))

    def body(low: int, high: int) -> None:
        if not memory_bytes:
            trace(first + low, first + high, *arguments)
            return
        memory = _memory_of(memory_bytes)
        trace(first + low, first + high, *arguments, array_address(memory))
        if len(_spare) < _MOST_SPARE and memory.nbytes <= _MOST_SPARE_BYTES:
            _spare.append(memory)

    parallel_for(body, count, most, progress, joins_chunks=size.joins_chunks)


class DecidingKernel(NamedTuple):
    """A kernel that decides some items of a batch, and leaves others to the next one.

    Attributes
    ----------
    bind : callable
        ``bind(items)`` takes the numbers of items. It returns the calls for these, and a function
        that keeps their results, and says which of them are decided.
    size : CallSize
    least : int
        Smaller batches do without it.
    """

    bind: Callable[[NDArray[np.int64]], tuple[Calls, Callable[[], NDArray[np.bool_]]]]
    size: CallSize
    least: int = 1


def run_in_turn(
    kernels: Iterable[DecidingKernel], count: int, progress: Progress | None = None
) -> None:
    """Run kernels one after another, each for what those before left undecided.

    Parameters
    ----------
    kernels : iterable of DecidingKernel
    count : int
        Items.
    progress : callable, optional
        Called with (items done, items).
    """
    left = np.arange(count)
    for kernel in kernels:
        if len(left) and count >= kernel.least:
            calls, decide = kernel.bind(left)
            report = part_of(progress, count - len(left), len(left), count)
            run_calls(calls, (0, len(left)), kernel.size, report)
            left = left[~decide()]
    if progress:
        progress(count, count)


def _memory_of(byte_count: int) -> NDArray[np.float32]:
    """Memory for a call: of one that has ended, if there is enough of it."""
    try:
        memory = _spare.pop()
    except IndexError:
        memory = aligned_array(0, 1)
    is_enough = memory.nbytes >= byte_count
    return memory if is_enough else aligned_array(-(-byte_count // ALIGNMENT), ALIGNMENT // 4)

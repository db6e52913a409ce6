"""Several simulators over one trace, on a thread each."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, wait
from typing import TypeVar

from raystream.jit.threads import thread_count

__all__ = ["feed_chunks"]

Chunk = TypeVar("Chunk")


def feed_chunks(trace: Iterable[Chunk], takers: Sequence[Callable[[Chunk], object]]) -> None:
    """Give each chunk of a trace to each taker, in the trace's order.

    Takers run side by side, while the next chunk is made: simulators run without the interpreter
    lock. Two chunks are in memory at a time.

    Parameters
    ----------
    trace : iterable
        Of chunks that nobody changes.
    takers : sequence of callable
        Such as ``lambda chunk: cache.access(chunk.addresses)``; they share nothing.

    Raises
    ------
    Exception
        What a taker raises, after the others have taken the same chunk.
    """
    with ThreadPoolExecutor(max(thread_count(), 1)) as pool:
        taken: list[Future[object]] = []
        for chunk in trace:
            _finish(taken)
            taken = [pool.submit(taker, chunk) for taker in takers]
        _finish(taken)


def _finish(taken: Sequence[Future[object]]) -> None:
    wait(taken)
    for one in taken:
        one.result()

"""Feed a trace to several simulators, one thread each."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, wait
from typing import TypeVar

from raystream.jit.threads import thread_count

Chunk = TypeVar("Chunk")


def feed_chunks(trace: Iterable[Chunk], consumers: Sequence[Callable[[Chunk], object]]) -> None:
    """Pass each chunk of a trace to every consumer, in order.

    Consumers run in parallel, while the next chunk is generated: simulators release the GIL. At
    most two chunks are in memory.

    Parameters
    ----------
    trace : iterable
        Chunks; they must not be modified.
    consumers : sequence of callable
        Such as ``lambda chunk: cache.access(chunk.addresses)``; they must not share state.

    Raises
    ------
    Exception
        The exception of a consumer, after the others have processed the same chunk.
    """
    with ThreadPoolExecutor(max(thread_count(), 1)) as pool:
        running: list[Future[object]] = []
        for chunk in trace:
            _finish(running)
            running = [pool.submit(consumer, chunk) for consumer in consumers]
        _finish(running)


def _finish(running: Sequence[Future[object]]) -> None:
    wait(running)
    for one in running:
        one.result()

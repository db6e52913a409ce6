"""The pipeline: trace one block while the next is read and the previous one is written."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from concurrent.futures import TimeoutError as NotYetError
from dataclasses import dataclass
from typing import Any, TypeVar

from raystream.ray_files.block_query import BlockResult
from raystream.ray_files.blocks import Block

T = TypeVar("T")

#: Seconds between checks for Ctrl-C, on systems where it does not interrupt a wait.
POLL_SECONDS = 0.1


@dataclass
class Waits:
    """Seconds without tracing, waiting for reads or writes."""

    reading: float = 0.0
    writing: float = 0.0


def run(
    blocks: Iterable[Block],
    read: Callable[[Block], Any],
    trace: Callable[[Block, Any], Iterator[BlockResult]],
    write: Callable[[BlockResult], None],
) -> Waits:
    """Read, trace and write all blocks, in order.

    Parameters
    ----------
    blocks : iterable of Block
    read, trace, write : callable
        `read` and `write` run on their own threads, `trace` on the calling thread. At most two
        blocks of rays and two results exist at any time, counting the block being traced.

    Returns
    -------
    Waits

    Notes
    -----
    Exceptions of all three propagate; before that, and after Ctrl-C, a result that was handed
    over is still written.
    """
    waits = Waits()
    pending: Future[None] | None = None
    with ThreadPoolExecutor(1) as reading, ThreadPoolExecutor(1) as writing:
        try:
            for block, ahead in _read_ahead(blocks, read, reading):
                started = time.perf_counter()
                rays = _result(ahead)
                waits.reading += time.perf_counter() - started
                for result in trace(block, rays):
                    if pending is not None:
                        started = time.perf_counter()
                        _result(pending)
                        waits.writing += time.perf_counter() - started
                    pending = writing.submit(write, result)
        finally:
            if pending is not None:
                started = time.perf_counter()
                _result(pending)
                waits.writing += time.perf_counter() - started
    return waits


def _read_ahead(
    blocks: Iterable[Block], read: Callable[[Block], Any], reading: ThreadPoolExecutor
) -> Iterator[tuple[Block, Future[Any]]]:
    """Iterate over blocks with pending reads; each read starts one block ahead."""
    before: tuple[Block, Future[Any]] | None = None
    for block in blocks:
        begun = block, reading.submit(read, block)
        if before is not None:
            yield before
        before = begun
    if before is not None:
        yield before


def _result(future: Future[T]) -> T:
    while True:
        try:
            return future.result(timeout=POLL_SECONDS)
        except NotYetError:
            if future.done():  # raised by the call itself
                raise

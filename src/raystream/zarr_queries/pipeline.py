"""The pipeline: a block is traced while the next is read and the one before is written."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from concurrent.futures import TimeoutError as NotYetError
from dataclasses import dataclass
from typing import Any, TypeVar

from raystream.zarr_queries.asking import Answer
from raystream.zarr_queries.blocks import Block

__all__ = ["Waits", "run"]

T = TypeVar("T")

#: Seconds after which a wait looks for Ctrl-C, where the system does not break it off.
SLICE = 0.1


@dataclass
class Waits:
    """Seconds in which nothing was traced, since reading or writing was not done yet."""

    reading: float = 0.0
    writing: float = 0.0


def run(
    blocks: Iterable[Block],
    read: Callable[[Block], Any],
    ask: Callable[[Block, Any], Iterator[Answer]],
    write: Callable[[Answer], None],
) -> Waits:
    """Read, ask and write all blocks, in order.

    Parameters
    ----------
    blocks : iterable of Block
    read, ask, write : callable
        `read` and `write` are called on threads of their own, `ask` on this one. There are at
        most two blocks of rays and two answers at any time, one of each beside that which is
        traced.

    Returns
    -------
    Waits

    Notes
    -----
    What any of them raises comes out of here; before that, and after Ctrl-C, an answer that was
    handed over is still written.
    """
    waits = Waits()
    pending: Future[None] | None = None
    with ThreadPoolExecutor(1) as reading, ThreadPoolExecutor(1) as writing:
        try:
            for block, ahead in _ahead(blocks, read, reading):
                started = time.perf_counter()
                rays = _result(ahead)
                waits.reading += time.perf_counter() - started
                for answer in ask(block, rays):
                    if pending is not None:
                        started = time.perf_counter()
                        _result(pending)
                        waits.writing += time.perf_counter() - started
                    pending = writing.submit(write, answer)
        finally:
            if pending is not None:
                started = time.perf_counter()
                _result(pending)
                waits.writing += time.perf_counter() - started
    return waits


def _ahead(
    blocks: Iterable[Block], read: Callable[[Block], Any], reading: ThreadPoolExecutor
) -> Iterator[tuple[Block, Future[Any]]]:
    """Blocks with their rays to come; the next is begun when one is asked for."""
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
            return future.result(timeout=SLICE)
        except NotYetError:
            if future.done():  # its own
                raise

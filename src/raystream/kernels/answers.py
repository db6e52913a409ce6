"""Answers: a query as a function of one ray or point, run by a loop (CPU) or a thread (CUDA).

An answer is a device function ``answer(i, shared, out, memory)``: it writes the answer of item i,
a uint64, to `out`. What all items share, and where answers go, are numbers, addresses, None, and
named tuples of these. `memory` is the address of working memory, a multiple of 64. It keeps its
contents from item to item of a call; before the first one, its first 8 bytes are 0.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from raystream.jit.constants import ZERO_U64
from raystream.jit.cpu import kernel
from raystream.jit.simd import scratch, store


def loop_of(answer: Callable[..., None], memory_bytes: int) -> Callable[..., None]:
    """Make the loop of an answer.

    Parameters
    ----------
    answer : device function
    memory_bytes : int
        Of its working memory, at least 8.

    Returns
    -------
    kernel
        ``loop(begin, end, shared, out)`` answers the items begin to end.
    """

    def loop(begin: Any, end: Any, shared: Any, out: Any) -> None:
        memory = scratch(memory_bytes)
        store(memory, ZERO_U64)
        for i in range(np.uint64(begin), np.uint64(end)):
            answer(i, shared, out, memory)

    return kernel(_named(loop, answer))


def thread_of(answer: Callable[..., None], memory_bytes: int) -> Callable[..., None]:
    """Make the function of a thread, ``thread(i, shared, out)``; see `loop_of`."""

    def thread(i: Any, shared: Any, out: Any) -> None:
        memory = scratch(memory_bytes)
        store(memory, ZERO_U64)
        answer(i, shared, out, memory)

    return kernel(_named(thread, answer))


def _named(function: Callable[..., None], answer: Callable[..., None]) -> Callable[..., None]:
    """The function with the answer's name, for profiles and messages."""
    function.__name__ = answer.__name__
    function.__qualname__ = f"{function.__qualname__.partition('.')[0]}.{answer.__name__}"
    return function

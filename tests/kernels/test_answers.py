"""Answers: the same function in a loop and in threads."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from raystream.jit.constants import ONE_U64, SHIFT_64
from raystream.jit.cpu import device
from raystream.jit.simd import load, store
from raystream.kernels.aligned import array_address
from raystream.kernels.answers import loop_of, thread_of


class Shared(NamedTuple):
    """What all items share."""

    factor: int
    absent: Any


@device
def multiply(i, shared, out, memory):
    """Write a product, and how many items of the call came before."""
    before = load(np.uint64, memory)
    store(memory, before + ONE_U64)
    at = out + (i << SHIFT_64)
    if shared.absent is None:
        store(at, np.int64(100 * before) + shared.factor * np.int64(i))


def test_a_loop_keeps_its_memory_and_threads_begin_with_zero():
    loop, thread = loop_of(multiply, 64), thread_of(multiply, 64)
    shared = Shared(7, None)
    found, alone = np.zeros(6, np.int64), np.zeros(6, np.int64)
    for begin, end in ((1, 4), (4, 6), (6, 6)):
        loop(begin, end, shared, np.uint64(array_address(found)))
    for i in range(1, 6):
        thread(np.uint64(i), shared, np.uint64(array_address(alone)))
    assert found.tolist() == [0, 7, 114, 221, 28, 135]
    assert alone.tolist() == [0, 7, 14, 21, 28, 35]


def test_loops_and_threads_have_the_name_of_their_answer():
    assert loop_of(multiply, 8).__name__ == thread_of(multiply, 8).__name__ == "multiply"

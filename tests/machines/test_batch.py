"""The memory of calls: used again, by one call at a time, and not kept without limit."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

import raystream as rs
from conftest import assert_same_bits
from meshes import soup
from raystream.machines import batch
from raystream.structures.batch_kernels import CallSize

TRACERS = ({}, {"precision": "float64"})


def scattered(count, rng):
    return rng.random((count, 3), np.float32), rng.normal(size=(count, 3)).astype(np.float32)


@pytest.fixture
def spare(monkeypatch):
    """Memory of calls that have ended, at first none."""
    kept = []
    monkeypatch.setattr(batch, "_spare", kept)
    return kept


@pytest.mark.parametrize("options", TRACERS)
def test_memory_is_used_again(spare, options, rng):
    tracer = rs.Tracer(rs.Scene.from_arrays(*soup(200, 1)), kernel="groups", **options)
    rays = scattered(700, rng)
    tracer.first_hit(*rays)
    first = {id(memory) for memory in spare}
    assert first
    for _ in range(3):
        tracer.any_hit(*rays)
    assert first <= {id(memory) for memory in spare}
    assert len(spare) <= batch._MOST_SPARE


def test_threads_do_not_share_memory(spare, rng):
    """Several threads trace with two tracers at once, whose calls need memory of two sizes."""
    scene = rs.Scene.from_arrays(*soup(200, 1))
    rays = scattered(6000, rng)
    tracers = [rs.Tracer(scene, kernel="groups", **options) for options in TRACERS]
    wanted = [rs.Tracer(scene, kernel="single", **options).first_hit(*rays) for options in TRACERS]

    def trace(number):
        return number % 2, tracers[number % 2].first_hit(*rays)

    with ThreadPoolExecutor(6) as pool:
        for which, hits in pool.map(trace, range(24)):
            for name in ("t", "u", "v", "prim_id"):
                assert_same_bits(getattr(hits, name), getattr(wanted[which], name))
    assert len({id(memory) for memory in spare}) == len(spare) <= batch._MOST_SPARE + 6


def test_an_interrupted_call_gives_no_memory_back(spare, monkeypatch):
    """A thread may still write to it."""

    def interrupted(begin, end, memory):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        batch.run_calls((interrupted, ()), (0, 1), CallSize(1, 1, memory_bytes=64))
    assert spare == []


def test_large_memory_is_not_kept(spare, monkeypatch):
    monkeypatch.setattr(batch, "_MOST_SPARE_BYTES", 1024)
    for byte_count in (1025, 1024):
        batch.run_calls((lambda *_: None, ()), (0, 3), CallSize(1, 1, memory_bytes=byte_count))
    assert {memory.nbytes for memory in spare} == {1024}


@pytest.mark.parametrize("block", [1, 4])
def test_calls_cover_all_items(block):
    calls, steps = [], []

    def call(begin, end, name):
        assert name == "argument"
        if begin < end:  # else it compiles
            calls.append((begin, end))

    for progress in (None, lambda done, count: steps.append((done, count))):
        calls.clear()
        size = CallSize(8, 9, block, share=4)
        batch.run_calls((call, ("argument",)), (3, 50), size, progress)
        calls.sort()
        assert [begin for begin, _ in calls] + [50] == [3] + [end for _, end in calls]
        assert {end - begin for begin, end in calls[:-1]} <= {8, 9}
    assert steps[-1] == (47, 47)
    calls.clear()
    batch.run_calls((call, ("argument",)), (5, 5), size)
    batch.run_calls((call, ("argument",)), (5, 12), size)
    assert calls == [(5, 12)]


def test_kernels_run_in_turn_for_what_is_undecided():
    asked, steps = [], []

    def decides(divisor, least=1):
        def bind(items):
            asked.append(items.tolist())
            return (lambda begin, end: None, ()), lambda: items % divisor == 0

        return batch.DecidingKernel(bind, CallSize(16, 16), least)

    note = lambda done, count: steps.append((done, count))  # noqa: E731
    batch.run_in_turn([decides(1, 9), decides(2), decides(3), decides(1), decides(1)], 8, note)
    assert asked == [[0, 1, 2, 3, 4, 5, 6, 7], [1, 3, 5, 7], [1, 5, 7]]
    assert steps == [(8, 8)] * 4

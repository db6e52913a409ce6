"""Simulators fed in parallel give the same counts as each alone."""

import threading

import numpy as np
import pytest

from extras import need

need("raystream_lab")

from raystream_lab.caches import Cache, ReuseDistances, feed_chunks


def _chunks(count: int) -> list[np.ndarray]:
    random = np.random.default_rng(5)
    return [random.integers(0, 1 << 16, 1000, dtype=np.uint64) for _ in range(count)]


def test_simulators_in_parallel_count_what_each_counts_alone():
    chunks = _chunks(7)
    together = Cache(4096, 48), Cache(4096, 48, None), ReuseDistances(48)
    alone = Cache(4096, 48), Cache(4096, 48, None), ReuseDistances(48)
    feed_chunks(iter(chunks), [one.access for one in together])
    for chunk in chunks:
        for one in alone:
            one.access(chunk)
    for one, other in zip(together[:2], alone[:2], strict=True):
        assert one.total == other.total
        assert 0 < one.total.hit_rate < 1
    sizes = [1 << bits for bits in range(8, 18)]
    assert np.array_equal(together[2].misses(sizes), alone[2].misses(sizes))


def test_each_consumer_gets_the_chunks_in_order_one_at_a_time():
    seen: list[int] = []
    busy = threading.Lock()

    def take(chunk: int) -> None:
        assert busy.acquire(blocking=False)
        seen.append(chunk)
        busy.release()

    feed_chunks(iter(range(200)), [take, lambda _: None])
    assert seen == list(range(200))


def test_an_empty_trace():
    feed_chunks(iter(()), [lambda _: pytest.fail("taken")])


def test_an_exception_of_a_consumer_is_raised():
    cache = Cache(4096, 48)
    chunks = [np.zeros(4, np.uint64), np.zeros(4, np.int8), np.zeros(4, np.uint64)]
    with pytest.raises(TypeError, match="addresses"):
        feed_chunks(iter(chunks), [cache.access])
    assert cache.total.references == 4

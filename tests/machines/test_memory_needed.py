"""Memory known before a query runs, against what NumPy allocates."""

from __future__ import annotations

import gc
import tracemalloc

import numpy as np
import pytest

import raystream as rs
from conftest import EVERY_TRACER, TRACERS
from meshes import soup
from raystream.core import memory
from raystream.machines import memory_needed

QUERIES = ("first_hit", "any_hit", "count_hits", "multi_hit")

#: Rays for machines that take a pass for each step, and for others.
FEW, MANY = 1 << 14, 1 << 17


def stack(layers):
    """Squares on top of each other, so that downward rays have as many hits."""
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]], float) * 9
    vertices = np.array([[x, y, z] for z in range(layers) for x, y in corners])
    faces = [[4 * k + i for i in face] for k in range(layers) for face in ((0, 1, 2), (0, 2, 3))]
    return vertices, faces


def peak_of(run):
    """Bytes allocated at most during a call, with its result."""
    run()
    gc.collect()
    tracemalloc.start()
    try:
        result = run()
        return tracemalloc.get_traced_memory()[1], result
    finally:
        tracemalloc.stop()


def byte_count(result):
    """Bytes of what a query returns."""
    if isinstance(result, np.ndarray):
        return result.nbytes
    names = [name for name in ("t", "u", "v", "prim_id", "status", "ray_splits")]
    return sum(getattr(result, name).nbytes for name in names if hasattr(result, name))


def scattered(count, rng):
    return rng.random((count, 3), np.float32), rng.normal(size=(count, 3)).astype(np.float32)


def parallel(count, rng):
    """Rays of an image, down a stack."""
    width = int(count**0.5)
    x, y = np.meshgrid(np.linspace(-1, 1, width), np.linspace(-1, 1, count // width))
    origins = np.stack([x + 0.01, y, np.full_like(x, 20.0)], -1).reshape(-1, 3).astype(np.float32)
    return origins, np.broadcast_to(np.array([0, 0, -1], np.float32), origins.shape).copy()


@pytest.mark.parametrize("name", EVERY_TRACER)
@pytest.mark.parametrize("query", QUERIES)
@pytest.mark.parametrize("rays", [scattered, parallel], ids=["scattered", "parallel"])
def test_estimates_bound_what_is_used(name, query, rays, rng):
    is_slow = "multipass" in name or "brute" in name
    mesh = soup(60) if rays is scattered else stack(3)
    tracer = rs.Tracer(rs.Scene.from_arrays(*mesh), **TRACERS[name])
    origins, directions = rays(FEW if is_slow else MANY, rng)
    options = {"max_hits": 3} if query == "multi_hit" else {}
    needed = tracer.memory_needed(len(origins), query, **options)
    peak, result = peak_of(lambda: getattr(tracer, query)(origins, directions, **options))
    assert peak <= needed.total
    if query != "multi_hit" or rays is parallel:  # all rays have three hits
        status = len(origins) if isinstance(result, np.ndarray) else 0  # not returned, but kept
        assert byte_count(result) + status == pytest.approx(needed.results, rel=0.001)
        if not is_slow:
            assert needed.total <= 3 * peak + 2_000_000


def test_counters_need_more():
    scene = rs.load("cornell")
    plain, counting = rs.Tracer(scene), rs.Tracer(scene, counters=True)
    assert counting.memory_needed(1000).results == plain.memory_needed(1000).results + 32_000
    assert counting.memory_needed(0).results == 0


def test_large_queries_are_refused_with_numbers(monkeypatch):
    tracer = rs.Tracer(rs.load("cornell"))
    monkeypatch.setattr(memory, "available_memory", lambda: 5_000_000)
    monkeypatch.setattr(memory_needed, "CHECKED_RAYS", 1000)
    origin, direction = np.float32([278, 273, -800]), np.float32([0, 0, 1])
    many = np.broadcast_to(direction, (500_000, 3))
    for query in QUERIES:
        total = tracer.memory_needed(500_000, query, max_hits=0).total
        found = f"{query}: 500,000 rays would take {total / 1e9:.1f} GB, and 0.0 GB are free"
        if total > 5_000_000:
            with pytest.raises(MemoryError, match=found):
                getattr(tracer, query)(origin, many)
    assert tracer.memory_needed(500_000, "first_hit").total > 5_000_000
    assert tracer.first_hit(origin, many[:2000]).is_hit.all()  # these fit


@pytest.mark.parametrize(
    ("arguments", "options", "error", "named"),
    [
        ((-1,), {}, ValueError, "rays: expected"),
        ((1.5,), {}, TypeError, "integer"),
        ((1, "closest"), {}, ValueError, "query: expected one of first_hit"),
        ((1, "multi_hit"), {}, ValueError, "max_hits: give"),
        ((1, "multi_hit"), {"max_hits": -1}, ValueError, "max_hits: expected"),
    ],
)
def test_bad_input_is_named(arguments, options, error, named):
    tracer = rs.Tracer(rs.load("cornell"))
    with pytest.raises(error, match=named):
        tracer.memory_needed(*arguments, **options)

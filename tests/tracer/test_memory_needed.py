"""Memory known before a query runs, against what NumPy allocates."""

from __future__ import annotations

import gc
import tracemalloc

import numpy as np
import pytest

import raystream as rs
from conftest import TRACERS, every_tracer
from meshes import soup
from raystream.core import memory
from raystream.geometry.instances.groups import CALL_BYTES
from raystream.machines import batch
from raystream.tracer import memory_needed

QUERIES = ("first_hit", "any_hit", "count_hits", "multi_hit")

#: Rays for machines that take a pass for each step, and for others.
FEW, MANY = 1 << 14, 1 << 17


#: Tracers that allocate differently.
USUAL = (
    "bvh",
    "bvh, packets",
    "bvh, groups",
    "kdtree, stack",
    "graph",
    "bvh, multipass, compacting",
)

#: Tracers that choose the kernel by the rays.
CHOOSING = [
    name
    for name, one in TRACERS.items()
    if one["structure"] == "bvh" and not ({"kernel", "machine"} & set(one))
]


def stack(layers):
    """Squares on top of each other, so that downward rays have as many hits."""
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]], float) * 9
    vertices = np.array([[x, y, z] for z in range(layers) for x, y in corners])
    faces = [[4 * k + i for i in face] for k in range(layers) for face in ((0, 1, 2), (0, 2, 3))]
    return vertices, faces


def peak_of(run):
    """Bytes allocated at most during a call, with its result.

    The least of several calls: threads that other tests left, such as Dask's, allocate too.
    """
    run()
    gc.collect()
    peaks = []
    for _ in range(5):
        batch._spare.clear()  # of earlier calls
        tracemalloc.start()
        try:
            result = run()
            peaks.append(tracemalloc.get_traced_memory()[1])
        finally:
            tracemalloc.stop()
    return min(peaks), result


def byte_count(result):
    """Bytes of what a query returns."""
    if isinstance(result, np.ndarray):
        return result.nbytes
    names = "t", "u", "v", "prim_id", "status", "ray_splits", "sectors", "_instance_id"
    arrays = [getattr(result, name, None) for name in names]
    return sum(array.nbytes for array in arrays if array is not None)


def scattered(count, rng):
    return rng.random((count, 3), np.float32), rng.normal(size=(count, 3)).astype(np.float32)


def parallel(count, rng):
    """Rays of an image, down a stack."""
    width = int(count**0.5)
    x, y = np.meshgrid(np.linspace(-1, 1, width), np.linspace(-1, 1, count // width))
    origins = np.stack([x + 0.01, y, np.full_like(x, 20.0)], -1).reshape(-1, 3).astype(np.float32)
    return origins, np.broadcast_to(np.array([0, 0, -1], np.float32), origins.shape).copy()


@pytest.mark.parametrize("name", every_tracer(USUAL, everyday=("kdtree, stack",)))
@pytest.mark.parametrize("query", QUERIES)
@pytest.mark.parametrize(
    "rays",
    [
        pytest.param(scattered, id="scattered"),
        pytest.param(parallel, id="parallel", marks=pytest.mark.ci),
    ],
)
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
        spare = 500_000 * rs.thread_count()  # beside the arrays
        if name in CHOOSING and len(origins) > 1024:
            spare += 22_000_000 * rs.thread_count()
        assert needed.total <= 2 * peak + spare


@pytest.mark.ci
@pytest.mark.parametrize("query", QUERIES)
def test_instances_need_more(query, rng):
    transforms = np.tile(np.eye(3, 4), (2, 1, 1))
    transforms[1, 2, 3] = 0.5
    objects = [rs.Scene.from_arrays(*stack(2))]
    tracer = rs.Tracer(rs.Scene.instances(objects, transforms))
    origins, directions = parallel(MANY, rng)
    options = {"max_hits": 4} if query == "multi_hit" else {}
    needed = tracer.memory_needed(len(origins), query, **options)
    peak, result = peak_of(lambda: getattr(tracer, query)(origins, directions, **options))
    status = len(origins) if isinstance(result, np.ndarray) else 0
    assert byte_count(result) + status == pytest.approx(needed.results, rel=0.001)
    spare = 300_000
    if query in ("first_hit", "any_hit"):  # the memory of groups, if single rays were chosen
        spare += CALL_BYTES
    assert peak <= needed.total <= 2 * peak + spare * rs.thread_count()


def test_counters_need_more():
    scene = rs.load("cornell")
    plain, counting = rs.Tracer(scene), rs.Tracer(scene, counters=True)
    assert counting.memory_needed(1000).results == plain.memory_needed(1000).results + 32_000
    assert counting.memory_needed(0).results == 0


def test_large_queries_are_refused_with_numbers(monkeypatch):
    tracer = rs.Tracer(rs.load("cornell"), kernel="wavefront")
    monkeypatch.setattr(memory, "available_memory", lambda: 5_000_000)
    monkeypatch.setattr(memory_needed, "CHECKED_RAYS", 1000)
    origin, direction = np.float32([278, 273, -800]), np.float32([0, 0, 1])
    many = np.broadcast_to(direction, (500_000, 3))
    for query in QUERIES:
        total = tracer.memory_needed(500_000, query, max_hits=0).total
        found = f"{query}: 500,000 rays would take {total / 1e9:.1f} GB, but only 0.0 GB are free"
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
        ((1, "multi_hit"), {}, ValueError, "max_hits: required"),
        ((1, "multi_hit"), {"max_hits": -1}, ValueError, "max_hits: expected"),
    ],
)
def test_bad_input_is_named(arguments, options, error, named):
    tracer = rs.Tracer(rs.load("cornell"))
    with pytest.raises(error, match=named):
        tracer.memory_needed(*arguments, **options)

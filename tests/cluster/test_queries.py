"""Queries on a cluster: one process's bits, lazily and in order, for any chunks of rays."""

from __future__ import annotations

import math

import numpy as np
import pytest

from extras import need

need("dask", "distributed")

import dask.array as da

import raystream as rs
from cases import CASES
from conftest import TRACERS, assert_same_bits

HITS = ("t", "u", "v", "prim_id", "status", "mesh_id", "mesh_prim_id", "positions", "normals")
ROWS = (*HITS, "ray_splits", "counts")

#: Chunks of origins and directions that do not fit each other, and split vectors.
UNEQUAL = {"origins": (170, 2), "directions": (230, 3), "t_min": 90, "t_max": 400}


def lazily(rays):
    return {
        name: da.from_array(a, chunks=UNEQUAL[name]) if np.ndim(a) else a
        for name, a in rays.items()
    }


def rays_of(name):
    case = CASES[name](np.random.default_rng(2013))
    names = ("origins", "directions", "t_min", "t_max")
    return case.scene, {key: getattr(case, key) for key in names}


def assert_same(lazy, expected, names) -> None:
    """Results computed as a whole and column by column, and their announced types."""
    import dask

    whole = lazy.compute()
    columns = dask.compute(*(getattr(lazy, name) for name in names))
    for name, column in zip(names, columns, strict=True):
        promised, wanted = getattr(lazy, name), getattr(expected, name)
        assert_same_bits(getattr(whole, name), wanted)
        assert_same_bits(column, wanted)
        assert promised.dtype == wanted.dtype
        assert promised.ndim == wanted.ndim
        assert promised.shape == wanted.shape or math.isnan(promised.shape[0])


@pytest.fixture
def rays():
    """Many rays in a room, some of them invalid."""
    rng = np.random.default_rng(5)
    origins = rng.random((600, 3)) * 500.0
    directions = rng.normal(size=(600, 3))
    directions[7], directions[300, 1] = 0.0, np.nan
    return origins, directions


@pytest.fixture(scope="module")
def local(room):
    return rs.Tracer(room)


@pytest.fixture(scope="module")
def tracer(local, client):
    with rs.cluster.Tracer(local, client) as tracer:
        yield tracer


#: Two here; in .ci/nightly every way to trace on the CPU, with both.
FEW = (("bvh", "random_soup"), ("kdtree, restart", "limits_at_the_hits_themselves"))
WAYS = [
    pytest.param(way, name, marks=[pytest.mark.exhaustive] * ((way, name) not in FEW))
    for way in TRACERS
    for name in ("random_soup", "limits_at_the_hits_themselves")
]


@pytest.mark.parametrize(("way", "name"), WAYS)
def test_bits_are_those_of_one_process(client, way, name):
    scene, given = rays_of(name)
    options = TRACERS[way]
    local = rs.Tracer(scene, **options)
    lazy = lazily(given)
    with rs.cluster.Tracer(scene, client, **options) as tracer:
        assert_same(tracer.first_hit(**lazy), local.first_hit(**given), HITS)
        assert_same_bits(tracer.any_hit(**lazy).compute(), local.any_hit(**given))
        for crossings in ("triangles", "surfaces"):
            kind = {"crossings": crossings}
            counts = tracer.count_hits(**lazy, **kind)
            assert_same_bits(counts.compute(), local.count_hits(**given, **kind))
            for max_hits in (None, 2):
                many = tracer.multi_hit(**lazy, **kind, max_hits=max_hits)
                assert_same(many, local.multi_hit(**given, **kind, max_hits=max_hits), ROWS)


@pytest.mark.parametrize(
    ("shape", "chunks"),
    [
        ((20, 30), (7, 11)),
        pytest.param((2, 5, 60), (1, 5, 25), marks=pytest.mark.exhaustive),
        pytest.param((600,), 600, marks=pytest.mark.exhaustive),
        pytest.param((1, 600), (1, 100), marks=pytest.mark.exhaustive),
    ],
)
def test_leading_shapes_and_order(tracer, local, rays, shape, chunks):
    origins, directions = (array.reshape(*shape, 3) for array in rays)
    whole = chunks if isinstance(chunks, tuple) else (chunks,)
    lazy = da.from_array(directions, chunks=(*whole, 3))
    hits = tracer.first_hit(origins, lazy)
    assert hits.t.chunks == lazy.chunks[:-1]
    assert_same(hits, local.first_hit(origins, directions), HITS)
    many = tracer.multi_hit(origins, lazy, t_max=900.0)
    assert_same(many, local.multi_hit(origins, directions, t_max=900.0), ROWS)


@pytest.mark.parametrize(
    "kind",
    [
        "a grid",
        "none",
        pytest.param("a vector", marks=pytest.mark.exhaustive),
        pytest.param("one ray", marks=pytest.mark.exhaustive),
        pytest.param("numpy", marks=pytest.mark.exhaustive),
        pytest.param("no rays", marks=pytest.mark.exhaustive),
    ],
)
def test_rays_broadcast_as_they_do_here(tracer, local, rays, kind):
    origins, directions = rays
    limit = np.float64(700.0)
    if kind == "a vector":
        origins = origins[0]
        given = origins.tolist(), da.from_array(directions, chunks=(250, 3))
    elif kind == "a grid":
        origins, directions = origins[:40].reshape(40, 1, 3), directions[:50].reshape(1, 50, 3)
        limit = np.linspace(100.0, 900.0, 50)
        lazy = [da.from_array(a, chunks=(13, 17, 3)) for a in (origins, directions)]
        given = lazy[0], lazy[1]
    elif kind == "one ray":
        origins, directions = origins[0], directions[0]
        given = origins, da.from_array(directions, chunks=2)
    elif kind == "none":
        origins, directions = origins[:0], directions[:0]
        given = origins, da.from_array(directions, chunks=(1, 3))
    elif kind == "no rays":
        origins = directions = np.empty(0)
        given = origins, directions
    else:
        given = origins, directions
    asked = {"t_max": limit}
    assert_same(
        tracer.first_hit(*given, **asked), local.first_hit(origins, directions, **asked), HITS
    )
    many = tracer.multi_hit(*given, **asked, max_hits=2)
    assert_same(many, local.multi_hit(origins, directions, **asked, max_hits=2), ROWS)
    expected = local.count_hits(origins, directions, **asked)
    assert_same_bits(tracer.count_hits(*given, **asked).compute(), expected)


def refuse(*_, **__):
    raise AssertionError("computed too early")


def test_nothing_is_computed_before_it_is_asked_for(tracer, rays):
    def unmade(shape, chunks):
        chunks = da.core.normalize_chunks(chunks, shape)
        return da.map_blocks(refuse, chunks=chunks, meta=np.empty((0,) * len(shape)))

    origins, directions = unmade((600, 3), (100, 3)), unmade((600, 3), (150, 2))
    limit = unmade((600,), (200,))
    hits = tracer.first_hit(origins, directions, t_max=limit)
    many = tracer.multi_hit(origins, directions, t_min=limit)
    lazy = [hits.positions, hits.normals, hits.mesh_id, hits.is_hit, many.ray_splits, many.counts]
    lazy += [tracer.any_hit(origins, directions), tracer.count_hits(origins, directions)]
    assert all(isinstance(array, da.Array) for array in lazy)
    assert "600" in repr(hits)
    with pytest.raises(AssertionError, match="too early"):
        hits.t.compute()


def test_names_say_what_is_computed(client, room, tracer, rays):
    origins, directions = rays
    with (
        rs.cluster.Tracer(room, client) as same,
        rs.cluster.Tracer(room, client, "kdtree") as other,
    ):
        names = [t.first_hit(origins, directions).t.name for t in (tracer, same, other)]
    assert names[0] == names[1] != names[2]
    assert tracer.first_hit(origins, directions, t_max=1.0).t.name != names[0]
    assert tracer.first_hit(origins, directions + 1.0).t.name != names[0]


def test_hits_that_are_kept_are_traced_once(tracer, local, rays):
    hits = tracer.first_hit(*rays).persist()
    many = tracer.multi_hit(*rays).persist()
    assert_same(hits, local.first_hit(*rays), HITS)
    assert_same(many, local.multi_hit(*rays), ROWS)


@pytest.mark.parametrize(
    ("origins", "directions", "limits", "kind", "says"),
    [
        (np.zeros((4, 2)), np.ones((4, 3)), {}, ValueError, r"origins: expected shape \(..., 3\)"),
        (np.zeros((4, 3)), np.ones((5, 3)), {}, ValueError, "do not broadcast"),
        (np.zeros((4, 3)), np.ones((4, 3)), {"t_max": np.ones(3)}, ValueError, "t_max: shape"),
        (np.zeros((4, 3)), np.array([["a", "b", "c"]]), {}, TypeError, "directions: expected real"),
        (np.zeros((4, 3)), np.ones((4, 3)), {"t_min": "near"}, TypeError, "t_min"),
    ],
)
def test_bad_rays_are_refused_at_once_as_they_are_here(
    tracer, local, origins, directions, limits, kind, says
):
    with pytest.raises(kind, match=says):
        local.first_hit(origins, directions, **limits)
    for query in (tracer.first_hit, tracer.any_hit, tracer.count_hits, tracer.multi_hit):
        with pytest.raises(kind, match=says):
            query(origins, directions, **limits)
        with pytest.raises(kind, match=says):
            query(da.from_array(origins), da.from_array(directions), **limits)


def test_bad_options_are_refused_at_once(tracer, local, client, room, rays):
    with pytest.raises(ValueError, match="max_hits"):
        tracer.multi_hit(*rays, max_hits=-1)
    with pytest.raises(ValueError, match="crossings"):
        tracer.count_hits(*rays, crossings="edges")
    unknown = da.from_array(rays[0], chunks=(100, 3))
    unknown = unknown[unknown[:, 0] > 100.0]
    with pytest.raises(ValueError, match="compute_chunk_sizes"):
        tracer.any_hit(unknown, rays[1])
    with pytest.raises(ValueError, match="counters"):
        rs.cluster.Tracer(room, client, counters=True)
    with pytest.raises(ValueError, match="cannot be combined with an existing Tracer"):
        rs.cluster.Tracer(local, client, "grid")
    with pytest.raises(TypeError, match="expected a Scene or Tracer"):
        rs.cluster.Tracer([1, 2], client)
    with pytest.raises(TypeError, match="resolutions"):
        rs.cluster.Tracer(room, client, "grid", resolutions=3)


def test_a_closed_tracer_is_no_more(client, room, rays):
    tracer = rs.cluster.Tracer(room, client, "kdtree")
    hits = tracer.first_hit(*rays)
    tracer.close()
    tracer.close()
    with pytest.raises(ValueError, match="closed"):
        tracer.first_hit(*rays)
    with pytest.raises(rs.RaystreamError, match="was closed"):
        hits.t.compute()


@pytest.mark.parametrize(
    ("client", "kind", "says"),
    [
        ("nowhere", ValueError, "expected an address"),
        ("local:0", ValueError, "local:1"),
        (3, TypeError, "expected a distributed.Client"),
    ],
)
def test_what_is_no_cluster_is_refused(room, client, kind, says):
    with pytest.raises(kind, match=says):
        rs.cluster.Tracer(room, client)


def threads_seen(block):
    from raystream.cluster.thread_budget import shared_threads

    with shared_threads():
        return block + rs.thread_count()


def test_a_task_has_the_threads_of_its_worker(client):
    counts = da.zeros(4, chunks=1).map_blocks(threads_seen, meta=np.empty(0))
    assert client.compute(counts).result().tolist() == [1.0] * 4

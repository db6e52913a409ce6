"""The compute machine: answers, counts, limits and errors."""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest

import raystream as rs
from meshes import dented_sphere
from raystream.graphics import dispatches
from raystream.graphics.dispatch_size import DispatchSize
from raystream.graphics.errors import GraphicsError
from raystream.graphics.structures import shader_structure_of

pytestmark = pytest.mark.usefixtures("opened")

#: Two in the way of rays along z, and one aside.
LAYERS = [
    [0, 0, 1],
    [2, 0, 1],
    [0, 2, 1],
    [0, 0, 3],
    [2, 0, 3],
    [0, 2, 3],
    [5, 5, 0],
    [6, 5, 0],
    [5, 6, 0],
]
FACES = [[0, 1, 2], [3, 4, 5], [6, 7, 8]]


@pytest.fixture
def layers():
    return rs.Scene.from_arrays(np.array(LAYERS, float), FACES)


@pytest.fixture(scope="module")
def dent():
    return rs.Scene.from_arrays(*dented_sphere(2))


def rays_at(scene, count=300, seed=0):
    """Rays from around a scene to points in it."""
    rng = np.random.default_rng(seed)
    corners = np.concatenate([mesh.vertices for mesh in scene.meshes])
    low, high = corners.min(axis=0), corners.max(axis=0)
    origins = (low + high) / 2 + rng.normal(size=(count, 3)) * (high - low)
    return origins, low + rng.random((count, 3)) * (high - low) - origins


def assert_same_hits(found, expected):
    """Same triangles; t to a few of its last bits, which a driver's division may change."""
    np.testing.assert_array_equal(found.prim_id, expected.prim_id)
    np.testing.assert_allclose(found.t, expected.t, rtol=1e-5)
    np.testing.assert_allclose(found.u, expected.u, atol=1e-5)
    np.testing.assert_allclose(found.v, expected.v, atol=1e-5)


def assert_same_answers(tracer, other, rays, **limits):
    """All four queries."""
    assert_same_hits(tracer.first_hit(*rays, **limits), other.first_hit(*rays, **limits))
    np.testing.assert_array_equal(tracer.any_hit(*rays, **limits), other.any_hit(*rays, **limits))
    np.testing.assert_array_equal(
        tracer.count_hits(*rays, **limits), other.count_hits(*rays, **limits)
    )
    found, expected = tracer.multi_hit(*rays, **limits), other.multi_hit(*rays, **limits)
    np.testing.assert_array_equal(found.ray_splits, expected.ray_splits)
    assert_same_hits(found, expected)


def test_layers_by_hand(layers):
    tracer = rs.Tracer(layers, "bvh", "graphics")
    rays = [[0.5, 0.5, 0], [0.5, 0.5, 5], [4, 4, 5]], [[0, 0, 1], [0, 0, -2], [0, 0, 1]]
    hits = tracer.first_hit(*rays)
    assert hits.t.tolist() == [1.0, 1.0, np.inf]
    assert hits.prim_id.tolist() == [0, 1, -1]
    assert hits.u[:2].tolist() == [0.25, 0.25]
    assert tracer.any_hit(*rays).tolist() == [True, True, False]
    assert tracer.count_hits(*rays).tolist() == [2, 2, 0]
    every = tracer.multi_hit(*rays)
    assert every.prim_id.tolist() == [0, 1, 1, 0]
    assert every.t.tolist() == [1.0, 3.0, 1.0, 2.0]


@pytest.mark.parametrize(
    "options", [{}, {"quality": "fast", "max_leaf_size": 32}, {"max_leaf_size": 1}], ids=str
)
def test_trees_of_any_kind(dent, options):
    rays = rays_at(dent)
    tracer = rs.Tracer(dent, "bvh", "graphics", **options)
    assert_same_answers(tracer, rs.Tracer(dent, "brute"), rays)


def is_even(hit):
    return hit.prim_id % 2 == 0


@pytest.mark.exhaustive
def test_filters(dent):
    rays = rays_at(dent)
    tracer, other = (rs.Tracer(dent, "bvh", device) for device in ("graphics", "cpu"))
    nearest = other.first_hit(*rays)
    hits = tracer.first_hit(*rays, skip_prim_ids=nearest.prim_id)
    assert_same_hits(hits, other.first_hit(*rays, skip_prim_ids=nearest.prim_id))
    assert not (hits.prim_id == nearest.prim_id)[nearest.is_hit].any()
    hits = tracer.first_hit(*rays, on_hit=is_even)
    assert_same_hits(hits, other.first_hit(*rays, on_hit=is_even))
    assert (hits.prim_id[hits.is_hit] % 2 == 0).all()


@pytest.mark.parametrize("structure", ["bvh", "grid"])
def test_counters_are_those_of_the_cpu(dent, structure):
    rays = rays_at(dent)
    tracer, other = (
        rs.Tracer(dent, structure, device, counters=True) for device in ("graphics", "cpu")
    )
    for one in (tracer, other):
        one.first_hit(*rays)
    for name in ("steps", "leaves", "tests"):
        counts = getattr(tracer.counters, name)
        assert counts.sum() > 0
        np.testing.assert_array_equal(counts, getattr(other.counters, name))


def test_moved_vertices(dent):
    """Also a triangle that cannot be hit after that: its coordinates are NaN."""
    tracer = rs.Tracer(dent, "bvh", "graphics")
    vertices = dent.meshes[0].vertices * [1.0, 1.5, 0.8] + [0.0, 0.1, 0.0]
    vertices[0] = np.nan
    report = tracer.update(vertices, max_cost_growth=np.inf)
    assert not report.rebuilt
    moved = rs.Scene.from_arrays(vertices, dent.meshes[0].faces)
    assert_same_answers(tracer, rs.Tracer(moved, "brute"), rays_at(dent))


@pytest.mark.parametrize("offset", [(1e5, 5e4, 0.0), (0.0, 5e6, 0.0)])
def test_vertices_that_move_far(dent, offset):
    tracer = rs.Tracer(dent, "bvh", "graphics")
    moved = rs.Scene.from_arrays(dent.meshes[0].vertices + offset, dent.meshes[0].faces)
    assert tracer.update(moved).rebuilt
    assert_same_answers(tracer, rs.Tracer(moved, "brute"), rays_at(moved))


def test_moving_vertices_of_one_of_two_tracers(dent):
    tracer, rays = rs.Tracer(dent, "bvh"), rays_at(dent)
    other = rs.Tracer.of_structure(tracer.structure, dent, "graphics")
    vertices = dent.meshes[0].vertices * [1.0, 1.5, 0.8]
    moved = rs.Tracer(rs.Scene.from_arrays(vertices, dent.meshes[0].faces), "brute")
    other.update(vertices, max_cost_growth=np.inf)
    assert_same_answers(other, moved, rays)
    assert_same_answers(tracer, rs.Tracer(dent, "brute"), rays)
    last = rs.Tracer.of_structure(tracer.structure, dent, "graphics")
    tracer.update(vertices, max_cost_growth=np.inf)
    assert_same_answers(tracer, moved, rays)
    assert_same_answers(last, rs.Tracer(dent, "brute"), rays)


def test_no_triangles():
    empty = rs.Scene.from_arrays(np.zeros((3, 3)), [[0, 1, 2]])
    tracer = rs.Tracer(empty, "bvh", "graphics")
    rays = np.zeros((5, 3)), np.ones((5, 3))
    assert tracer.first_hit(*rays).prim_id.tolist() == [-1] * 5
    assert not tracer.any_hit(*rays).any()
    assert len(tracer.multi_hit(*rays).t) == 0
    assert tracer.first_hit(np.empty((0, 3)), np.empty((0, 3))).t.shape == (0,)


def test_invalid_rays_miss(layers):
    tracer = rs.Tracer(layers, "bvh", "graphics")
    origins = [[0.5, 0.5, 0]] * 4 + [[np.nan, 0, 0], [0.5, 0.5, 1e300]]
    directions = [[0, 0, 1], [0, 0, 0], [0, np.inf, 1], [np.nan, 0, 1], [0, 0, 1], [0, 0, -1]]
    hits = tracer.first_hit(origins, directions)
    assert hits.prim_id.tolist() == [0, -1, -1, -1, -1, -1]
    assert hits.status.tolist() == [0, 1, 1, 1, 1, 1]
    assert tracer.count_hits(origins, directions).tolist() == [2, 0, 0, 0, 0, 0]


def test_limits_are_closed(layers):
    tracer = rs.Tracer(layers, "bvh", "graphics")
    rays = np.array([[0.5, 0.5, 0.0]] * 6), np.array([[0, 0, 1.0]] * 6)
    t_min, t_max = [0, 1, 1.5, 3.5, 0, -2], [1, np.inf, 3, np.inf, 0.5, -1]
    assert tracer.first_hit(*rays, t_min=t_min, t_max=t_max).t.tolist() == [
        *(1.0, 1.0, 3.0),
        *(np.inf, np.inf, np.inf),
    ]
    assert tracer.count_hits(*rays, t_min=t_min, t_max=t_max).tolist() == [1, 2, 1, 0, 0, 0]


@pytest.mark.parametrize("max_hits", [0, 1, 2, 1000])
def test_the_nearest_hits(dent, max_hits):
    rays = rays_at(dent, 50)
    tracer, other = rs.Tracer(dent, "bvh", "graphics"), rs.Tracer(dent, "brute")
    found, expected = (one.multi_hit(*rays, max_hits=max_hits) for one in (tracer, other))
    np.testing.assert_array_equal(found.ray_splits, expected.ray_splits)
    assert_same_hits(found, expected)


def test_batches_of_any_size_are_the_same_in_parts(dent):
    rays = rays_at(dent, 130)
    whole = rs.Tracer(dent, "bvh", "graphics").first_hit(*rays)
    parts = rs.Tracer(dent, "bvh", "graphics", rays_at_once=64)
    calls = []
    found = parts.first_hit(*rays, progress=lambda done, count: calls.append((done, count)))
    assert found.t.tobytes() == whole.t.tobytes()
    assert calls == [(64, 130), (128, 130), (130, 130)]


def test_dispatches_keep_their_pace():
    pace = DispatchSize(100_000)
    assert pace.size == 1024
    pace.took(1024, 0.001)
    assert pace.size == 8192  # never by more than 8 times
    pace.took(8192, 0.01)
    pace.took(65536, 0.1)
    assert pace.size == 100_000
    pace.took(50, 0.001)  # the last ones of a batch say nothing
    assert pace.size == 100_000
    pace.took(100_000, 20.0)
    assert pace.size == 1000
    pace.took(1, 60.0)
    assert pace.size == 1


def test_rays_that_were_not_traced_are_an_error(layers, monkeypatch):
    tracer = rs.Tracer(layers, "bvh", "graphics")
    rays = np.zeros((200, 3)), -np.ones((200, 3))
    with monkeypatch.context() as context:
        context.setattr(dispatches, "_GROUP_SIZE", 128)  # half of the workgroups there should be
        with pytest.raises(GraphicsError, match=r"72 of 200 rays in 'bvh' were not traced"):
            tracer.first_hit(*rays)
    assert not tracer.any_hit(*rays).any()  # and the device is as good as before


def test_searches_without_end_are_an_error(dent, monkeypatch):
    made = dispatches.Dispatcher.__init__

    def with_small_budget(self, shaders, *rest):
        made(self, dataclasses.replace(shaders, budget=9), *rest)

    monkeypatch.setattr(dispatches.Dispatcher, "__init__", with_small_budget)
    tracer = rs.Tracer(dent, "bvh", "graphics")
    with pytest.raises(GraphicsError, match="more than 9 steps and tests"):
        tracer.count_hits(*rays_at(dent))


def test_what_a_driver_cuts_short_is_never_an_answer():
    """Mesa's software driver leaves loops after 65,535 iterations without an error."""
    count = 70_000
    triangle = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], float)
    heights = np.arange(count)[:, None, None] * [0, 0, 1.0]
    vertices = (triangle + heights).reshape(-1, 3)
    scene = rs.Scene.from_arrays(vertices, np.arange(3 * count).reshape(-1, 3))
    tracer = rs.Tracer(scene, "brute", "graphics")
    try:
        hits = tracer.first_hit([0.1, 0.1, count], [0, 0, -1])
    except GraphicsError as error:
        assert "1 of 1 rays in 'brute' were cut short" in str(error)  # noqa: PT017
    else:
        assert hits.prim_id == count - 1


def test_bad_options(layers):
    with pytest.raises(ValueError, match="rays_at_once: expected at least 1, got 0"):
        rs.Tracer(layers, "bvh", "graphics", rays_at_once=0)
    with pytest.raises(GraphicsError, match="supports the structures"):
        shader_structure_of(SimpleNamespace(name="lattice"))

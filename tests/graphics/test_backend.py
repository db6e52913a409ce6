"""Queries of the graphics machines: rays in parts of any size, and counters."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

import raystream as rs
from conftest import GRAPHICS_TRACERS, assert_same_bits
from meshes import soup
from raystream.graphics import backend
from test_agreement import answers_of, assert_expected


@pytest.fixture
def scene():
    return rs.Scene.from_arrays(*soup(60, 1))


@pytest.fixture
def rays(rng):
    origins = rng.normal(size=(300, 3)) * 2
    return {"origins": origins, "directions": rng.random((300, 3)) - origins}


@pytest.mark.parametrize("name", GRAPHICS_TRACERS)
def test_the_size_of_dispatches_changes_nothing(opened, scene, rays, monkeypatch, name):
    options = GRAPHICS_TRACERS[name]
    if "machine" in options:
        pytest.skip("another machine")
    expected = answers_of(rs.Tracer(scene, **options), rays, is_brief=True)
    monkeypatch.setattr(backend, "_ROWS_AT_ONCE", 20)
    answers = answers_of(rs.Tracer(scene, **options, rays_at_once=77), rays, is_brief=True)
    assert_expected(answers, expected)
    # Rows of workgroups, as where one dimension has too few.
    monkeypatch.setitem(opened.limits, "max-compute-workgroups-per-dimension", 2)
    assert_expected(answers_of(rs.Tracer(scene, **options), rays, is_brief=True), expected)


@pytest.mark.parametrize("name", ["grid, graphics", "grid, fragments, graphics"])
def test_threads_may_ask_at_once(opened, scene, rays, name):
    """Threads of a renderer: a tracer's buffers are used by one query at a time."""
    tracer = rs.Tracer(scene, **GRAPHICS_TRACERS[name])
    parts = [{key: array[k::10] for key, array in rays.items()} for k in range(10)]
    expected = [tracer.first_hit(**part).t for part in parts]
    with ThreadPoolExecutor(4) as pool:
        found = pool.map(lambda part: tracer.first_hit(**part).t, parts)
        for ours, alone in zip(found, expected, strict=True):
            assert_same_bits(ours, alone)


@pytest.mark.parametrize("count", [0, -3])
def test_rays_at_once_is_checked(opened, scene, count):
    with pytest.raises(ValueError, match="rays_at_once: expected at least 1"):
        rs.Tracer(scene, "brute", "graphics", rays_at_once=count)


def test_a_structure_without_shaders_is_refused(opened, scene, monkeypatch):
    monkeypatch.delitem(rs.Graph.forms, "graphics")
    with pytest.raises(rs.RaystreamError, match=r"supports the structures 'bvh'.*, not 'graph'"):
        rs.Tracer(scene, "graph", "graphics")


def test_progress_reaches_the_end(opened, scene, rays):
    tracer = rs.Tracer(scene, "grid", "graphics", rays_at_once=100)
    for query in ("first_hit", "any_hit", "count_hits", "multi_hit"):
        seen = []
        getattr(tracer, query)(**rays, progress=lambda *pair, seen=seen: seen.append(pair))
        assert seen == sorted(seen)
        done, total = seen[-1]
        assert done == total >= 300
    assert np.isfinite(tracer.first_hit(**rays).t).any()


@pytest.mark.parametrize("name", ["bvh, graphics", "grid, fragments, graphics"])
def test_a_cast_is_a_first_hit_of_one_ray(opened, name):
    tracer = rs.Tracer(rs.load("cornell"), **GRAPHICS_TRACERS[name])
    ray = (278, 273, -800), (0, 0, 1)
    hit, hits = tracer.cast(*ray), tracer.first_hit(*ray)
    assert hit == (hits.t.item(), hits.u.item(), hits.v.item(), 30)

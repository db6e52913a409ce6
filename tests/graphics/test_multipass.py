"""Purcell's ray tracer on the graphics pipeline: the passes of the CPU's multipass machine."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

import raystream as rs
from conftest import assert_same_bits
from exact_scene import exact_rays, lattice_scene
from meshes import soup
from raystream.graphics import shader_source as sources
from raystream.graphics.errors import GraphicsError
from raystream.graphics.multipass import loops, plan
from raystream.graphics.multipass.kernels import STREAMS, kernels_of
from raystream.graphics.streams.stencil import Stencil
from raystream.graphics.streams.textures import StreamShape, StreamTexture
from raystream.kernels.tally import COLUMNS
from raystream.machines.schedulers import Threshold
from raystream.machines.steps import steps_of
from raystream.structures import build_structure, names_with

SHADERS = Path(sources.__file__).parent / "shaders"

#: Of structure and machine: every scheduler, and more than one step in a pass.
WAYS = {
    "grid": {"structure": "grid"},
    "grid, naive": {"structure": "grid", "scheduler": "naive"},
    "grid, a third": {"structure": "grid", "threshold": 0.37, "traversal_steps": 3},
    "grid, most work, unrolled": {
        "structure": "grid",
        "scheduler": "most-work",
        "traversal_steps": 2,
        "intersections": 3,
    },
    "grid, two levels, double": {
        "structure": "grid",
        "resolution": (2, 3, 2),
        "levels": 2,
        "scheduler": "double",
        "traversal_steps": 4,
    },
    "brute": {"structure": "brute", "intersections": 40},
}

#: With which a structure has kernels, if not with its usual options.
OPTIONS = {"kdtree": {"traversal": "restart"}}

QUERIES = ("first_hit", "any_hit", "count_hits", "multi_hit")


def multipass(scene, device="graphics", structure="grid", **options):
    return rs.Tracer(scene, structure, device, machine="multipass", **options)


def passes_of(tracer):
    return [(one.kernel, one.run_count, one.record_count) for one in tracer.counters.passes]


def assert_same_hits(ours, theirs):
    assert_same_bits(ours.prim_id, theirs.prim_id)
    np.testing.assert_allclose(ours.t, theirs.t, rtol=1e-5)


def assert_same_run(ours, theirs):
    """The same passes over the same rays, with the same tallies per ray."""
    assert passes_of(ours) == passes_of(theirs)
    for column in COLUMNS:
        assert_same_bits(getattr(ours.counters, column), getattr(theirs.counters, column))
    assert ours.counters.passes.most_runs == theirs.counters.passes.most_runs
    assert ours.counters.passes.optimal_count == theirs.counters.passes.optimal_count


@pytest.fixture
def scene():
    return rs.Scene.from_arrays(*soup(60, 1))


@pytest.fixture
def rays(rng):
    origins = rng.normal(size=(300, 3)) * 2
    return {"origins": origins, "directions": rng.random((300, 3)) - origins}


@pytest.mark.parametrize("name", names_with("graphics multipass"))
def test_kernels_are_those_of_the_cpu(scene, name):
    structure = build_structure(name, scene.triangles, **OPTIONS.get(name, {}))
    ours, theirs = kernels_of(structure).kernels, steps_of(structure).kernels
    assert [(one.name, one.state) for one in ours] == [(one.name, one.state) for one in theirs]
    for one in ours:
        assert "state" in one.writes
        assert set(one.writes) <= set(STREAMS)


@pytest.mark.parametrize("name", names_with("graphics multipass"))
def test_kernels_discard_nothing(scene, name):
    """Otherwise the stencil test would come after them."""
    traversal = kernels_of(build_structure(name, scene.triangles, **OPTIONS.get(name, {})))
    text = sources.shader_source(traversal.shader)
    assert not re.search(r"^\s*discard", text, re.MULTILINE)
    for one in traversal.kernels:
        assert f"fn {one.entry}(" in text


@pytest.mark.parametrize("name", WAYS)
def test_passes_are_exactly_the_cpu_s_where_arithmetic_is_exact(opened, name):
    rays = exact_rays()
    ours, theirs = (
        multipass(lattice_scene(), device, counters=True, **WAYS[name])
        for device in ("graphics", "cpu")
    )
    for query in QUERIES if name == "grid" else ("first_hit",):
        found, expected = getattr(ours, query)(*rays), getattr(theirs, query)(*rays)
        assert_same_run(ours, theirs)
        if query in ("first_hit", "multi_hit"):
            assert_same_hits(found, expected)
        else:
            assert_same_bits(found, expected)
    assert len(ours.counters.passes) >= 10
    assert ours.counters.passes.draw_count > len(ours.counters.passes)


def test_passes_are_nearly_the_cpu_s_elsewhere(opened):
    scene = rs.load("cornell")
    rays = scene.camera_for(1.0).rays(32, 32)
    ours, theirs = (multipass(scene, device, counters=True) for device in ("graphics", "cpu"))
    assert_same_hits(ours.first_hit(*rays), theirs.first_hit(*rays))
    assert len(ours.counters.passes) == pytest.approx(len(theirs.counters.passes), rel=1e-3)
    runs, expected = (sum(run for _, run, _ in passes_of(one)) for one in (ours, theirs))
    assert runs == pytest.approx(expected, rel=1e-3)


@pytest.mark.parametrize("scheduler", ["naive", Threshold(0.2)])
def test_occlusion_queries_lead_to_the_same_passes(opened, scheduler):
    rays = exact_rays()
    try:
        ours = multipass(lattice_scene(), scheduler=scheduler, loop="queries", counters=True)
        hits = ours.first_hit(*rays)
    except GraphicsError as error:
        pytest.skip(str(error))
    theirs = multipass(lattice_scene(), "cpu", scheduler=scheduler, counters=True)
    assert_same_hits(hits, theirs.first_hit(*rays))
    assert_same_run(ours, theirs)


def test_queries_whose_answers_are_not_exact_are_refused(opened, scene, rays, monkeypatch):
    monkeypatch.setattr(loops._Counts, "read", lambda self, encoder, count: [1] * count)
    with pytest.raises(GraphicsError, match=r"inexactly .*1 for 300 fragments.*loop='device'"):
        multipass(scene, loop="queries").first_hit(**rays)


def test_two_targets_are_enough(opened, monkeypatch):
    """The number that every adapter supports: then a kernel is drawn twice."""
    rays = exact_rays()
    theirs = multipass(lattice_scene(), "cpu", counters=True)
    expected = theirs.first_hit(*rays)
    monkeypatch.setitem(opened.limits, "max-color-attachment-bytes-per-sample", 32)
    ours = multipass(lattice_scene(), counters=True)
    assert_same_hits(ours.first_hit(*rays), expected)
    assert_same_run(ours, theirs)
    with pytest.raises(GraphicsError, match=r"too few render targets.*machine='compute'"):
        ours.multi_hit(*rays)


def test_a_stencil_test_that_comes_late_does_no_harm(opened, scene, rays, monkeypatch):
    """Kernels then run on all rays; the state in the stream guards their writes to buffers."""
    expected = multipass(scene, "cpu", counters=True)
    hits = expected.multi_hit(**rays)
    make = plan._PlanBuilder.kernel

    def without_test(self, *arguments):
        with monkeypatch.context() as patch:
            patch.setattr(plan, "Stencil", lambda state: Stencil())
            return make(self, *arguments)

    monkeypatch.setattr(plan._PlanBuilder, "kernel", without_test)
    tracer = multipass(scene, counters=True)
    assert_same_hits(tracer.multi_hit(**rays), hits)
    assert_same_run(tracer, expected)


@pytest.mark.exhaustive
def test_rays_that_do_not_fit_are_traced_in_parts(opened, scene, rays):
    whole, parts = multipass(scene), multipass(scene, rays_at_once=77)
    assert_same_bits(parts.first_hit(**rays).t, whole.first_hit(**rays).t)
    ours, theirs = parts.multi_hit(**rays), whole.multi_hit(**rays)
    assert_same_bits(ours.ray_splits, theirs.ray_splits)
    assert_same_bits(ours.prim_id, theirs.prim_id)
    assert theirs.prim_id.size


@pytest.mark.parametrize("loop", ["device", "queries"])
def test_passes_are_capped(opened, scene, rays, loop):
    with pytest.raises(GraphicsError, match=r"still active after \d+ passes; max_passes is 5"):
        multipass(scene, loop=loop, max_passes=5).first_hit(**rays)
    counted = multipass(scene, counters=True)
    counted.first_hit(**rays)
    just_enough = len(counted.counters.passes)
    assert multipass(scene, loop=loop, max_passes=just_enough).any_hit(**rays).any()


def test_an_endless_search_ends(opened, scene, rays, monkeypatch):
    monkeypatch.setattr("raystream.graphics.structures.grid.budget_for", lambda most: 3)
    tracer = multipass(scene)
    with pytest.raises(GraphicsError, match="took more than 3 steps and tests"):
        tracer.first_hit(**rays)


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"loop": "host"}, ValueError, "loop: expected one of 'device', 'queries', got 'host'"),
        ({"scheduler": "optimal"}, ValueError, "'optimal' is a bound"),
        ({"scheduler": Threshold()}, TypeError, "needs loop='queries'"),
        ({"traversal_steps": 0}, ValueError, "traversal_steps: expected at least 1"),
        ({"max_passes": 0}, ValueError, "max_passes: expected at least 1"),
        ({"threshold": 1.5}, ValueError, "threshold: expected 0 to 1"),
    ],
)
def test_options_are_checked(opened, scene, options, error, message):
    with pytest.raises(error, match=message):
        multipass(scene, **options)


@pytest.mark.parametrize("count", [1, 16, 17, 256, 257, 1000])
def test_streams_keep_their_records(opened, count):
    shape = StreamShape.for_count(count, opened)
    assert shape.width * (shape.height - 1) < count <= shape.width * shape.height
    for dtype in (np.float32, np.uint32):
        stream = StreamTexture(opened, "numbers", shape, dtype)
        records = np.arange(3 * count).reshape(count, 3).astype(dtype)
        stream.write_records(records)
        assert_same_bits(stream.read_records(count)[:, :3], records)
        assert not stream.read_records(count)[:, 3].any()


def test_streams_larger_than_a_texture_are_refused(opened, monkeypatch):
    monkeypatch.setitem(opened.limits, "max-texture-dimension-2d", 32)
    assert StreamShape.for_count(32 * 32, opened) == (32, 32)
    with pytest.raises(GraphicsError, match="1,025 records do not fit"):
        StreamShape.for_count(32 * 32 + 1, opened)


def test_a_state_is_changed_by_turning_bits_over():
    """The stencil's reference is what the test compares with, so it cannot be the new value."""
    for state in range(9):
        for next_state in range(9):
            if state != next_state:
                stencil = Stencil(state, next_state)
                description = stencil.description()
                assert stencil.reference == state
                assert description["stencil_front"]["pass_op"] == "invert"
                assert state ^ description["stencil_write_mask"] == next_state

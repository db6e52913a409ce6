"""One fragment program with loops: the answers of the compute machine."""

from __future__ import annotations

import numpy as np
import pytest

import raystream as rs
from conftest import assert_same_bits
from meshes import soup
from raystream.graphics import backend
from raystream.kernels.tally import COLUMNS
from test_agreement import answers_of, assert_expected

#: Structures that shaders know, and their options.
STRUCTURES = {
    "brute": {"structure": "brute"},
    "grid": {"structure": "grid"},
    "grid, two levels": {"structure": "grid", "resolution": (2, 3, 2), "levels": 2},
}


@pytest.fixture
def scene():
    return rs.Scene.from_arrays(*soup(60, 1))


@pytest.fixture
def rays(rng):
    origins = rng.normal(size=(300, 3)) * 2
    return {"origins": origins, "directions": rng.random((300, 3)) - origins}


@pytest.mark.parametrize("name", STRUCTURES)
def test_fragments_answer_as_compute_shaders_do(opened, scene, rays, monkeypatch, name):
    """They run the same search on the same numbers."""
    options = STRUCTURES[name]
    expected = answers_of(rs.Tracer(scene, device="graphics", **options), rays, is_brief=True)
    assert (expected["first_hit: prim_id"] >= 0).sum() > 50
    tracer = rs.Tracer(scene, device="graphics", machine="branching", **options)
    assert_expected(answers_of(tracer, rays, is_brief=True), expected)
    # In parts, whose textures have other sizes; and rows of hits, too.
    monkeypatch.setattr(backend, "_ROWS_AT_ONCE", 20)
    tracer = rs.Tracer(scene, device="graphics", machine="branching", rays_at_once=77, **options)
    assert_expected(answers_of(tracer, rays, is_brief=True), expected)


def test_what_fragments_count_is_what_compute_shaders_count(opened, scene, rays):
    ours, theirs = (
        rs.Tracer(scene, "grid", "graphics", machine=machine, counters=True)
        for machine in ("branching", "compute")
    )
    for tracer in (ours, theirs):
        tracer.first_hit(**rays)
    for column in COLUMNS:
        assert_same_bits(getattr(ours.counters, column), getattr(theirs.counters, column))
    assert ours.counters.tests.any()


def test_texels_that_are_no_ray_s_are_left_alone(opened, scene, rays):
    """The last row of the textures is not full; its rays keep and sort hits in a buffer."""
    many = {name: np.concatenate([array] * 3)[:890] for name, array in rays.items()}
    ours, theirs = (
        rs.Tracer(scene, "grid", "graphics", machine=machine).multi_hit(**many)
        for machine in ("branching", "compute")
    )
    assert_same_bits(ours.ray_splits, theirs.ray_splits)
    assert_same_bits(ours.prim_id, theirs.prim_id)
    assert np.diff(ours.ray_splits)[-16:].any()


@pytest.mark.parametrize("traversal", ["stack", "restart"])
def test_every_texel_is_computed_once(opened, traversal):
    """Where two triangles meet on the screen, a driver may run loops of texels it does not draw."""
    scene = rs.load("cornell")
    rays = scene.camera_for(1.0).rays(96, 96)
    options = {"structure": "kdtree", "traversal": traversal}
    ours = rs.Tracer(scene, **options, device="graphics", machine="branching").first_hit(*rays)
    assert_same_bits(ours.prim_id, rs.Tracer(scene, **options).first_hit(*rays).prim_id)

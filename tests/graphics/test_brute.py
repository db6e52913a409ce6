"""Brute force with a triangle in the constants of each draw."""

from __future__ import annotations

import numpy as np
import pytest

import raystream as rs
from exact_scene import exact_rays
from meshes import soup
from raystream.graphics.multipass import backend
from raystream.graphics.multipass.kernels.brute_constants import TriangleConstants

pytestmark = pytest.mark.usefixtures("opened")

BRUTE = {"structure": "brute", "machine": "multipass"}


@pytest.fixture
def loads(monkeypatch):
    """Number of triangles that a machine has loaded."""
    rows = []

    class Counted(TriangleConstants):
        def load(self, rays, kernel):
            super().load(rays, kernel)
            rows.append(self._row)

    monkeypatch.setattr(backend, "TriangleConstants", Counted)
    return rows


@pytest.mark.exhaustive
def test_triangles_in_constants_give_the_same_passes(loads):
    scene = rs.Scene.from_arrays(*soup(40, 3))
    rays = exact_rays()[0] / 64, exact_rays()[1]
    expected = rs.Tracer(scene, **BRUTE, counters=True)
    tracer = rs.Tracer(scene, device="graphics", loop="queries", **BRUTE, counters=True)
    for query in ("first_hit", "any_hit", "multi_hit"):
        ours, theirs = getattr(tracer, query)(*rays), getattr(expected, query)(*rays)
        if query == "any_hit":
            np.testing.assert_array_equal(ours, theirs)
        else:
            np.testing.assert_array_equal(ours.prim_id, theirs.prim_id)
            np.testing.assert_allclose(ours.t, theirs.t, rtol=1e-5)
        passes = [
            [(one.kernel, one.run_count) for one in each.counters.passes]
            for each in (tracer, expected)
        ]
        assert passes[0] == passes[1]
    assert max(loads) == 40


def test_other_loops_gather_triangles(loads):
    scene = rs.Scene.from_arrays(*soup(5, 3))
    for options in ({"loop": "device"}, {"loop": "queries", "intersections": 2}):
        rs.Tracer(scene, device="graphics", **BRUTE, **options).first_hit(*exact_rays())
    assert loads == []


def test_no_triangles_need_no_draws(loads):
    tracer = rs.Tracer(rs.Scene(), device="graphics", loop="queries", **BRUTE)
    assert not tracer.first_hit(*exact_rays()).is_hit.any()
    assert max(loads, default=0) == 0

"""The graph of sectors on graphics devices, on a scene of exact arithmetic."""

from __future__ import annotations

import numpy as np
import pytest

import raystream as rs
from exact_scene import exact_rays, lattice_scene
from raystream.graphics.structures import shader_structure_of

pytestmark = pytest.mark.usefixtures("opened")

COUNTS = ("steps", "leaves", "tests", "link_nodes")

#: Makes sectors small.
SMALL = {"crossing_cost": 0.5, "link_cost": 0.1, "max_leaf_size": 1}


@pytest.mark.exhaustive
def test_rays_meet_what_they_meet_on_the_cpu():
    """Exactly: the same sectors, tests and link nodes, in every kind of query."""
    scene, rays = lattice_scene(), exact_rays()
    expected = rs.Tracer(scene, "graph", counters=True, **SMALL)
    tracer = rs.Tracer(scene, "graph", "graphics", counters=True, **SMALL)
    for query in ("first_hit", "any_hit", "count_hits"):
        ours, theirs = getattr(tracer, query)(*rays), getattr(expected, query)(*rays)
        for name in COUNTS:
            met = getattr(expected.counters, name)
            np.testing.assert_array_equal(getattr(tracer.counters, name), met, f"{query}: {name}")
        if query == "first_hit":
            assert theirs.is_hit.sum() > 50
            np.testing.assert_array_equal(ours.prim_id, theirs.prim_id)
            np.testing.assert_array_equal(ours.t, theirs.t)
        else:
            np.testing.assert_array_equal(ours, theirs)
    assert tracer.counters.link_nodes.sum() > 1000


def test_rays_begin_anywhere():
    """From any sector nearby, rays walk to their own, backward or forward."""
    scene, (origins, directions) = lattice_scene(), exact_rays()
    brute = rs.Tracer(scene, "brute", "graphics")
    tracer = rs.Tracer(scene, "graph", "graphics", **SMALL)
    for t_min in (-40.0, 0.0, 7.0, 40.0):
        expected = brute.first_hit(origins, directions, t_min=t_min)
        hits = tracer.first_hit(origins, directions, t_min=t_min)
        np.testing.assert_array_equal(hits.prim_id, expected.prim_id)


def test_graphs_of_one_sector_and_of_none():
    rays = exact_rays()
    brute = rs.Tracer(lattice_scene(), "brute", "graphics").first_hit(*rays)
    one = rs.Tracer(lattice_scene(), "graph", "graphics", max_depth=0)
    np.testing.assert_array_equal(one.first_hit(*rays).prim_id, brute.prim_id)
    assert not rs.Tracer(rs.Scene(), "graph", "graphics").first_hit(*rays).is_hit.any()


def test_budgets_know_how_deep_links_are():
    graph = rs.Tracer(lattice_scene(), "graph", **SMALL).structure
    quality = graph.quality()
    most = 3 * int(quality["sectors"]) * (1 + int(quality["link depth"])) + len(graph.blocks)
    assert quality["link depth"] > 2
    assert shader_structure_of(graph).budget == 1024 + most

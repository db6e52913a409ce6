"""The kd-tree on graphics devices: each traversal and layout, on a scene of exact arithmetic."""

from __future__ import annotations

import numpy as np
import pytest

import raystream as rs
from exact_scene import exact_rays, lattice_scene
from raystream.graphics.errors import GraphicsError
from raystream.graphics.structures import shader_structure_of

pytestmark = pytest.mark.usefixtures("opened")

TRAVERSALS = (
    *("stack", "restart", "backtrack"),
    pytest.param("short-stack", marks=pytest.mark.exhaustive),
)
LAYOUTS = ("compact", "foley")

COUNTS = ("steps", "leaves", "tests", "restarts", "backtracks", "backtrack_steps")

#: Makes trees deep: splits are cheap.
DEEP = {"intersection_cost": 12.0}


def tracer_of(scene: rs.Scene, traversal: str, layout: str, **options) -> rs.Tracer:
    return rs.Tracer(scene, "kdtree", "graphics", traversal=traversal, layout=layout, **options)


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("traversal", TRAVERSALS)
def test_rays_meet_what_they_meet_on_the_cpu(traversal, layout):
    """Exactly: the same splits, leaves and tests, in every kind of query."""
    scene, rays = lattice_scene(), exact_rays()
    options = {"traversal": traversal, "layout": layout, "counters": True, **DEEP}
    expected = rs.Tracer(scene, "kdtree", **options)
    tracer = rs.Tracer(scene, "kdtree", "graphics", **options)
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
    counters = tracer.counters
    assert counters.steps.sum() > 1000
    assert (counters.restarts.sum() > 20) == (traversal in ("restart", "short-stack"))
    assert (counters.backtrack_steps.sum() > 100) == (traversal == "backtrack")


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("traversal", TRAVERSALS)
def test_trees_without_splits(traversal, layout):
    """A root that is a leaf; and no root."""
    scene, rays = lattice_scene(), exact_rays()
    brute = rs.Tracer(scene, "brute", "graphics").first_hit(*rays)
    one = tracer_of(scene, traversal, layout, max_depth=0)
    np.testing.assert_array_equal(one.first_hit(*rays).prim_id, brute.prim_id)
    none = tracer_of(rs.Scene(), traversal, layout)
    assert not none.first_hit(*rays).is_hit.any()


@pytest.mark.parametrize("traversal", TRAVERSALS)
def test_intervals_are_closed(traversal):
    """A search ends just after t_max: above 0, at 0, below 0, and at the largest number."""
    square = rs.Scene.from_arrays(
        [[0, 0, 0], [4, 0, 0], [0, 4, 0], [0, 0, 4], [4, 0, 4], [0, 4, 4]], [[0, 1, 2], [3, 4, 5]]
    )
    tracer = tracer_of(square, traversal, "compact", **DEEP)
    heights = np.float32([4, 0, -4, 1e-3])
    origins = np.column_stack([np.ones(4), np.ones(4), heights])
    directions = np.tile([0, 0, -1], (4, 1))
    lowest = np.full(4, -100, np.float32)
    for t_max, expected in (
        (heights, 2),
        (np.nextafter(heights, np.float32(np.inf)), 2),
        (np.nextafter(heights, np.float32(-np.inf)), 1),
        (np.full(4, np.inf), 2),
    ):
        rays = {"t_min": lowest, "t_max": t_max}
        counts = tracer.count_hits(origins, directions, **rays)
        np.testing.assert_array_equal(counts, expected)


def test_stacks_are_as_deep_as_trees():
    scene = lattice_scene()
    for options in ({}, DEEP, {"max_depth": 0}, {"max_depth": 3}):
        tree = rs.Tracer(scene, "kdtree", **options).structure
        depth = tree.quality()["depth"]
        size = shader_structure_of(tree).sizes["STACK_SIZE"]
        assert max(depth, 1) <= size < depth + 9


@pytest.mark.parametrize(
    ("traversal", "layout", "options"),
    [
        ("restart", "compact", {"scheduler": "threshold"}),
        pytest.param(
            *("backtrack", "foley", {"scheduler": "most-work", "traversal_steps": 3}),
            marks=pytest.mark.exhaustive,
        ),
        pytest.param(
            *("backtrack", "compact", {"scheduler": "double", "intersections": 2}),
            marks=pytest.mark.exhaustive,
        ),
    ],
)
def test_foley_s_kernels_run_as_on_the_cpu(traversal, layout, options):
    """Pass by pass: the same kernel, on as many rays."""
    scene, rays = lattice_scene(), exact_rays()
    options = {
        "machine": "multipass",
        "traversal": traversal,
        "layout": layout,
        "counters": True,
        **DEEP,
        **options,
    }
    expected = rs.Tracer(scene, "kdtree", **options)
    tracer = rs.Tracer(scene, "kdtree", "graphics", **options)
    theirs, ours = expected.first_hit(*rays), tracer.first_hit(*rays)
    np.testing.assert_array_equal(ours.prim_id, theirs.prim_id)
    np.testing.assert_array_equal(ours.t, theirs.t)
    met, wanted = tracer.counters, expected.counters
    for name in COUNTS:
        np.testing.assert_array_equal(getattr(met, name), getattr(wanted, name), name)
    assert passes_of(met) == passes_of(wanted)
    used = {"initialize", "down", "leaf", "intersect", "continue", "shade"}
    used |= {"up"} if traversal == "backtrack" else set()
    assert {kernel for kernel, _ in passes_of(met)} == used


def passes_of(counters) -> list[tuple[str, int]]:
    return [(one.kernel, one.run_count) for one in counters.passes]


def test_stacks_are_not_for_passes():
    with pytest.raises(GraphicsError, match="traversal='restart'"):
        rs.Tracer(lattice_scene(), "kdtree", "graphics", machine="multipass")

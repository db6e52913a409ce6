"""The multipass machine: the same hits and steps as the branching one, and passes that add up."""

from __future__ import annotations

import inspect

import numpy as np
import pytest

import raystream as rs
from cases import CASES
from conftest import TRACERS, assert_same_bits, tier
from raystream.kernels.tally import COLUMNS
from raystream.machines import MultipassBackend, Queues, own_options
from raystream.machines.schedulers import SCHEDULERS
from raystream.streams import Pass
from raystream.structures import names_with

#: One of each structure and traversal, to be run on both machines.
STRUCTURES_AND_OPTIONS = {
    name: options
    for name, options in TRACERS.items()
    if options["structure"] in names_with("multipass")
    and "machine" not in options
    and "kernel" not in options
    and options.get("quality") != "fast"
}

#: Schedulers, steps and intersections in a pass, and compaction.
WAYS = [
    ("naive", 1, 1, False),
    ("threshold", 1, 1, True),
    ("most-work", 2, 3, False),
    ("double", 4, 2, True),
]

#: A default run has the grid in one way; CI has each in one, and the grid in all.
PAIRS = [
    pytest.param(
        name,
        way,
        marks=tier(
            is_everyday=name == "grid" and way == WAYS[i % len(WAYS)],
            is_ci=name == "grid" or way == WAYS[i % len(WAYS)],
        ),
        id=f"{name}-{way[0]}",
    )
    for i, name in enumerate(STRUCTURES_AND_OPTIONS)
    for way in WAYS
]

QUERIES = {
    "first hits": lambda tracer, rays: tracer.first_hit(**rays),
    "any hits": lambda tracer, rays: tracer.any_hit(**rays),
    "counts": lambda tracer, rays: tracer.count_hits(**rays),
    "all hits": lambda tracer, rays: tracer.multi_hit(**rays, crossings="surfaces"),
    "three hits": lambda tracer, rays: tracer.multi_hit(**rays, max_hits=3),
}


def rays_of(name):
    case = CASES[name](np.random.default_rng(7))
    rays = {"origins": case.origins, "directions": case.directions}
    return case.scene, {**rays, "t_min": case.t_min, "t_max": case.t_max}


def multipass(scene, options, way=("threshold", 1, 1, False), **more):
    scheduler, steps, tests, compaction = way
    return rs.Tracer(
        scene,
        **options,
        machine="multipass",
        scheduler=scheduler,
        traversal_steps=steps,
        intersections=tests,
        compaction=compaction,
        **more,
    )


def assert_same_results(a, b):
    if isinstance(a, np.ndarray):
        assert_same_bits(a, b)
        return
    for column in ("t", "u", "v", "prim_id", "status"):
        assert_same_bits(getattr(a, column), getattr(b, column))


def test_all_steps_are_tested():
    tested = {options["structure"] for options in STRUCTURES_AND_OPTIONS.values()}
    assert {*names_with("multipass")} == tested


@pytest.mark.parametrize(("name", "way"), PAIRS)
def test_both_machines_meet_the_same(name, way):
    """Hits and tallies of every ray in all queries."""
    options = STRUCTURES_AND_OPTIONS[name]
    scene, rays = rays_of("closed_mesh")
    branching = rs.Tracer(scene, **options, counters=True)
    stepping = multipass(scene, options, way, counters=True)
    for query in QUERIES.values():
        assert_same_results(query(branching, rays), query(stepping, rays))
        for column in COLUMNS:
            assert_same_bits(
                getattr(branching.counters, column), getattr(stepping.counters, column)
            )
        passes = stepping.counters.passes
        assert branching.counters.passes is None
        assert len(passes) >= passes.optimal_count > 0


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=tier(is_everyday=name in ("grid", "kdtree, stack")))
        for name in STRUCTURES_AND_OPTIONS
    ],
)
def test_passes_add_up(name):
    """Each kernel's runs over all passes equal the rays' tallies."""
    scene, rays = rays_of("random_soup")
    tracer = multipass(scene, STRUCTURES_AND_OPTIONS[name], counters=True)
    tracer.first_hit(**rays)
    found, total = tracer.counters, tracer.counters.total
    ray_count = found.steps.size

    def runs(*kernels):
        return sum(found.passes.counters.of(kernel).run_count for kernel in kernels)

    first = next(iter(found.passes))
    assert first.kernel in ("set up", "initialize")
    assert first.run_count == ray_count
    assert runs("shade") == total["shadings"]
    structure = tracer.structure.name
    if structure in ("grid", "brute"):
        assert runs("traverse") == total["steps"]
        assert runs("intersect") == total["tests"]
    if structure == "bvh":
        assert 0 <= runs("traverse") - total["steps"] - total["leaves"] <= ray_count
    if structure == "kdtree":
        assert runs("down") == total["steps"]
        assert runs("up") == total["backtrack_steps"]
        assert runs("leaf") == total["leaves"] == runs("continue")
    if structure in ("bvh", "kdtree"):
        assert runs("intersect") <= total["tests"] <= 4 * runs("intersect")
    for one in found.passes:
        assert isinstance(one, Pass)
        assert 0 < one.run_count == one.written_count <= one.record_count == ray_count
    shares = [one.run_count / ray_count for one in found.passes]
    assert found.passes.efficiency == pytest.approx(np.mean(shares))
    assert found.passes.counters.words_read["state"] == ray_count * len(found.passes)


def test_the_bound_is_the_longest_ray_of_each_kernel():
    scene, rays = rays_of("closed_mesh")
    tracer = multipass(scene, {"structure": "grid"}, counters=True)
    tracer.first_hit(**rays)
    found = tracer.counters
    longest = found.steps.max() + found.tests.max() + 2  # set up, and shade
    assert found.passes.optimal_count == longest
    assert found.passes.most_runs["traverse"] == found.steps.max()
    unrolled = multipass(scene, {"structure": "grid"}, ("threshold", 3, 2, False), counters=True)
    unrolled.first_hit(**rays)
    longest = -(-int(found.steps.max()) // 3) + -(-int(found.tests.max()) // 2) + 2
    assert unrolled.counters.passes.optimal_count == longest
    assert len(unrolled.counters.passes) < len(found.passes)


def test_the_threshold_is_between_the_bound_and_the_naive_schedule():
    """Purcell 2002, section 3.2: within a factor of two of optimal, far from naive."""
    scene = rs.load("spheres")
    rays = scene.camera_for(1.0).rays(64, 64)
    counts = {}
    for scheduler in SCHEDULERS:
        tracer = rs.Tracer(
            scene, "grid", machine="multipass", scheduler=scheduler, counters=True, resolution=12
        )
        tracer.first_hit(*rays)
        counts[scheduler] = len(tracer.counters.passes)
        optimal = tracer.counters.passes.optimal_count
    assert optimal <= counts["threshold"] < counts["naive"]
    assert max(counts.values()) == counts["naive"]


def test_compaction_drops_rays_that_have_ended():
    scene, rays = rays_of("random_soup")
    options = {"structure": "grid"}
    tracer = multipass(scene, options, ("threshold", 1, 1, True), counters=True)
    tracer.first_hit(**rays)
    sizes = [one.record_count for one in tracer.counters.passes]
    assert sizes == sorted(sizes, reverse=True)
    assert sizes[-1] < 0.1 * sizes[0]
    masked = multipass(scene, options, counters=True)
    masked.first_hit(**rays)
    others = [one.kernel for one in masked.counters.passes if one.kernel != "shade"]
    assert [one.kernel for one in tracer.counters.passes if one.kernel != "shade"] == others
    assert 1 < tracer.counters.passes.of("shade") < 12
    assert tracer.counters.passes.efficiency > masked.counters.passes.efficiency


def test_rays_are_traced_in_parts_where_memory_is_short(monkeypatch):
    scene, rays = rays_of("random_soup")
    whole = multipass(scene, {"structure": "kdtree"}, counters=True)
    expected = whole.first_hit(**rays)
    monkeypatch.setattr("raystream.machines.multipass.MAX_BYTES", 100_000)
    tracer = multipass(scene, {"structure": "kdtree"}, counters=True)
    done = []
    found = tracer.first_hit(**rays, progress=lambda k, of: done.append((k, of)))
    assert_same_results(found, expected)
    parts = [one for one in tracer.counters.passes if one.kernel == "initialize"]
    assert len(parts) > 1
    assert sum(one.run_count for one in parts) == found.t.size
    for column in COLUMNS:
        assert_same_bits(getattr(tracer.counters, column), getattr(whole.counters, column))
    assert done == sorted(done)
    assert done[-1] == (found.t.size, found.t.size)


def test_a_scheduler_of_ones_own():
    """It is called before each pass, and must choose a kernel that rays wait for."""
    scene, rays = rays_of("closed_mesh")
    asked = []

    class Last:
        def choose(self, queues: Queues) -> int:
            asked.append(queues)
            return max(k for k, count in enumerate(queues.waiting) if count)

    tracer = rs.Tracer(scene, "grid", machine="multipass", scheduler=Last(), counters=True)
    expected = rs.Tracer(scene, "brute").first_hit(**rays)
    assert_same_results(tracer.first_hit(**rays), expected)
    assert len(asked) == len(tracer.counters.passes)
    assert asked[0].latest is None
    assert [queues.latest for queues in asked[1:]] == [
        max(k for k, count in enumerate(queues.waiting) if count) for queues in asked[:-1]
    ]

    class Wrong:
        def choose(self, queues: Queues) -> int:
            assert any(queues.waiting)
            return self.choice

    for choice, chosen in ((1, "'traverse'"), (99, "99"), (-1, "-1")):
        wrong = Wrong()
        wrong.choice = choice
        with pytest.raises(ValueError, match=f"scheduler: .* chose {chosen}, for which no ray"):
            rs.Tracer(scene, "grid", machine="multipass", scheduler=wrong).first_hit(**rays)


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"machine": "quantum"}, ValueError, "machine: expected one of 'branching', 'multipass'"),
        ({"scheduler": "naive"}, TypeError, "'scheduler'; it is an option of machine='multipass'"),
        ({"machine": "multipass", "scheduler": "lazy"}, ValueError, "expected one of 'threshold'"),
        ({"machine": "multipass", "scheduler": "optimal"}, ValueError, "optimal_count"),
        ({"machine": "multipass", "scheduler": 3}, TypeError, "a name or a Scheduler"),
        ({"machine": "multipass", "threshold": 1.5}, ValueError, "threshold: expected 0 to 1"),
        ({"machine": "multipass", "threshold": np.nan}, ValueError, "threshold: expected 0 to 1"),
        ({"machine": "multipass", "traversal_steps": 0}, ValueError, "traversal_steps: .* least 1"),
        ({"machine": "multipass", "intersections": -1}, ValueError, "intersections: .* least 1"),
        ({"machine": "multipass", "intersections": 1.5}, TypeError, "integer"),
        ({"machine": "multipass", "resolution": 5}, TypeError, "bvh: has no option 'resolution'"),
    ],
)
def test_options_are_checked(options, error, message):
    with pytest.raises(error, match=message):
        rs.Tracer(rs.Scene(), **options)


def test_each_option_of_the_machine_is_told_from_the_structures():
    names = list(inspect.signature(MultipassBackend).parameters)[1:]
    assert list(own_options("multipass", dict.fromkeys([*names, "resolution"]))) == names


def test_counters_need_to_be_asked_for():
    scene, rays = rays_of("one_triangle")
    with pytest.raises(ValueError, match="counters=True"):
        _ = rs.Tracer(scene).counters
    tracer = rs.Tracer(scene, counters=True)
    with pytest.raises(ValueError, match="before the first query"):
        _ = tracer.counters
    tracer.any_hit(**rays)
    assert tracer.counters.tests.shape == tracer.any_hit(**rays).shape


def test_an_updated_tracer_keeps_its_machine():
    scene = rs.load("cornell")
    tracer = rs.Tracer(scene, "grid", machine="multipass", counters=True)
    vertices = [mesh.vertices for mesh in scene.meshes]
    tracer.update(vertices if len(vertices) > 1 else vertices[0])
    rays = scene.camera_for(1.0).rays(8, 8)
    assert_same_results(tracer.first_hit(*rays), rs.Tracer(scene, "brute").first_hit(*rays))
    assert len(tracer.counters.passes) > 0


def test_a_loaded_tracer_has_the_machine_that_is_asked_for(tmp_path):
    scene, rays = rays_of("closed_mesh")
    rs.Tracer(scene, "kdtree").save(tmp_path / "tree.npz")
    tracer = rs.Tracer.load(
        tmp_path / "tree.npz", machine="multipass", scheduler="naive", counters=True
    )
    assert_same_results(tracer.first_hit(**rays), rs.Tracer(scene, "brute").first_hit(**rays))
    assert tracer.counters.passes.of("down") > 0
    with pytest.raises(TypeError, match="has no option 'leaves'"):
        rs.Tracer.load(tmp_path / "tree.npz", machine="multipass", leaves=3)


def test_counters_as_text_and_sums():
    scene, rays = rays_of("closed_mesh")
    tracer = multipass(scene, {"structure": "kdtree", "traversal": "backtrack"}, counters=True)
    tracer.first_hit(**rays)
    found = tracer.counters
    assert found.total["tests"] == int(found.tests.sum())
    assert np.array_equal(found.cells, found.leaves)
    assert "backtrack_steps" in str(found)
    assert f"{len(found.passes):,} passes" in str(found)
    grid = rs.Tracer(scene, "grid", counters=True)
    grid.first_hit(**rays)
    assert np.array_equal(grid.counters.cells, grid.counters.steps)

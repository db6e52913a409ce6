"""Ray counters are correct, and counting does not change hits."""

from __future__ import annotations

import numpy as np
import pytest

import raystream as rs
from cases import CASES
from conftest import assert_same_bits
from meshes import soup
from raystream.core.query import Kind, Query
from raystream.core.rays import RayBatch
from raystream.kernels.hits import Sink
from raystream.kernels.tally import COLUMNS
from raystream.machines import Branching

#: The queries for batches, and their further arguments.
QUERIES = {
    "first_hit": Query(Kind.FIRST_HIT),
    "any_hit": Query(Kind.ANY_HIT),
    "count_hits": Query(Kind.COUNT_HITS),
    "count_hits, at most 2": Query(Kind.COUNT_HITS, limit=2),
    "multi_hit": Query(Kind.MULTI_HIT),
    "multi_hit, surfaces": Query(Kind.MULTI_HIT, surfaces=True),
    "multi_hit, at most 2": Query(Kind.MULTI_HIT, limit=2),
}

COUNTS = ("steps", "leaves", "tests")


def build(vertices, faces, name, **options):
    return rs.Tracer(rs.Scene.from_arrays(vertices, faces), name, **options).structure


def ask(structure, query, batch, counters=False):
    """All arrays of a result, the status of each ray, and the counters."""
    sink = Branching(structure).answer(QUERIES[query]._replace(counters=counters), batch)
    names = ("splits", "seen", "counts", "status")
    arrays = [getattr(sink, name) for name in names if hasattr(sink, name)]
    return [*arrays, *getattr(sink, "hits", ())], sink.tallies


def tallied(structure, query, batch):
    """The tallies of a query, by column."""
    _, tallies = ask(structure, query, batch, counters=True)
    assert not tallies[:, len(COLUMNS) :].any()
    return dict(zip(COLUMNS, tallies.T, strict=False))


def batch_of(case):
    return RayBatch(case.origins, case.directions, case.t_min, case.t_max)


def rays(origins, directions, t_min=0.0, t_max=np.inf):
    return RayBatch(np.asarray(origins, float), np.asarray(directions, float), t_min, t_max)


def rays_into(structure, rng, count=300):
    """Rays from around a scene to points in its box."""
    low, high = structure.triangles.bounds.astype(float)
    origins = (low + high) / 2 + rng.normal(size=(count, 3)) * (high - low).max()
    return rays(origins, low + rng.random((count, 3)) * (high - low) - origins)


def stack_of_triangles(count, z=None):
    """Large triangles across the z axis, at z = 0, 1, 2 and so on."""
    corners = np.empty((count, 3, 3))
    corners[:, :, :2] = [[-1, -1], [3, -1], [-1, 3]]
    corners[:, :, 2] = (np.arange(count) if z is None else np.asarray(z))[:, None]
    return corners.reshape(-1, 3), np.arange(3 * count).reshape(-1, 3)


def counts_of(found, *columns):
    """Columns as rows of a list: one for each ray."""
    return np.stack([found[column] for column in columns], axis=1).tolist()


# ---- Every way to trace.


@pytest.mark.parametrize("name", ["random_soup", "limited_intervals"])
def test_answers_are_the_same(make_tracer, name, rng):
    case = CASES[name](rng)
    structure, batch = make_tracer(case.scene).structure, batch_of(case)
    for query in QUERIES:
        found, tallies = ask(structure, query, batch, counters=True)
        expected, _ = ask(structure, query, batch)
        for ours, theirs in zip(found, expected, strict=True):
            assert_same_bits(ours, theirs)
        assert tallies[:, COLUMNS.index("tests")].any()


def test_blocks_and_threads_change_no_tally(make_tracer, rng, monkeypatch):
    case = CASES["random_soup"](rng)
    structure, batch = make_tracer(case.scene).structure, batch_of(case)
    expected = {query: ask(structure, query, batch, counters=True)[1] for query in QUERIES}
    for block, threads in ((399, 3), (150, 1)):
        monkeypatch.setattr("raystream.machines.ray_block.RAYS_PER_BLOCK", block)
        try:
            rs.set_thread_count(threads)
            for query, tallies in expected.items():
                _, again = ask(structure, query, batch, counters=True)
                np.testing.assert_array_equal(again, tallies)
        finally:
            rs.set_thread_count(None)


def test_hits_handed_over(make_tracer, rng):
    case = CASES["random_soup"](rng)
    structure, batch = make_tracer(case.scene).structure, batch_of(case)
    hits = rs.Tracer(case.scene, "brute").multi_hit(case.origins, case.directions).counts
    expected = {
        "first_hit": hits > 0,
        "any_hit": hits > 0,
        "count_hits": np.zeros_like(hits),
        "multi_hit": hits,
        "multi_hit, at most 2": np.minimum(hits, 2),
    }
    for query, shadings in expected.items():
        np.testing.assert_array_equal(tallied(structure, query, batch)["shadings"], shadings)


def test_multi_hit_meets_things_twice(make_tracer, rng):
    """Once to count its hits and once to keep them; rays without hits are done after the first."""
    case = CASES["random_soup"](rng)
    structure, batch = make_tracer(case.scene).structure, batch_of(case)
    once, twice = (tallied(structure, query, batch) for query in ("count_hits", "multi_hit"))
    is_hit = twice["shadings"] > 0
    assert 0 < is_hit.sum() < len(batch)
    for column in COUNTS:
        np.testing.assert_array_equal(twice[column][~is_hit], once[column][~is_hit])
        assert (twice[column] <= 2 * once[column]).all()
    assert (twice["tests"][is_hit] > once["tests"][is_hit]).all()


def test_tallies_add_up(make_tracer, rng):
    case = CASES["random_soup"](rng)
    structure, batch = make_tracer(case.scene).structure, batch_of(case)
    query = QUERIES["first_hit"]._replace(counters=True)
    backend, sink = Branching(structure), Sink.of(query, len(batch))
    backend.run(query, batch, sink)
    once = sink.tallies.copy()
    backend.run(query, batch, sink)
    np.testing.assert_array_equal(sink.tallies, 2 * once)


def test_rays_that_cannot_hit_meet_nothing(make_tracer):
    structure = make_tracer(rs.Scene.from_arrays(*soup(300, 1))).structure
    origins, directions = np.full((3, 3), 0.5), np.ones((3, 3))
    directions[0], directions[1, 1] = 0.0, np.nan
    batch = rays(origins, directions, [0.0, 0.0, 2.0], [1.0, 1.0, 1.0])
    for query in QUERIES:
        _, tallies = ask(structure, query, batch, counters=True)
        assert not tallies.any()


# ---- Counted by hand.


def test_brute_tests_all_until_it_may_stop():
    structure = build(*stack_of_triangles(7), "brute")
    batch = rays([[0, 0, -1], [5, 5, -1], [0, 0, 9], [0, 0, 3.5]], [[0, 0, 1]] * 4)
    expected = {
        "first_hit": [7, 7, 7, 7],
        "any_hit": [1, 7, 7, 5],
        "count_hits": [7, 7, 7, 7],
        "count_hits, at most 2": [2, 7, 7, 6],
        "multi_hit": [14, 7, 7, 14],
        "multi_hit, at most 2": [9, 7, 7, 13],
    }
    for query, tests in expected.items():
        found = tallied(structure, query, batch)
        assert found["tests"].tolist() == tests
        assert not found["steps"].any()
        assert not found["leaves"].any()


def test_a_grid_of_one_cell():
    structure = build(*stack_of_triangles(7), "grid", resolution=1)
    batch = rays([[0, 0, -1], [5, 5, -1], [2.9, 2.9, -1]], [[0, 0, 1]] * 3)
    found = tallied(structure, "first_hit", batch)
    assert counts_of(found, *COUNTS) == [[1, 1, 7], [0, 0, 0], [1, 1, 7]]
    assert tallied(structure, "any_hit", batch)["tests"].tolist() == [1, 0, 7]
    assert tallied(structure, "count_hits, at most 2", batch)["tests"].tolist() == [2, 0, 7]


def row_of_cells(extra=()):
    """Six unit cells along x, with a triangle at y = z = 0 in the first and the last one."""
    first = np.array([[0.0, 0, 0], [0.5, 0, 0], [0, 0.5, 0.5]])
    last = np.array([[6.0, 0, 0], [5.5, 0, 0], [6, 0.5, 0.5]])
    corners = np.concatenate([[first, last + [0, 0.5, 0.5]], np.reshape(extra, (-1, 3, 3))])
    return corners.reshape(-1, 3), np.arange(3 * len(corners)).reshape(-1, 3)


def test_a_row_of_empty_cells():
    structure = build(*row_of_cells(), "grid", resolution=(6, 1, 1))
    origins = [[-1, 0.9, 0.1], [7, 0.9, 0.1], [2.5, 0.9, 0.1], [3.5, 0.5, -1], [-1, 0.9, 0.1]]
    directions = [[1, 0, 0], [-1, 0, 0], [1, 0, 0], [0, 0, 1], [1, 0, 0]]
    batch = rays(origins, directions, 0.0, [np.inf] * 4 + [3.5])
    for query in QUERIES:
        found = tallied(structure, query, batch)
        expected = [[6, 2, 2], [6, 2, 2], [4, 1, 1], [1, 0, 0], [3, 1, 1]]
        assert counts_of(found, *COUNTS) == expected


def test_a_cell_that_is_divided():
    """It counts one step, and one for each of its cells on the way; it is no leaf itself."""
    tiny = np.random.default_rng(1).random((400, 1, 3)) * 0.4 + np.zeros((1, 3, 1)) + 0.05
    tiny = tiny + np.random.default_rng(2).random((400, 3, 3)) * 0.01
    structure = build(*row_of_cells(tiny), "grid", resolution=(6, 1, 1), levels=2)
    assert structure.fine.cells.tolist() == [0]
    batch = rays([[-1, 0.95, 0.1], [7, 0.95, 0.1]], [[1, 0, 0], [-1, 0, 0]])
    steps = 6 + int(structure.fine.counts[0, 0])
    for query in QUERIES:
        found = tallied(structure, query, batch)
        assert counts_of(found, *COUNTS) == [[steps, 1, 1]] * 2


@pytest.mark.parametrize("layout", ["compact", "foley"])
def test_a_kd_tree_of_one_leaf(layout):
    """Blocks of four are tested as a whole, and only triangles count."""
    structure = build(*stack_of_triangles(7), "kdtree", max_depth=0, layout=layout)
    batch = rays([[0, 0, -1], [5, 5, -1], [2.9, 2.9, -1]], [[0, 0, 1]] * 3)
    found = tallied(structure, "first_hit", batch)
    assert counts_of(found, *COUNTS) == [[0, 1, 7], [0, 0, 0], [0, 1, 7]]
    assert tallied(structure, "any_hit", batch)["tests"].tolist() == [4, 0, 7]
    assert tallied(structure, "count_hits, at most 2", batch)["tests"].tolist() == [4, 0, 7]
    assert tallied(structure, "multi_hit", batch)["tests"].tolist() == [14, 0, 7]


def assert_traversals_agree(scene, rng):
    """Foley 2005, section 4.1: the same leaves; and how often each traversal descends."""
    options = {"structure": "kdtree", "intersection_cost": 12.0}
    trees = [
        rs.Tracer(scene, traversal=how, **options).structure
        for how in ("stack", "restart", "backtrack", "short-stack")
    ]
    batch, seen_again = rays_into(trees[0], rng), 0
    for query in QUERIES:
        stack, restart, backtrack, short = (tallied(tree, query, batch) for tree in trees)
        for other in (restart, backtrack, short):
            for column in ("leaves", "tests", "shadings"):
                np.testing.assert_array_equal(other[column], stack[column])
        for column in ("restarts", "backtracks", "backtrack_steps"):
            assert not stack[column].any()
        assert not backtrack["restarts"].any()
        assert not restart["backtracks"].any()
        assert not restart["backtrack_steps"].any()
        jumps = backtrack["backtracks"]
        assert jumps.any()
        np.testing.assert_array_equal(restart["restarts"], jumps)
        np.testing.assert_array_equal(backtrack["steps"], stack["steps"] + jumps)
        assert (backtrack["backtrack_steps"] >= jumps).all()
        assert (restart["steps"] >= stack["steps"] + jumps).all()
        # It begins again where it has forgotten something, and then goes down further.
        assert not short["backtracks"].any()
        assert (short["restarts"] <= jumps).all()
        assert (short["steps"] <= restart["steps"]).all()
        assert ((short["steps"] > stack["steps"]) == (short["restarts"] > 0)).all()
        seen_again += short["restarts"].sum()
        # One search sees a leaf more than it jumps; multi_hit makes two of rays that hit.
        in_the_box = stack["leaves"] > 0
        searches = np.where(query.startswith("multi") & (stack["shadings"] > 0), 2, 1)
        np.testing.assert_array_equal(stack["leaves"], (jumps + searches) * in_the_box)
    return seen_again


def test_kd_traversals_agree_on_a_soup(rng):
    assert assert_traversals_agree(rs.Scene.from_arrays(*soup(300, 1)), rng) > 0


@pytest.mark.parametrize("name", ["cornell", "spheres", "robots"])
def test_kd_traversals_agree_on_built_in_scenes(name, rng):
    assert_traversals_agree(rs.load(name, triangles=1000), rng)


@pytest.mark.parametrize(("count", "first_block"), [(3, 3), (7, 4)])
def test_a_bvh_of_one_leaf(count, first_block):
    """Blocks of four are tested as a whole, and only triangles count."""
    structure = build(*stack_of_triangles(count), "bvh", max_leaf_size=32)
    batch = rays([[0, 0, -1], [5, 5, -1], [2.9, 2.9, -1]], [[0, 0, 1]] * 3)
    found = tallied(structure, "count_hits", batch)
    assert counts_of(found, *COUNTS) == [[1, 1, count], [1, 0, 0], [1, 1, count]]
    tests = [first_block, 0, count]
    assert tallied(structure, "any_hit", batch)["tests"].tolist() == tests
    assert tallied(structure, "count_hits, at most 2", batch)["tests"].tolist() == tests


@pytest.mark.parametrize("kernel", ["auto", "packet", "single"])
def test_a_bvh_that_is_met_as_a_whole(kernel, rng):
    count = 200
    structure = build(*stack_of_triangles(count, rng.permutation(count)), "bvh", kernel=kernel)
    batch = rays([[0, 0, -1], [0, 0, count]] * 3, [[0, 0, 1], [0, 0, -1]] * 3)
    children = structure.tree.children
    leaf_count = np.count_nonzero(children < 0)
    whole = [len(children), leaf_count, count]
    assert counts_of(tallied(structure, "count_hits", batch), *COUNTS) == [whole] * 6
    both = [2 * number for number in whole]
    assert counts_of(tallied(structure, "multi_hit", batch), *COUNTS) == [both] * 6

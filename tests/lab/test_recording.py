"""Recorded walks: the multipass machine's kernels on each ray, in order."""

from __future__ import annotations

import numpy as np
import pytest

from extras import need

need("raystream_lab")

import raystream as rs
from lab.walking import PLACED, scene_and_rays, tracer_of, walks_of
from raystream.kernels.tally import COLUMNS
from raystream.machines.records import RayState
from raystream_lab.walks import Run, record

QUERIES = {"first hits": False, "any hits": True}


def summed(walks, kernel):
    """Steps of a kernel on each ray, from its runs."""
    chosen = walks.run_kernels == walks.names.index(kernel)
    rays = np.repeat(np.arange(len(walks)), np.diff(walks.run_splits))
    return np.bincount(rays[chosen], walks.run_lengths[chosen], len(walks)).reshape(walks.shape)


def assert_counts_agree(walks, counters):
    for column in COLUMNS:
        np.testing.assert_array_equal(getattr(walks.counters, column), getattr(counters, column))
    for k, kernel in enumerate(walks.names):
        np.testing.assert_array_equal(summed(walks, kernel).ravel(), walks.runs[:, k])
    np.testing.assert_array_equal(summed(walks, walks.names[0]), 1)
    np.testing.assert_array_equal(summed(walks, "shade"), counters.shadings)
    if walks.structure.name == "kdtree":
        np.testing.assert_array_equal(summed(walks, "down"), counters.steps)
        np.testing.assert_array_equal(summed(walks, "up"), counters.backtrack_steps)
        np.testing.assert_array_equal(summed(walks, "leaf"), counters.leaves)
    if walks.structure.name == "grid":
        np.testing.assert_array_equal(summed(walks, "traverse"), counters.steps)
    if walks.structure.name in ("grid", "brute"):
        np.testing.assert_array_equal(summed(walks, "intersect"), counters.tests)


@pytest.mark.parametrize("any_hit", QUERIES.values(), ids=QUERIES)
@pytest.mark.parametrize("name", PLACED)
def test_walks_are_what_the_branching_machine_counts(name, any_hit):
    _, rays = scene_and_rays()
    walks, tracer = walks_of(name, any_hit), tracer_of(name)
    if any_hit:
        seen = tracer.any_hit(**rays)
        np.testing.assert_array_equal(summed(walks, "shade"), seen)
        assert (walks.prim_ids == -1).all()
    else:
        hits = tracer.first_hit(**rays)
        np.testing.assert_array_equal(walks.prim_ids, hits.prim_id.ravel())
        assert 0 < np.count_nonzero(walks.prim_ids >= 0) < len(walks)
    assert walks.shape == (20, 24)
    assert_counts_agree(walks, tracer.counters)


@pytest.mark.parametrize("name", ["brute", "graph"])
def test_other_structures_walk_without_places(name):
    scene, rays = scene_and_rays()
    tracer = rs.Tracer(scene, name, counters=True)
    walks = record(tracer.structure, **rays)
    tracer.first_hit(**rays)
    assert_counts_agree(walks, tracer.counters)
    assert walks.visits is None
    with pytest.raises(ValueError, match="visits: not recorded"):
        walks.visits_of(0)
    with pytest.raises(ValueError, match=f"visits: not supported for {name}; expected grid or kd"):
        record(tracer, **rays, visits=True)


@pytest.mark.parametrize("name", PLACED)
def test_runs_are_the_same_with_places_and_without(name):
    with_places, without = walks_of(name), walks_of(name, visits=False)
    for array in ("run_splits", "run_kernels", "run_lengths", "runs", "prim_ids"):
        np.testing.assert_array_equal(getattr(with_places, array), getattr(without, array))
    neighbours = np.diff(np.repeat(np.arange(len(without)), np.diff(without.run_splits))) == 0
    assert (np.diff(without.run_kernels.astype(int))[neighbours] != 0).all()


@pytest.mark.parametrize("name", ["grid", "grid, two levels"])
def test_the_lists_of_the_cells_are_what_is_tested(name):
    """Of first hits all triangles of a cell are tested; of a divided one, none."""
    walks = walks_of(name)
    grid = walks.structure
    sizes = np.diff(grid.lists.splits.astype(np.int64))
    sizes[grid.fine.cells] = 0
    sizes = np.concatenate([sizes, np.diff(grid.fine.lists.splits.astype(np.int64))])
    ends = np.concatenate([[0], np.cumsum(sizes[walks.visits])])[walks.visit_splits]
    np.testing.assert_array_equal(np.diff(ends), walks.counters.tests.ravel())
    np.testing.assert_array_equal(np.diff(walks.visit_splits), walks.counters.steps.ravel())
    assert (len(grid.fine.cells) > 0) == (name == "grid, two levels")
    assert (walks.visits >= grid.lattice.cell_count).any() == (name == "grid, two levels")


def test_neighbouring_cells_follow_each_other():
    walks = walks_of("grid")
    nx, ny, _ = walks.structure.lattice.counts
    cells = walks.visits.astype(int)
    steps = np.diff(np.stack([cells % nx, cells // nx % ny, cells // (nx * ny)]), axis=1)
    is_same_ray = np.diff(np.repeat(np.arange(len(walks)), np.diff(walks.visit_splits))) == 0
    assert (np.abs(steps[:, is_same_ray]).max(axis=0) == 1).all()


@pytest.mark.parametrize("name", [name for name in PLACED if name.startswith("kdtree")])
def test_nodes_begin_at_the_root(name):
    walks = walks_of(name)
    tree = walks.structure.view
    looks = (RayState.TRAVERSING, RayState.AT_LEAF, RayState.BACKTRACKING)
    columns = [k for k, one in enumerate(walks.kernels) if one.state in looks]
    counts = np.diff(walks.visit_splits)
    np.testing.assert_array_equal(counts, walks.runs[:, columns].sum(axis=1))
    assert (walks.visits[walks.visit_splits[:-1][counts > 0]] == tree.root).all()
    if name == "kdtree, restart":
        restarts = int(walks.counters.restarts.sum())
        assert np.count_nonzero(walks.visits == tree.root) == np.count_nonzero(counts) + restarts


def test_a_walk_by_hand():
    """Four cells in a row, and a triangle in the third: two steps past empty ones, and a test."""
    corners = [[0, 0, 0], [0, 1, 0], [0, 0, 1], [4, 0, 0], [4, 1, 0], [4, 0, 1]]
    wall = [[2.5, -1, -1], [2.5, 3, -1], [2.5, -1, 3]]
    scene = rs.Scene.from_arrays([*corners, *wall], [[0, 1, 2], [3, 4, 5], [6, 7, 8]])
    tracer = rs.Tracer(scene, "grid", resolution=(4, 1, 1))
    origins = [[0.5, 0.2, 0.2], [3.5, 0.2, 0.2], [9.0, 9.0, 9.0]]
    directions = [[1, 0, 0], [-1, 0, 0], [1, 0, 0]]
    walks = record(tracer, origins, directions, visits=True)
    begin, end = Run("set up", 1), Run("shade", 1)
    assert list(walks.runs_of(0)) == [begin, Run("traverse", 1), Run("intersect", 1)] + [
        Run("traverse", 2),
        Run("intersect", 1),
        end,
    ]
    assert walks.visits_of(0).tolist() == [0, 1, 2]
    assert walks.visits_of(1).tolist() == [3, 2]
    assert list(walks.runs_of(2)) == [begin]
    assert walks.visits_of(2).size == 0
    assert walks.prim_ids.tolist() == [2, 2, -1]
    hidden = record(tracer, origins, directions, visits=True, t_max=1.0)
    assert hidden.prim_ids.tolist() == [-1, 2, -1]


def test_too_many_steps_are_refused_before_they_are_kept(monkeypatch):
    _, rays = scene_and_rays()
    tracer = tracer_of("grid")
    free = iter([10**9, 100])  # enough for counts
    monkeypatch.setattr("raystream.core.memory.available_memory", lambda: next(free))
    with pytest.raises(MemoryError, match=r"runs and .* visits of 480 rays .* record fewer rays"):
        record(tracer, **rays, visits=True)
    monkeypatch.setattr("raystream.core.memory.available_memory", lambda: 100)
    with pytest.raises(MemoryError, match=r"counts of 480 rays would .* record fewer rays"):
        record(tracer, **rays)


def test_progress_goes_through_both_searches():
    _, rays = scene_and_rays()
    said = []
    record(tracer_of("grid"), **rays, progress=lambda *done: said.append(done))
    assert said[-1] == (960, 960)
    assert (480, 960) in said


def test_rays_are_recorded_in_blocks_and_on_all_threads(monkeypatch):
    _, rays = scene_and_rays()
    monkeypatch.setattr("raystream.machines.ray_block.RAYS_PER_BLOCK", 150)
    monkeypatch.setattr("raystream_lab.walks.recording._CHUNK", 37)
    in_blocks = record(tracer_of("grid"), **rays, visits=True)
    for name in ("run_splits", "run_kernels", "run_lengths", "runs", "prim_ids", "visits"):
        np.testing.assert_array_equal(getattr(in_blocks, name), getattr(walks_of("grid"), name))
    assert_counts_agree(in_blocks, walks_of("grid").counters)


def test_no_rays():
    walks = record(tracer_of("grid"), np.zeros((0, 3)), np.zeros((0, 3)), visits=True)
    assert len(walks) == len(walks.visits) == len(walks.run_lengths) == 0

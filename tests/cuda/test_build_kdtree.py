"""kd-trees built on the device match the CPU's bit for bit; see also `test_build_graph`."""

from __future__ import annotations

import numpy as np
import pytest

from extras import need

need("numba_cuda")

import raystream as rs
from cases import CASES
from meshes import soup
from raystream.jit.cuda import is_simulated
from test_agreement import answers_of, assert_expected, case_of, rays_of


def built(scene, **options):
    return rs.Tracer(scene, "kdtree", "cuda", build="device", **options)


def assert_same_trees(scene, **options):
    ours = built(scene, **options).structure
    theirs = rs.Tracer(scene, "kdtree", **options).structure
    for own, other in zip(ours.tree, theirs.tree, strict=True):
        assert own.dtype == other.dtype
        assert np.array_equal(own, other)
    return ours, theirs


@pytest.mark.parametrize("name", CASES)
def test_trees_are_the_cpus(device, name):
    assert_same_trees(case_of(name).scene)


@pytest.mark.parametrize(
    "options",
    [
        {"max_depth": 4, "empty_bonus": 0.0},
        {"max_leaf_size": 9, "traversal_cost": 0.5, "intersection_cost": 2.0},
        {"intersection_cost": 12.0, "overlap": "exact"},
        {"intersection_cost": 12.0, "overlap": "box"},
    ],
    ids=str,
)
def test_options_are_the_cpus(device, options):
    ours, theirs = assert_same_trees(case_of("closed_mesh").scene, **options)
    assert ours.options == theirs.options


def test_large_cells_and_subtrees_are_numbered_as_on_the_cpu(device, monkeypatch):
    """Otherwise cells are large from 4096 references, and no test's tree has any."""
    from raystream.cuda.builders.kdtree import numbering
    from raystream.structures.kdtree import build

    scene = rs.Scene.from_arrays(*soup(300))
    usual = rs.Tracer(scene, "kdtree").structure.tree.nodes
    for module in (build, numbering):
        monkeypatch.setattr(module, "subtree_size", lambda _: 70)
    ours, _ = assert_same_trees(scene)
    assert not np.array_equal(ours.tree.nodes, usual)


@pytest.mark.parametrize("name", ["closed_mesh", "one_triangle"])
def test_what_backtracking_needs_is_the_cpus(device, name):
    scene = case_of(name).scene
    ours, theirs = assert_same_trees(scene, traversal="backtrack", max_leaf_size=2)
    *_, extended = ours.resident.arrays
    assert extended.host().tobytes() == theirs.extended.tobytes()
    assert np.array_equal(ours.resident.arrays[1].host(), theirs.blocks, equal_nan=True)


@pytest.mark.parametrize("traversal", ["stack", "restart", "backtrack"])
def test_rays_find_what_brute_force_finds(device, monkeypatch, traversal):
    case = case_of("degenerate_and_duplicate")
    tracer, oracle = built(case.scene, traversal=traversal), rs.Tracer(case.scene, "brute")
    monkeypatch.undo()  # queries are not in loops: they are compiled already
    rays = rays_of(case)
    if is_simulated():
        rays = {name: one[::40] if np.ndim(one) else one for name, one in rays.items()}
    expected = answers_of(oracle, rays)
    assert_expected(answers_of(tracer, rays, is_brief=is_simulated()), expected)


def test_moved_trees_are_rebuilt(device):
    scene = rs.load("cornell")
    tracer = built(scene, traversal="restart")
    moved = [mesh.vertices * 1.5 for mesh in scene.meshes]
    assert tracer.update(moved).rebuilt
    expected = rs.Tracer(scene, "kdtree")
    expected.update(moved)
    assert np.array_equal(tracer.structure.tree.nodes, expected.structure.tree.nodes)
    assert tracer.structure.options.traversal == "restart"


def test_what_was_built_stays_there_until_it_is_asked_for(device, tmp_path):
    from raystream.cuda.structures import place

    scene = rs.load("cornell")
    tracer = built(scene)
    assert place(tracer.structure, device) is tracer.structure.resident
    assert "_on_host" not in tracer.structure.__dict__
    assert tracer.structure.report.byte_count > 0
    tracer.save(tmp_path / "built.npz")
    read = rs.Tracer.load(tmp_path / "built.npz", scene)
    assert tracer.structure.quality() == read.structure.quality()
    assert tracer.structure.with_traversal("backtrack").extended is not None


def test_no_triangles(device):
    empty = rs.Scene.from_arrays(np.zeros((0, 3)), np.zeros((0, 3), int))
    assert len(built(empty).structure.tree.nodes) == 0


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"layout": "foley"}, "layout: expected 'compact' where build='device', got 'foley'"),
        ({"traversal": "up"}, "traversal: expected one of 'stack', 'restart', 'backtrack'"),
        ({"empty_bonus": 2.0}, "empty_bonus: expected 0 to 1, got 2.0"),
    ],
)
def test_options_are_checked(device, options, message):
    with pytest.raises(ValueError, match=message):
        built(rs.load("cornell"), **options)

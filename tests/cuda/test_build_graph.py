"""Sector graphs built on the device match the CPU's bit for bit.

See `test_build` for how this is tested without a device.
"""

from __future__ import annotations

import numpy as np
import pytest

from extras import need

need("numba_cuda")

import raystream as rs
from cases import CASES
from meshes import grid_floor, soup
from raystream.jit.cuda import is_simulated
from raystream.structures.graph.build import tree_settings_of
from raystream.structures.kdtree.build import build_arrays
from test_agreement import answers_of, assert_expected, case_of, rays_of

#: Sectors of few triangles, many link nodes.
FINE = {"max_leaf_size": 1, "crossing_cost": 2.0, "link_cost": 0.5}


def built(scene, **options):
    return rs.Tracer(scene, "graph", "cuda", build="device", **options)


def assert_same_graphs(scene, **options):
    ours = built(scene, **options).structure
    theirs = rs.Tracer(scene, "graph", **options).structure
    for name, own in ours.graph._asdict().items():
        other = getattr(theirs.graph, name)
        assert np.array_equal(own, other), name
        if name != "sector_count":
            assert own.dtype == other.dtype
    assert ours.rows.tobytes() == theirs.rows.tobytes()  # planes at infinity, too
    return ours


@pytest.mark.parametrize("name", CASES)
@pytest.mark.parametrize("options", [{}, FINE], ids=["usual", "fine"])
def test_graphs_are_the_cpus(device, name, options):
    assert_same_graphs(case_of(name).scene, **options)


def scene_of(vertices, faces):
    return rs.Scene.from_arrays(np.asarray(vertices, float), np.asarray(faces))


@pytest.mark.parametrize(
    "mesh",
    [
        (np.eye(3), [[0, 1, 2]]),
        ([[0, 0, 1], [1, 0, 1], [0, 1, 1]], [[0, 1, 2]]),
        (np.eye(3), np.zeros((300, 3), int) + [0, 1, 2]),
        grid_floor(12),
    ],
    ids=["one triangle", "one flat triangle", "all the same", "coplanar"],
)
def test_graphs_of_hard_meshes_are_the_cpus(device, mesh):
    assert_same_graphs(scene_of(*mesh), **FINE)


@pytest.mark.parametrize(
    "options",
    [{"max_depth": 3}, {"max_depth": 0}, {"max_leaf_size": 40}, {"crossing_cost": 1e-3}],
    ids=str,
)
def test_options_are_the_cpus(device, options):
    structure = assert_same_graphs(scene_of(*soup(150)), **{**FINE, **options})
    assert structure.options == rs.Graph(**{**FINE, **options})


def test_large_cells_and_subtrees_are_numbered_as_on_the_cpu(device, monkeypatch):
    """Otherwise cells are large from 4096 references, and no test's tree has any."""
    from raystream.cuda.builders.kdtree import numbering
    from raystream.structures.kdtree import build

    for module in (build, numbering):
        monkeypatch.setattr(module, "subtree_size", lambda _: 70)
    assert_same_graphs(scene_of(*soup(300)), **FINE)


def test_cells_without_room_are_not_split(device, monkeypatch):
    from raystream.cuda.builders.kdtree import grow
    from raystream.structures.kdtree import build

    scene = scene_of(*soup(150))
    usual = rs.Tracer(scene, "graph", **FINE).structure.graph.sector_count
    for module in (build, grow):
        monkeypatch.setattr(module, "MAX_REFERENCES", 2)
        monkeypatch.setattr(module, "LEAST_ROOM", 0)
    few = assert_same_graphs(scene, **FINE)
    assert few.graph.sector_count < usual


def test_splits_are_taken_back_as_long_as_there_is_room(device, monkeypatch):
    """This scene has too little room for all lists that pay off."""
    from raystream.cuda.builders.graph import pruning

    budgets = []
    usual = pruning.weigh.launch

    def launch(gpu, count, arguments):
        budgets.append(arguments[-1])
        usual(gpu, count, arguments)

    monkeypatch.setattr(pruning.weigh, "launch", launch)
    assert_same_graphs(rs.load("spheres"))
    assert any(budget.total > budget.room for budget in budgets)


def test_link_nodes_of_batches_are_in_the_cpus_order(device, monkeypatch):
    from raystream.structures.graph import links

    scene = scene_of(*soup(150))
    whole = rs.Tracer(scene, "graph", **FINE).structure.graph.rows
    monkeypatch.setattr(links, "_BATCH", 50)
    in_batches = assert_same_graphs(scene, **FINE).graph.rows
    assert not np.array_equal(whole, in_batches)


def test_the_same_scene_gives_the_same_graph(device):
    scene = case_of("random_soup").scene
    first, second = (built(scene, **FINE).structure.graph for _ in range(2))
    assert first.rows.tobytes() == second.rows.tobytes()


def test_trees_below_graphs_are_the_cpus(device):
    """Lists that pruning changes are compared before it."""
    from raystream.cuda.builders.kdtree.grow import grow_tree
    from raystream.cuda.builders.kdtree.numbering import number_nodes

    triangles = scene_of(*soup(300)).triangles
    count = len(triangles.prim_ids)
    settings = tree_settings_of(rs.Graph(**FINE), count)
    corners = device.upload("corners", triangles.corners)
    grown = grow_tree(device, triangles, corners, settings)
    numbers = number_nodes(device, grown, count)
    theirs = build_arrays(triangles, settings)
    ids, rows = grown.ids.host(), numbers.rows.host()
    assert sorted(rows) == list(range(len(theirs.nodes)))
    for node, row in zip(grown.nodes.host(), rows, strict=True):
        first, word = theirs.nodes[row]
        assert node[1] & 3 == word & 3
        if word & 3 == 3:
            listed = theirs.prim_ids[first:].ravel()[: word >> 2]
            assert ids[node[0] : node[0] + (node[1] >> 2)].tolist() == listed.tolist()
        else:
            assert node[0] == first


@pytest.mark.exhaustive
def test_graphs_in_the_simulator_itself(gpu, simple_sort):
    """Threads run at once, and share nodes."""
    ours = built(rs.load("cornell"), **FINE).structure.graph
    theirs = rs.Tracer(rs.load("cornell"), "graph", **FINE).structure.graph
    assert np.array_equal(ours.rows, theirs.rows)


def test_rays_find_what_brute_force_finds(device, monkeypatch):
    case = case_of("degenerate_and_duplicate")
    tracer, oracle = built(case.scene), rs.Tracer(case.scene, "brute")
    monkeypatch.undo()  # queries are not in loops: they are compiled already
    rays = rays_of(case)
    if is_simulated():
        rays = {name: one[::20] if np.ndim(one) else one for name, one in rays.items()}
    expected = answers_of(oracle, rays)
    assert_expected(answers_of(tracer, rays, is_brief=is_simulated()), expected)


def test_moved_graphs_are_rebuilt(device):
    scene = rs.load("cornell")
    tracer = built(scene, **FINE)
    moved = [mesh.vertices * 1.5 for mesh in scene.meshes]
    assert tracer.update(moved).rebuilt
    expected = rs.Tracer(scene, "graph", **FINE)
    expected.update(moved)
    ours, theirs = (one.structure.graph for one in (tracer, expected))
    assert np.array_equal(ours.rows, theirs.rows)
    assert np.array_equal(ours.prim_ids, theirs.prim_ids)


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


def test_no_triangles(device):
    empty = rs.Scene.from_arrays(np.zeros((0, 3)), np.zeros((0, 3), int))
    assert built(empty).structure.graph.sector_count == 0


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"crossing_cost": 0.0}, "crossing_cost: expected 1e-6 to 1e6, got 0.0"),
        ({"max_leaf_size": 0}, "max_leaf_size: expected 1 to 1024, got 0"),
    ],
)
def test_options_are_checked(device, options, message):
    with pytest.raises(ValueError, match=message):
        built(rs.load("cornell"), **options)


def test_unknown_options_are_named(device):
    with pytest.raises(TypeError, match="graph: has no option 'quality'"):
        built(rs.load("cornell"), quality="fast")

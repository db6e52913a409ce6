"""Structures built on the device: grids match the CPU bit for bit, BVHs are valid and agree.

In the simulator a thread takes a tenth of a millisecond, and a block of threads that wait for each
other a hundred times that. So most tests there run kernels in loops compiled for the CPU, and
NumPy's sort and sum in place of the device's (`test_primitives` has those).
"""

from __future__ import annotations

import copy
import pickle

import numpy as np
import pytest

from extras import need

need("numba_cuda")

import raystream as rs
from cases import CASES
from raystream.cuda.bvh.binary import unfold
from raystream.jit.cuda import CAPABILITIES, RangeKernel, is_simulated
from raystream.kernels.aligned import aligned_array
from raystream.structures.bvh.layout import BvhArrays, check_arrays
from raystream.structures.bvh.refit import refit
from raystream.structures.bvh.structure import BvhStructure, hittable_corners, trace_cost
from test_agreement import answers_of, assert_expected, case_of, rays_of


def built(scene, structure, **options):
    return rs.Tracer(scene, structure, "cuda", build="device", **options)


def assert_same_lists(ours, theirs):
    assert ours.lattice == theirs.lattice
    for own, other in zip(ours.lists, theirs.lists, strict=True):
        assert own.dtype == other.dtype
        assert np.array_equal(own, other)


def assert_whole(structure):
    """Traversals can take the tree, and each triangle is in it once."""
    triangles, tree = structure.triangles, structure.tree
    check_arrays(tree._asdict(), triangles.prim_ids, triangles.corners)
    assert sorted(tree.prim_ids[tree.prim_ids >= 0]) == triangles.prim_ids.tolist()


# ---- Grids.


@pytest.mark.parametrize("name", CASES)
def test_grids_are_the_cpus(device, name):
    case = case_of(name)
    ours = built(case.scene, "grid")
    assert_same_lists(ours.structure, rs.Tracer(case.scene, "grid").structure)


@pytest.mark.parametrize(
    "options",
    [{"resolution": (1, 40, 3)}, {"min_resolution": 5}, {"min_resolution": 9, "overlap": "exact"}],
    ids=str,
)
def test_grids_of_a_given_resolution_are_the_cpus(device, options):
    scene = case_of("closed_mesh").scene
    ours = built(scene, "grid", **options).structure
    assert_same_lists(ours, rs.Tracer(scene, "grid", **options).structure)
    assert ours.options == rs.Grid(**options)


def test_grids_with_long_lists_get_coarser_as_on_the_cpu(device, monkeypatch):
    scene = case_of("random_soup").scene
    usual = rs.Tracer(scene, "grid").structure
    most = len(usual.lists.references) // 2
    monkeypatch.setattr("raystream.structures.grid.build.reference_limit", lambda _: most)
    coarser = rs.Tracer(scene, "grid").structure
    assert coarser.lattice.cell_count < usual.lattice.cell_count
    assert_same_lists(built(scene, "grid").structure, coarser)


def test_grids_in_the_simulator_itself(gpu):
    """Nothing is mocked: counts, scans, pairs and sorts of a few triangles."""
    scene = rs.load("cornell")
    ours = built(scene, "grid", resolution=2).structure
    assert_same_lists(ours, rs.Tracer(scene, "grid", resolution=2).structure)


def test_moved_grids_are_rebuilt(device):
    scene = rs.load("cornell")
    tracer = built(scene, "grid", resolution=(2, 3, 4))
    moved = [mesh.vertices * 1.5 for mesh in scene.meshes]
    assert tracer.update(moved).rebuilt
    expected = rs.Tracer(scene, "grid", resolution=(2, 3, 4))
    expected.update(moved, max_cost_growth=0.0)
    assert_same_lists(tracer.structure, expected.structure)


# ---- BVHs.


@pytest.mark.parametrize("name", CASES)
def test_trees_are_whole(device, name):
    scene = case_of(name).scene
    structure = built(scene, "bvh").structure
    assert_whole(structure)
    if structure.cost_when_built == structure.cost_when_built:  # nan: a scene without area
        assert structure.cost_when_built == pytest.approx(trace_cost(structure.tree))


def bytes_of(resident):
    return [one.host().tobytes() for one in resident.arrays]


@pytest.mark.parametrize("name", CASES)
def test_binary_nodes_are_those_of_the_copy_on_the_host(device, name):
    structure = built(case_of(name).scene, "bvh").structure
    expected = unfold(*structure.tree)[:2]
    assert bytes_of(structure.laid_out) == [one.tobytes() for one in expected]


def test_binary_nodes_follow_an_update(device):
    case = case_of("closed_mesh")
    tracer = built(case.scene, "bvh")
    before = bytes_of(tracer.structure.laid_out)
    assert not tracer.update(case.vertices * 1.05).rebuilt
    after = bytes_of(tracer.structure.laid_out)
    assert after != before
    assert after == [one.tobytes() for one in unfold(*tracer.structure.tree)[:2]]


@pytest.mark.parametrize("structure", ["bvh", "grid"])
def test_rays_find_what_brute_force_finds(gpu, simple_sort, structure):
    """Nothing is in loops, since these queries are compiled already; a GPU takes all of them."""
    case = case_of("degenerate_and_duplicate")
    tracer, oracle = built(case.scene, structure), rs.Tracer(case.scene, "brute")
    if is_simulated():
        few = case.origins[::20], case.directions[::20]
        ours, theirs = (one.first_hit(*few) for one in (tracer, oracle))
        for column in ("t", "u", "v", "prim_id", "status"):
            assert getattr(ours, column).tobytes() == getattr(theirs, column).tobytes()
    else:
        assert_expected(answers_of(tracer, rays_of(case)), answers_of(oracle, rays_of(case)))


@pytest.mark.parametrize("scene", ["spheres", "cornell"])
def test_trees_cost_about_what_the_cpus_fast_ones_do(device, scene):
    scene = rs.load(scene)
    fast = rs.Tracer(scene, "bvh", quality="fast").structure
    assert_whole(structure := built(scene, "bvh").structure)
    assert structure.cost_when_built <= 1.1 * trace_cost(fast.tree)


@pytest.mark.parametrize("size", [1, 3, 32])
def test_leaves_are_no_larger_than_allowed(device, size):
    structure = built(rs.load("cornell"), "bvh", max_leaf_size=size).structure
    assert_whole(structure)
    links = structure.tree.children
    blocks = (~links[links < 0] & 7) + 1
    assert blocks.max() <= -(-size // 4)
    if size < 4:
        assert (structure.tree.prim_ids >= 0).sum(axis=1).max() <= size


@pytest.mark.usefixtures("gpu", "simple_sort")
def test_trees_in_the_simulator_itself():
    assert_whole(built(rs.load("cornell"), "bvh").structure)


def _row_of_triangles(places, sizes):
    shape = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    corners = places[:, None, None] * [1.0, 0.0, 0.0] + sizes[:, None, None] * shape
    return rs.Scene.from_arrays(corners.reshape(-1, 3), np.arange(3 * len(places)).reshape(-1, 3))


@pytest.mark.parametrize(
    ("places", "sizes"),
    [
        (np.zeros(300), np.ones(300)),
        (np.arange(300.0) ** 2, np.arange(1.0, 301.0)),
        (2.0 ** -np.arange(60.0), 0.4 * 2.0 ** -np.arange(60.0)),
    ],
    ids=["all the same", "each a little larger", "each half as large"],
)
def test_clusters_need_few_rounds(device, monkeypatch, places, sizes):
    """In rows of triangles that grow, only the first two of the row fit best."""
    from raystream.cuda.builders.clusters import find_match

    rounds = []
    usual = RangeKernel.launch

    def launch(kernel, gpu, count, arguments, stream=None):
        if kernel is find_match:
            rounds.append(count)
        usual(kernel, gpu, count, arguments, stream)

    monkeypatch.setattr(RangeKernel, "launch", launch)
    assert_whole(built(_row_of_triangles(places, sizes), "bvh").structure)
    assert len(rounds) <= 10 * np.log2(len(places))


def test_levels_are_counted(device, monkeypatch):
    from raystream.cuda.builders import wide

    monkeypatch.setattr(wide, "MAX_DEPTH", 2)
    assert built(rs.load("cornell"), "bvh").structure.quality()["depth"] == 2
    monkeypatch.setattr(wide, "MAX_DEPTH", 1)
    structure = built(rs.load("cornell"), "bvh").structure
    assert type(structure) is BvhStructure  # the processor built it
    assert_whole(structure)


# ---- Moving triangles.


def _copy_of(tree):
    copies = BvhArrays(*(aligned_array(*array.shape) for array in tree))
    for one, array in zip(copies, tree, strict=True):
        one[:] = array
    return copies


def test_trees_are_refitted_as_on_the_cpu(device):
    case = case_of("closed_mesh")
    tracer = built(case.scene, "bvh")
    expected = _copy_of(tracer.structure.tree)
    moved = case.vertices + 0.05 * np.sin(7.0 * case.vertices[:, ::-1])
    report = tracer.update(moved)
    assert not report.rebuilt
    refit(expected, tracer.structure.triangles.corners)
    for ours, theirs in zip(tracer.structure.tree, expected, strict=True):
        assert ours.tobytes() == theirs.tobytes()
    assert report.cost == pytest.approx(trace_cost(expected))
    assert_whole(tracer.structure)
    # The cost is compared with that of the build, not of the last update.
    assert tracer.update(case.vertices).cost_when_built == report.cost_when_built


@pytest.mark.parametrize("structure", ["bvh", "grid"])
def test_far_moves_answer_as_a_new_tracer(device, structure):
    case = case_of("closed_mesh")
    tracer = built(case.scene, structure)
    for offset in ([1e5, 5e4, 0.0], [0.0, 5e6, 0.0]):
        moved = case.vertices + offset
        assert tracer.update(moved).rebuilt
        fresh = rs.Tracer(rs.Scene.from_arrays(moved, case.faces), "brute")
        ours, theirs = tracer.structure.triangles, fresh.structure.triangles
        assert (*ours.center, ours.scale) == (*theirs.center, theirs.scale)
        rays = case.origins[:40] + offset, case.directions[:40]
        found, expected = tracer.first_hit(*rays), fresh.first_hit(*rays)
        assert found.is_hit.any()
        for name in ("t", "u", "v", "prim_id"):
            assert getattr(found, name).tolist() == getattr(expected, name).tolist()


@pytest.mark.parametrize("moves_first", [True, False])
def test_updates_leave_other_tracers_of_a_tree_alone(device, moves_first):
    case = case_of("closed_mesh")
    first = built(case.scene, "bvh")
    second = rs.Tracer.of_structure(first.structure, case.scene, "cuda")
    mover, other = (first, second) if moves_first else (second, first)
    rays = case.origins[:40], case.directions[:40]
    before = other.first_hit(*rays)
    moved = case.vertices * [1.0, 1.1, 1.0]
    fresh = rs.Tracer(rs.Scene.from_arrays(moved, case.faces), "brute").first_hit(*rays)
    assert mover.update(moved, max_cost_growth=np.inf).rebuilt
    assert not mover.update(moved, max_cost_growth=np.inf).rebuilt
    assert mover.first_hit(*rays).prim_id.tolist() == fresh.prim_id.tolist()
    for one in (other, rs.Tracer.of_structure(other.structure)):  # as the host has it, too
        assert one.first_hit(*rays).t.tolist() == before.t.tolist()


@pytest.mark.parametrize("structure", ["bvh", "grid"])
def test_copies_can_be_updated(device, structure):
    """They are structures of the host."""
    case = case_of("closed_mesh")
    tracer = built(case.scene, structure)
    rays = case.origins[:40], case.directions[:40]
    before = tracer.first_hit(*rays)
    moved = case.vertices * [1.0, 1.1, 1.0]
    fresh = rs.Tracer(rs.Scene.from_arrays(moved, case.faces), "brute").first_hit(*rays)
    for other in (copy.copy(tracer), pickle.loads(pickle.dumps(tracer))):
        assert other.first_hit(*rays).t.tolist() == before.t.tolist()
        other.update(moved)
        assert other.first_hit(*rays).prim_id.tolist() == fresh.prim_id.tolist()
    assert tracer.first_hit(*rays).t.tolist() == before.t.tolist()


def test_trees_that_lost_their_shape_are_rebuilt(device):
    case = case_of("random_soup")
    tracer = built(case.scene, "bvh")
    order = np.random.default_rng(5).permutation(len(case.vertices))
    report = tracer.update(case.vertices[order], max_cost_growth=1.01)
    assert report.rebuilt
    assert_whole(tracer.structure)


def test_triangles_that_cannot_be_hit_any_more_stay_in_the_tree(device):
    case = case_of("random_soup")
    tracer = built(case.scene, "bvh")
    expected = _copy_of(tracer.structure.tree)
    lost = expected.prim_ids[(expected.prim_ids >= 0).sum(axis=1) > 1][0, 0]
    vertices = case.vertices.copy()
    vertices[case.faces[lost]] = vertices[case.faces[lost, 0]]
    assert not tracer.update(vertices, max_cost_growth=100.0).rebuilt
    triangles, tree = tracer.structure.triangles, tracer.structure.tree
    assert lost not in triangles.prim_ids
    assert lost in tree.prim_ids
    refit(expected, hittable_corners(triangles))
    for ours, theirs in zip(tree, expected, strict=True):
        assert ours.tobytes() == theirs.tobytes()


# ---- Around them.


def test_what_was_built_is_not_copied(device):
    from raystream.cuda.structures import place

    for structure in ("bvh", "grid"):
        tracer = built(rs.load("cornell"), structure)
        assert place(tracer.structure, device, is_own=True) is tracer.structure.resident
        assert "_on_host" not in tracer.structure.__dict__
        assert tracer.structure.report.byte_count > 0


def test_files_of_them_are_read_by_the_cpu(device, tmp_path):
    scene = rs.load("cornell")
    for structure in ("bvh", "grid"):
        tracer = built(scene, structure)
        tracer.save(tmp_path / "built.npz")
        read = rs.Tracer.load(tmp_path / "built.npz", scene)
        ours, theirs = (one.structure.quality() for one in (tracer, read))
        ours.pop("bytes", None)  # those on the device
        assert ours.items() <= theirs.items()


def test_no_triangles(device):
    empty = rs.Scene.from_arrays(np.zeros((0, 3)), np.zeros((0, 3), int))
    for structure in ("bvh", "grid"):
        assert built(empty, structure).structure.arrays.keys() == {
            *rs.Tracer(empty, structure).structure.arrays
        }


@pytest.mark.parametrize(
    ("structure", "options", "message"),
    [
        ("bvh", {"build": "there"}, "build: expected one of 'host', 'device', got 'there'"),
        ("brute", {}, "build: 'device' builds 'bvh', 'graph', 'grid', 'kdtree', not 'brute'"),
        ("bvh", {"max_leaf_size": 33}, "max_leaf_size: expected 1 to 32, got 33"),
        ("grid", {"levels": 2}, "levels: expected 1 where build='device', got 2"),
        ("grid", {"resolution": 0}, "resolution: expected 1 to"),
        ("grid", {"gpu": 99}, "gpu: expected a number from 0 to 0, got 99"),
    ],
)
def test_options_are_checked(device, structure, options, message):
    with pytest.raises((ValueError, rs.RaystreamError), match=message):
        rs.Tracer(rs.load("cornell"), structure, "cuda", **{"build": "device", **options})


def test_progress_is_reported(device):
    seen = []
    built(rs.load("cornell"), "bvh", progress=lambda *done: seen.append(done))
    assert seen == [(36, 36)]


# ---- Without a device.


#: The longest, and those with shared memory and atomics; the others are for .ci/nightly.
_USUAL = (
    "fill_pairs",
    "merge",
    "write_node",
    "move_leaves",
    "scan_tiles_64",
    "scatter_32",
    "try_planes",
    "place_parts",
    "fill_raw",
    "share_covered",
)

TREE_KERNELS = (
    *("try_planes", "choose_plane", "make_reference", "count_cut", "confirm", "count_parts"),
    *("make_cells", "place_parts", "count_below", "mark_large", "begin_rows", "number_children"),
    *("write_tree_node", "extend_children"),
)
GRAPH_KERNELS = (
    *("place_list", "weigh", "cut", "place_cells", "place_nodes", "mark_leaf", "list_leaf"),
    *("number_sector", "write_sector", "fill_bin", "fill_block", "find_node_axes", "count_raw"),
    *("spread_covered", "mark_covered", "put_covered", "share_covered", "fill_raw", "put_raw"),
    *("share_raw", "place_links", "mark_first", "write_link_node"),
)
_KERNELS = (
    *("count_cells", "fill_pairs", "find_split", "make_key", "make_leaf"),
    *("begin_cluster", "find_match", "count_places", "merge", "count_lanes", "give_rows"),
    *("write_node", "count_row", "write_row", "move_leaves", "move_nodes", "add_costs"),
    *TREE_KERNELS,
    *GRAPH_KERNELS,
    *("add_tiles_32", "scan_tiles_32", "count_digits_32", "scatter_32"),
    *("add_tiles_64", "scan_tiles_64", "count_digits_64", "scatter_64"),
)


@pytest.mark.skipif(is_simulated(), reason="the simulator has no compiler")
@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=[pytest.mark.exhaustive] * (name not in _USUAL))
        for name in _KERNELS
    ],
)
def test_every_kernel_compiles(name):
    from raystream.cuda.precompile import block_kernels, shared_kernels

    ranges, blocks = shared_kernels("builds"), block_kernels()
    assert {*ranges, *blocks} == {*_KERNELS}
    if name in blocks:
        ptx = blocks[name].compiled(CAPABILITIES[0]).ptx
        assert ".shared" in ptx
        assert "f64" not in ptx  # the type of mixed signed and unsigned integers
    else:
        kernel, arguments = ranges[name]
        ptx = kernel.compiled(arguments, CAPABILITIES[0]).ptx
        assert "fma.rn" not in ptx

"""The BVH builder by itself: its arrays are checked number by number."""

import numpy as np
import pytest

import raystream as rs
from conftest import assert_same_bits
from meshes import dented_sphere, grid_floor, lattice_soup, soup
from raystream.core.triangles import Triangles
from raystream.jit.threads import parallel_for, thread_count
from raystream.kernels.aligned import aligned_array
from raystream.structures.bvh.build import QUALITIES, build_arrays
from raystream.structures.bvh.builder import parallel_split
from raystream.structures.bvh.layout import MAX_DEPTH, BvhArrays, check_arrays
from raystream.structures.bvh.refit import refit
from raystream.structures.bvh.statistics import statistics


def triangles_of(vertices, faces):
    return Triangles([(np.asarray(vertices), np.asarray(faces, np.int32))])


def sticks(count, seed=0):
    """Long thin triangles in all directions: they fill little of their boxes."""
    rng = np.random.default_rng(seed)
    begin = rng.random((count, 3))
    end = begin + rng.normal(size=(count, 3)) * 0.1
    corners = np.stack([begin, end, end + rng.normal(size=(count, 3)) * 0.01], axis=1)
    return corners.reshape(-1, 3), np.arange(3 * count).reshape(-1, 3)


def boxes_of(nodes):
    """Low and high corners of all children, each of shape (M, 8, 3)."""
    planes = nodes[:, :48].reshape(-1, 3, 2, 8)
    return planes[:, :, 0].transpose(0, 2, 1), planes[:, :, 1].transpose(0, 2, 1)


def walk(arrays, triangles, max_leaf_size=4):
    """Check the layout and every box, and that each triangle is in one leaf."""
    nodes, leaves = arrays
    assert nodes.ctypes.data % 64 == leaves.ctypes.data % 64 == 0
    assert not nodes.view(np.int32)[:, 56:].any()
    children, (low, high) = arrays.children, boxes_of(nodes)
    used = np.isfinite(low[:, :, 0])
    assert used[:, 0].all()
    assert (used[:, 1:] <= used[:, :-1]).all()
    assert (low[~used] == np.inf).all()
    assert (high[~used] == -np.inf).all()
    assert not children[~used].any()

    # Nodes: each once, after its parent, within its box.
    rows, lanes = np.nonzero(children > 0)
    below = children[rows, lanes]
    assert sorted(below) == list(range(1, len(nodes)))
    assert (below > rows).all()
    low_below, high_below = low[below].min(axis=1), high[below].max(axis=1)
    assert (low_below == low[rows, lanes]).all()
    assert (high_below == high[rows, lanes]).all()

    # Leaves: blocks without gaps, boxes around the triangles.
    held = np.zeros(len(triangles), int)
    next_block = 0
    for row, lane in sorted(
        zip(*np.nonzero(children < 0), strict=True), key=lambda at: ~children[at]
    ):
        first, count = ~children[row, lane] >> 3, (~children[row, lane] & 7) + 1
        assert first == next_block
        next_block = first + count
        ids = arrays.prim_ids[first : first + count].ravel()
        size = np.count_nonzero(ids >= 0)
        assert 4 * (count - 1) < size <= max_leaf_size
        assert (ids[size:] == -1).all()
        ids = ids[:size]
        np.add.at(held, ids, 1)
        corners = leaves[first : first + count, :36].reshape(count, 3, 3, 4)
        corners = corners.transpose(0, 3, 1, 2).reshape(-1, 3, 3)
        assert np.isnan(corners[size:]).all()
        assert_same_bits(corners[:size], triangles.corners[ids])
        around = corners[:size].min(axis=(0, 1)), corners[:size].max(axis=(0, 1))
        assert (low[row, lane] == around[0]).all()
        assert (high[row, lane] == around[1]).all()
    assert next_block == len(leaves)
    solid = np.zeros(len(triangles), bool)
    solid[triangles.prim_ids] = True
    assert (held == solid).all()


@pytest.mark.parametrize("quality", QUALITIES)
@pytest.mark.parametrize("max_leaf_size", [1, 3, 4, 8, 32])
@pytest.mark.parametrize(
    "mesh", [soup(1), soup(2), soup(500), dented_sphere(3), lattice_soup(200), grid_floor(20)]
)
def test_every_triangle_is_in_a_leaf_and_every_box_is_tight(mesh, max_leaf_size, quality):
    triangles = triangles_of(*mesh)
    walk(build_arrays(triangles, quality, max_leaf_size), triangles, max_leaf_size)


def test_a_scene_of_nothing():
    nodes, leaves = build_arrays(triangles_of(np.zeros((3, 3)), [[0, 1, 2]]))
    assert nodes.shape == (0, 64)
    assert leaves.shape == (0, 40)
    assert statistics(BvhArrays(nodes, leaves))["nodes"] == 0


@pytest.mark.ci
@pytest.mark.parametrize("quality", QUALITIES)
@pytest.mark.parametrize("count", [20_000, 300_000])
def test_the_tree_does_not_depend_on_the_number_of_threads(quality, count):
    triangles = triangles_of(*soup(count, 9, 0.01))
    try:
        rs.set_thread_count(1)
        alone = build_arrays(triangles, quality)
        rs.set_thread_count(5)
        together = build_arrays(triangles, quality)
    finally:
        rs.set_thread_count(None)
    for a, b in zip(alone, together, strict=True):
        assert_same_bits(a, b)


@pytest.mark.ci
def test_large_scenes_are_split_by_all_threads():
    triangles = triangles_of(*soup(150_000, 4, 0.01))
    walk(build_arrays(triangles), triangles)


@pytest.mark.parametrize("copies", [50, 5000, 150_000])
@pytest.mark.parametrize("quality", QUALITIES)
def test_equal_triangles_are_halved_by_count(copies, quality):
    vertices, faces = soup(1)
    triangles = triangles_of(vertices, np.repeat(faces, copies, axis=0))
    arrays = build_arrays(triangles, quality)
    assert statistics(arrays)["depth"] <= 16
    if copies <= 5000:
        walk(arrays, triangles)


@pytest.mark.parametrize("quality", QUALITIES)
@pytest.mark.parametrize("max_leaf_size", [1, 32])
def test_a_scene_that_grows_by_a_factor_from_triangle_to_triangle_is_not_too_deep(
    quality, max_leaf_size
):
    """Splits take the largest ones away only: the deepest trees there are."""
    base = np.array([[0, 0, 0], [1, 0, 0.1], [0, 1, 0.2]])
    sizes = 2.0 ** -np.arange(0, 120, 0.05)
    vertices = (base[None] * sizes[:, None, None] + sizes[:, None, None] * 3).reshape(-1, 3)
    triangles = triangles_of(vertices, np.arange(len(vertices)).reshape(-1, 3))
    arrays = build_arrays(triangles, quality, max_leaf_size)
    assert statistics(arrays)["depth"] <= MAX_DEPTH
    walk(arrays, triangles, max_leaf_size)


def test_a_wall_shares_no_leaf_with_what_stands_before_it():
    """Four triangles fit into one leaf, and stay there if they are one thing."""
    wall = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], np.float32)
    square = np.array([[0, 1, 2], [0, 2, 3]], np.int32)
    for other, size in ((wall * 0.01 + 0.5, 2), (wall + [0, 0, 1e-3], 4)):
        places = np.arange(3)[:, None, None] * [9.0, 0.0, 0.0]
        vertices = (np.concatenate([wall, other]) + places).reshape(-1, 3)
        faces = np.concatenate([square + 4 * k for k in range(6)])
        rows = build_arrays(triangles_of(vertices, faces)).prim_ids
        held = sorted(sorted(row[row >= 0].tolist()) for row in rows)
        assert held == np.arange(12).reshape(-1, size).tolist()


def test_statistics_count_what_a_ray_meets():
    """Two triangles side by side in one leaf, seen by every ray; a known sum for more."""
    one = statistics(build_arrays(triangles_of(*soup(2))))
    assert one["nodes"] == one["leaf blocks"] == one["depth"] == 1
    assert one["nodes per ray"] == one["blocks per ray"] == 1.0
    assert one["references"] == 2
    many = statistics(build_arrays(triangles_of(*soup(5000, 2, 0.02))))
    assert many["nodes per ray"] + many["blocks per ray"] < 120
    assert 0.5 < many["block fill"] <= 1.0
    assert 0.6 < many["lane fill"] <= 1.0


@pytest.mark.parametrize("max_leaf_size", [4, 32])
@pytest.mark.parametrize("quality", QUALITIES)
def test_refitting_takes_over_new_positions(quality, max_leaf_size, rng):
    triangles = triangles_of(*sticks(3000))
    arrays = build_arrays(triangles, quality, max_leaf_size)
    moved = triangles.corners + rng.normal(size=(len(triangles), 1, 3)).astype(np.float32) * 0.1
    refit(arrays, moved)
    after = triangles_of(moved.reshape(-1, 3), np.arange(3 * len(moved)).reshape(-1, 3))
    assert_same_bits(after.corners, moved)
    walk(arrays, after, max_leaf_size)


def test_refitting_to_the_same_positions_changes_nothing():
    triangles = triangles_of(*soup(30_000, 3, 0.01))
    arrays = build_arrays(triangles)
    before = [array.copy() for array in arrays]
    refit(arrays, triangles.corners)
    for a, b in zip(arrays, before, strict=True):
        assert_same_bits(a, b)


class TestCheckArrays:
    """No file may make a traversal read out of bounds, or run forever."""

    @pytest.fixture
    def triangles(self):
        return triangles_of(*soup(300))

    def check(self, triangles, **changes):
        nodes, leaves = build_arrays(triangles)
        arrays = {"nodes": nodes, "leaves": leaves}
        for name, change in changes.items():
            arrays[name] = change(arrays[name])
        return check_arrays(arrays, triangles.prim_ids, triangles.corners)

    def test_what_was_built_is_taken(self, triangles):
        checked = self.check(triangles)
        for a, b in zip(checked, build_arrays(triangles), strict=True):
            assert_same_bits(a, b)
        nothing = {"nodes": aligned_array(0, 64), "leaves": aligned_array(0, 40)}
        check_arrays(nothing, np.empty(0, np.int32), np.empty((0, 3, 3), np.float32))

    def test_arrays_are_aligned_again(self, triangles):
        def shift(array):
            memory = np.empty(array.size + 1, np.float32)
            memory[1:] = array.ravel()
            return memory[1:].reshape(array.shape)

        walk(self.check(triangles, nodes=shift, leaves=shift), triangles)

    @pytest.mark.parametrize("link", [10**6, -(10**6), 0])
    def test_a_child_out_of_range(self, triangles, link):
        def change(nodes):
            nodes.view(np.int32)[1, 48] = link
            return nodes

        with pytest.raises(ValueError, match=r"range|absent"):
            self.check(triangles, nodes=change)

    def test_a_cycle_and_a_node_with_two_parents(self, triangles):
        for link in (1, 2):

            def change(nodes, link=link):
                nodes.view(np.int32)[-1, 48] = link
                return nodes

            with pytest.raises(ValueError, match="two parents"):
                self.check(triangles, nodes=change)

    def test_a_missing_leaf(self, triangles):
        def change(nodes):
            child, planes = nodes.view(np.int32)[:, 48:56], nodes[:, :48].reshape(-1, 3, 2, 8)
            row, lane = np.argwhere((child[:, :-1] < 0) & (child[:, 1:] == 0))[0]
            child[row, lane] = 0
            planes[row, :, :, lane] = np.inf, -np.inf
            return nodes

        with pytest.raises(ValueError, match="in no leaf"):
            self.check(triangles, nodes=change)

    def test_a_leaf_with_two_parents(self, triangles):
        """Its triangles would be hit twice."""

        def change(nodes):
            child = nodes.view(np.int32)[:, 48:56]
            first, second, *_ = np.argwhere(child < 0)
            child[tuple(first)] = child[tuple(second)]
            return nodes

        with pytest.raises(ValueError, match="in more than one leaf; rebuild the structure"):
            self.check(triangles, nodes=change)

    def test_a_triangle_that_cannot_be_hit_in_two_leaves(self):
        """It has no coordinates, and may get some by an update."""
        vertices, faces = soup(300)
        tracer = rs.Tracer(rs.Scene.from_arrays(vertices, faces))
        vertices = vertices.copy()
        vertices[faces[7]] = np.nan
        tracer.update(vertices, max_cost_growth=np.inf)
        triangles, tree = tracer.structure.triangles, tracer.structure.tree
        check_arrays(tree._asdict(), triangles.prim_ids, triangles.corners)
        row, lane = np.argwhere(tree.prim_ids < 0)[0]
        tree.prim_ids[row, lane] = 7
        with pytest.raises(ValueError, match="in more than one leaf"):
            check_arrays(tree._asdict(), triangles.prim_ids, triangles.corners)

    @pytest.mark.parametrize("prim_id", [-2, 300, 2**31 - 1, 5])
    def test_other_triangles(self, triangles, prim_id):
        def change(leaves):
            leaves.view(np.int32)[10, 36] = prim_id
            return leaves

        with pytest.raises(ValueError, match=r"triangles|prim_id"):
            self.check(triangles, leaves=change)

    def test_other_corners(self, triangles):
        def change(leaves):
            leaves[3, 5] += 1
            return leaves

        with pytest.raises(ValueError, match="triangles"):
            self.check(triangles, leaves=change)

    def test_no_nodes_for_a_scene(self, triangles):
        with pytest.raises(ValueError, match="in no leaf"):
            self.check(triangles, nodes=lambda nodes: nodes[:0])

    @pytest.mark.parametrize("name", ["nodes", "leaves"])
    def test_wrong_arrays(self, triangles, name):
        with pytest.raises(ValueError, match=name):
            self.check(triangles, **{name: lambda array: array.astype(np.float64)})
        with pytest.raises(ValueError, match=name):
            self.check(triangles, **{name: lambda array: array[:, 1:]})


def test_progress_while_building():
    seen = []
    triangles = triangles_of(*soup(40_000, 9, 0.01))
    build_arrays(triangles, progress=lambda done, total: seen.append((done, total)))
    assert seen[-1] == (40_000, 40_000)
    assert seen == sorted(seen)


def test_building_can_be_interrupted():
    def interrupt(done, total):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        build_arrays(triangles_of(*soup(40_000, 9, 0.01)), progress=interrupt)


class _Soiled:
    """NumPy whose new arrays hold what others left."""

    def __getattr__(self, name):
        return getattr(np, name)

    def empty(self, shape, dtype):
        return np.full(shape, 1e30, dtype)


def test_a_build_inside_a_loop_on_all_threads_gives_the_same_tree(monkeypatch):
    """A nested loop has one thread, which must fill every chunk's bins."""
    triangles = triangles_of(*soup(300_000, 9, 0.01))
    want = build_arrays(triangles)
    monkeypatch.setattr(parallel_split, "np", _Soiled())
    found = []

    def body(begin, end):
        if end > begin:
            found.append(build_arrays(triangles))

    parallel_for(body, thread_count(), 1)
    assert len(found) == thread_count()
    for arrays in found:
        for got, wanted in zip(arrays, want, strict=True):
            assert_same_bits(got, wanted)

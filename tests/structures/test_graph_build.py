"""Building graphs of sectors: tiling boxes, links, lists; and untrusted files."""

import io

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import raystream as rs
from cases import CASES
from conftest import assert_same_bits
from graphs import View, assert_links, assert_nodes, assert_sound
from meshes import cube, dented_sphere, grid_floor, soup
from raystream.core.triangles import Triangles
from raystream.structures.graph.build import build_graph, graph_box
from raystream.structures.graph.cells import find_cells
from raystream.structures.graph.check import check_graph
from raystream.structures.graph.layout import NODE_BIT, VOID, GraphArrays
from raystream.structures.graph.links import link_sectors
from raystream.structures.graph.morton_order import fill_sectors, order_sectors
from raystream.structures.graph.prune import prune
from raystream.structures.graph.statistics import statistics
from raystream.structures.graph.text_format import dump_graph
from raystream.structures.kdtree.build import MAX_REFERENCES
from raystream.structures.kdtree.layout import KdArrays
from raystream.structures.kdtree.split import Costs
from raystream.structures.saved import solid_mask
from strategies import meshes


def settings_with(**options):
    """Options with few triangles in a sector, to show what `Graph`'s defaults would hide."""
    few = {"crossing_cost": 8.0, "link_cost": 2.4, "max_depth": 64, "max_leaf_size": 1}
    return rs.Graph(**(few | options))


FINE = settings_with(crossing_cost=1.0, link_cost=0.3)


def triangles_of(vertices, faces):
    return Triangles([(np.asarray(vertices, float), np.asarray(faces, np.int32))])


def saved(arrays):
    """Arrays as in a file, the count included."""
    return {name: np.asarray(array) for name, array in arrays.items()}


def check(arrays, triangles):
    arrays = saved(arrays)
    return check_graph(arrays, triangles.bounds, solid_mask(triangles))


MESHES = {
    "soup": soup(150),
    "closed": dented_sphere(2),
    "flat": grid_floor(8),
    "cube": cube(),
    "one triangle": (np.eye(3), [[0, 1, 2]]),
    "one flat triangle": ([[0, 0, 1], [1, 0, 1], [0, 1, 1]], [[0, 1, 2]]),
    "coincident": (cube()[0], np.tile([[0, 1, 2], [5, 6, 7]], (20, 1))),
}


@pytest.mark.parametrize("mesh", MESHES)
@pytest.mark.parametrize(
    "settings",
    [
        FINE,
        settings_with(),
        settings_with(crossing_cost=0.01, link_cost=0.003),
        settings_with(crossing_cost=1.0, link_cost=0.3, max_depth=7, max_leaf_size=3),
    ],
)
def test_graphs_are_sound(mesh, settings, rng):
    triangles = triangles_of(*MESHES[mesh])
    arrays = build_graph(triangles, settings)
    depth = assert_sound(arrays, triangles, rng)
    assert statistics(arrays, settings)["link depth"] == depth
    assert_same(check(arrays._asdict(), triangles), arrays)


@pytest.mark.parametrize("case", CASES)
def test_hard_scenes(case, rng):
    triangles = CASES[case](rng).scene.triangles
    arrays = build_graph(triangles, settings_with(crossing_cost=4.0, link_cost=1.0))
    assert_sound(arrays, triangles, rng)
    assert_same(check(arrays._asdict(), triangles), arrays)


@settings(max_examples=60)
@given(meshes(), st.sampled_from([0.01, 1.0, 8.0]))
def test_any_small_scene(mesh, crossing_cost):
    (vertices, faces), _, _ = mesh
    triangles = triangles_of(vertices, faces)
    arrays = build_graph(
        triangles, settings_with(crossing_cost=crossing_cost, link_cost=0.3 * crossing_cost)
    )
    if len(triangles.prim_ids):
        assert_sound(arrays, triangles, np.random.default_rng(0))
    assert_same(check(arrays._asdict(), triangles), arrays)


def assert_same(one, other):
    for a, b in zip(one, other, strict=True):
        assert_same_bits(np.asarray(a), np.asarray(b))


def test_no_triangles():
    triangles = triangles_of(np.zeros((3, 3)), [[0, 1, 2]])
    arrays = build_graph(triangles, settings_with())
    assert arrays.sector_count == 0
    assert arrays.rows.shape == arrays.prim_ids.shape == (0, 4)
    assert arrays.bins.size == 0
    check(arrays._asdict(), triangles)
    assert statistics(arrays, settings_with())["sectors"] == 0.0


@pytest.mark.ci
@pytest.mark.parametrize(
    "settings", [settings_with(), settings_with(crossing_cost=0.01, link_cost=0.003)]
)
def test_a_graph_does_not_depend_on_the_number_of_threads(settings):
    triangles = triangles_of(*soup(20_000, 1, 0.02))
    graphs, figures = [], []
    for threads in (1, 2, 3):
        try:
            rs.set_thread_count(threads)
            graphs.append(build_graph(triangles, settings))
            figures.append(statistics(graphs[-1], settings))
        finally:
            rs.set_thread_count(None)
    assert figures[0] == figures[1] == figures[2]
    for graph in graphs[1:]:
        assert_same(graph, graphs[0])


def test_batches_of_raw_nodes_make_no_difference(monkeypatch):
    triangles = triangles_of(*soup(500))
    whole = View(build_graph(triangles, FINE))
    monkeypatch.setattr("raystream.structures.graph.links._BATCH", 100)
    parts = View(build_graph(triangles, FINE))
    # Nodes have other numbers, but are the same.
    assert len(whole.nodes) == len(parts.nodes)
    assert_sound(parts.arrays, triangles, np.random.default_rng(0))


def test_sectors_near_each_other_are_near_in_memory():
    view = View(build_graph(triangles_of(*soup(5000, 2, 0.02)), settings_with()))
    middles = (view.low.astype(float) + view.high) / 2
    steps = np.linalg.norm(np.diff(middles, axis=0), axis=1).mean()
    shuffled = np.random.default_rng(0).permutation(middles)
    assert steps < 0.3 * np.linalg.norm(np.diff(shuffled, axis=0), axis=1).mean()


def test_references_are_bounded():
    rng = np.random.default_rng(0)
    ends = rng.random((6000, 2, 3))
    third = ends[:, 1] + rng.normal(size=(6000, 3)) * 1e-3
    corners = np.concatenate([ends, third[:, None]], axis=1)
    triangles = triangles_of(corners.reshape(-1, 3), np.arange(18_000).reshape(-1, 3))
    settings = settings_with(crossing_cost=1e-6, link_cost=1e-7)
    arrays = build_graph(triangles, settings)
    found = statistics(arrays, settings)
    assert found["references"] <= MAX_REFERENCES * len(triangles) + 1024
    check(arrays._asdict(), triangles)


def strips(nodes, node, axis, count):
    """Divide a leaf of a kd-tree along an axis of the unit cube into equal strips."""
    pending = [(node, 0.0, 1.0, count)]
    while pending:
        node, low, high, left = pending.pop()
        if left == 1:
            continue
        middle = (low + high) / 2
        nodes[node] = np.float32(middle).view(np.int32), len(nodes) << 2 | axis
        pending += [(len(nodes), low, middle, left // 2), (len(nodes) + 1, middle, high, left // 2)]
        nodes += [(0, 3), (0, 3)]


def test_walls_of_strips_share_their_link_nodes():
    """Each of many strips along y faces many along z: as many links as pairs, but few nodes."""
    count = 64
    nodes = [(np.float32(0.5).view(np.int32), 1 << 2), (0, 3), (0, 3)]
    strips(nodes, 1, 1, count)
    strips(nodes, 2, 2, count)
    tree = KdArrays(np.array(nodes, np.int32), np.zeros((0, 4), np.int32))
    cells = find_cells(tree.nodes, np.array([[0, 0, 0], [1, 1, 1]], np.float32))
    order = order_sectors(tree.nodes, cells)
    sectors = np.zeros((8 * count, 4), np.uint32)
    prim_ids = fill_sectors(tree, cells, order, sectors)
    links = link_sectors(tree.nodes, cells, order, sectors)
    rows = np.concatenate([sectors, links])
    graph = GraphArrays(rows, 2 * count, prim_ids, np.zeros((1, 1, 1), np.uint32))
    found = statistics(graph, settings_with())
    assert found["link nodes"] == 2 * (count - 1)
    assert found["link nodes unshared"] == 2 * count * (count - 1)
    assert found["link depth"] == assert_nodes(View(graph)) == np.log2(count)
    assert_links(View(graph), np.random.default_rng(0))
    check_graph(saved(graph._asdict()), np.zeros((2, 3), np.float32), np.zeros(0, np.bool_))


def test_splits_pay_in_the_model():
    triangles = triangles_of(*dented_sphere(3))
    costs = []
    for depth in (0, 6, 64):
        settings = settings_with(max_depth=depth)
        costs.append(statistics(build_graph(triangles, settings), settings)["cost"])
    assert costs[0] > costs[1] > costs[2]


def prune_by(tree, costs):
    box = np.array([[0, 0, 0], [1, 1, 1]], np.float32)
    return prune(tree, find_cells(tree.nodes, box).boxes, costs)


def test_splits_that_did_not_pay_are_taken_back():
    """Three leaves, of which two list the same triangles: these become one."""
    bits = [np.float32(position).view(np.int32) for position in (0.5, 0.75)]
    nodes = [(bits[0], 1 << 2), (0, 3 << 2 | 3), (bits[1], 3 << 2 | 1), (1, 5 << 2 | 3)]
    nodes = np.array([*nodes, (3, 2 << 2 | 3)], np.int32)
    prim_ids = np.array([[5, 6, 7, -1], [0, 1, 2, 3], [4, -1, -1, -1], [4, 1, -1, -1]], np.int32)
    tree = KdArrays(nodes, prim_ids)
    assert_same(prune_by(tree, Costs(0.0, 1.0, 0.0, 1e-3)), tree)
    pruned = prune_by(tree, Costs(0.0, 1.0, 0.0, 2.0))
    assert pruned.nodes.tolist() == [[bits[0], 1 << 2], [0, 3 << 2 | 3], [1, 5 << 2 | 3]]
    assert pruned.prim_ids.tolist() == prim_ids[:3].tolist()
    whole = prune_by(tree, Costs(0.0, 1.0, 0.0, 20.0))
    assert whole.nodes.tolist() == [[0, 8 << 2 | 3]]
    assert whole.prim_ids.tolist() == [[5, 6, 7, 0], [1, 2, 3, 4]]


@pytest.mark.parametrize("mesh", ["soup", "closed"])
def test_taking_splits_back_costs_less(mesh, monkeypatch):
    triangles = triangles_of(*MESHES[mesh])
    settings = settings_with(crossing_cost=2.0, link_cost=0.0)
    pruned = statistics(build_graph(triangles, settings), settings)
    monkeypatch.setattr("raystream.structures.graph.build.prune", lambda tree, *_: tree)
    whole = statistics(build_graph(triangles, settings), settings)
    assert pruned["sectors"] < whole["sectors"]
    assert pruned["references"] <= whole["references"]
    assert pruned["cost"] < whole["cost"]


def test_figures_are_those_of_the_sectors():
    triangles = triangles_of(*soup(100, 4))
    settings = settings_with(crossing_cost=3.0, link_cost=0.9)
    arrays = build_graph(triangles, settings)
    view, found = View(arrays), statistics(arrays, settings)
    x, y, z = (view.high.astype(float) - view.low).T
    half = x * y + y * z + z * x
    x, y, z = np.diff(graph_box(triangles).astype(float), axis=0)[0]
    whole = x * y + y * z + z * x
    assert found["sectors"] == view.count == arrays.sector_count
    assert found["empty sectors"] == (view.list_size == 0).sum()
    assert found["references"] == view.list_size.sum()
    assert found["largest list"] == view.list_size.max()
    np.testing.assert_allclose(found["sectors per ray"], half.sum() / whole, rtol=1e-5)
    np.testing.assert_allclose(found["tests per ray"], half @ view.list_size / whole, rtol=1e-5)
    unshared, passed = 0, 0.0
    for sector in range(view.count):
        for face in range(6):
            pending = [(int(view.links[sector, face]), view.low[sector], view.high[sector])]
            while pending:
                link, low, high = pending.pop()
                if link == VOID or not link & NODE_BIT:
                    continue
                node = view.node_of(link)
                axis, plane = view.axes[node], view.planes[node]
                unshared += 1
                passed += np.delete(high.astype(float) - low, face >> 1).prod()
                middle_low, middle_high = low.copy(), high.copy()
                middle_low[axis] = middle_high[axis] = plane
                pending.append((int(view.node_links[node, 0]), low, middle_high))
                pending.append((int(view.node_links[node, 1]), middle_low, high))
    assert found["link nodes"] == len(view.nodes)
    assert found["link nodes unshared"] == unshared
    np.testing.assert_allclose(found["link nodes per ray"], passed / (2 * whole), rtol=1e-5)
    cost = 3.0 * found["sectors per ray"] + found["tests per ray"]
    np.testing.assert_allclose(found["cost"], cost + 0.9 * found["link nodes per ray"])


class TestGraphlog:
    def dumped(self, mesh):
        triangles = triangles_of(*mesh)
        arrays = build_graph(triangles, FINE)
        file = io.StringIO()
        dump_graph(file, arrays, triangles.corners)
        return triangles, arrays, file.getvalue()

    @pytest.mark.ci
    @pytest.mark.parametrize("mesh", [*MESHES.values(), (np.zeros((3, 3)), [[0, 1, 2]])])
    def test_its_numbers_are_those_of_the_graph(self, mesh):
        triangles, arrays, text = self.dumped(mesh)
        view = View(arrays)
        lines = [line.split(" ; ") for line in text.splitlines()]

        def floats(kind, columns):
            words = [" ".join(line[columns]).split() for line in lines if line[0].startswith(kind)]
            return np.array(words, np.float32)

        corners = floats("Triangle", slice(2 if len(lines[1]) > 4 else 1, None))
        assert_same_bits(corners.reshape(-1, 3, 3), triangles.corners)
        sides = floats("Sector", slice(1, 2)).reshape(-1, 3, 2)
        assert_same_bits(sides[..., 0], view.low)
        assert_same_bits(sides[..., 1], view.high)
        listed = [line[-1].split(";")[-1].split() for line in lines if line[0].startswith("Sector")]
        for sector, words in enumerate(listed):
            assert list(map(int, words)) == view.listed(sector).tolist()
        numbers = {
            kind: [
                (int(line[2]), list(map(int, line[3].split())))
                for line in lines
                if line[0].startswith(kind)
            ]
            for kind in ("Sector", "Node")
        }
        for kind, links in (("Sector", view.links), ("Node", view.node_links)):
            for (flags, named), own in zip(numbers[kind], links.tolist(), strict=True):
                for place, (number, link) in enumerate(zip(named, own, strict=True)):
                    is_sector = flags >> place & 1
                    assert is_sector == (link == VOID or not link & NODE_BIT)
                    target = 4 * number if is_sector else NODE_BIT | (4 * view.count + number)
                    assert link == (VOID if number == -1 else target)
        planes = [line[1].split() for line in lines if line[0].startswith("Node")]
        assert [int(axis) for axis, _ in planes] == view.axes.tolist()
        assert_same_bits(np.array([at for _, at in planes], np.float32), view.planes)
        bins = np.array(lines[-1][-1].split(), np.int64)
        np.testing.assert_array_equal(4 * bins, arrays.bins.ravel())

    def test_its_lines(self):
        _, arrays, text = self.dumped(cube())
        lines = text.splitlines()
        view = View(arrays)
        assert lines[0] == f"Count 12 {view.count} {len(view.nodes)}"
        assert lines[1] == "Triangle 0 ; 0 0 0 ; 0 0 1 ; 0 1 1"
        assert len(lines) == 14 + view.count + len(view.nodes)
        assert lines[13].startswith("Sector 0 ; ")


def walk_ends(arrays, rng):
    """Walk through a graph at random in each octant; returns whether all walks end, in bounds."""
    view = View(arrays)
    for octant in range(8):
        sector = int(rng.integers(view.count))
        for _ in range(view.count + 1):
            faces = [2 * axis + (octant >> axis & 1) for axis in range(3)]
            links = [int(link) for link in view.links[sector, faces] if link != VOID]
            if not links:
                break
            link = links[rng.integers(len(links))]
            while link & NODE_BIT:
                link = int(view.node_links[view.node_of(link), rng.integers(2)])
            sector = link // 4
            assert 0 <= sector < view.count
            first, size = int(view.first_block[sector]), int(view.list_size[sector])
            assert first + -(-size // 4) <= len(arrays.prim_ids)
        else:
            return False
    return True


class TestCheckGraph:
    """No file may make a walk read out of bounds, or run forever."""

    TRIANGLES = triangles_of(*soup(60))

    def graph(self, **changes):
        arrays = {**build_graph(self.TRIANGLES, FINE)._asdict()}
        for name, change in changes.items():
            arrays[name] = change(arrays[name])
        return arrays

    @settings(max_examples=300)
    @given(st.data())
    def test_changed_words(self, data):
        arrays = {name: np.array(array) for name, array in self.graph().items()}
        name = data.draw(st.sampled_from(["rows", "rows", "rows", "prim_ids", "bins"]))
        array = arrays[name].reshape(-1)
        whole = array.view(np.uint32)
        for _ in range(data.draw(st.integers(1, 3))):
            place = data.draw(st.integers(0, len(whole) - 1))
            near = int(whole[place]) + data.draw(st.integers(-64, 64))
            other = int(whole[data.draw(st.integers(0, len(whole) - 1))])
            any_word = data.draw(st.integers(0, 2**32 - 1))
            whole[place] = data.draw(st.sampled_from([near, other, any_word])) % 2**32
        try:
            graph = check(arrays, self.TRIANGLES)
        except ValueError:
            return
        assert walk_ends(graph, np.random.default_rng(0))
        assert graph.prim_ids.max() < len(self.TRIANGLES)

    def test_a_circle_of_sectors_whose_planes_agree(self):
        """In two by two sectors, the upper left and the lower right one link to each other."""
        triangles = triangles_of([[0.1, 0.1, 0], [1.9, 0.1, 1], [0.1, 1.9, 1]], [[0, 1, 2]])
        boxes = [(x, y) for y in (-1.0, 1.0) for x in (-1.0, 1.0)]
        rows = np.zeros((16, 4), np.uint32)
        numbers = rows.view(np.float32)
        for i, (x, y) in enumerate(boxes):
            numbers[4 * i, :3], numbers[4 * i + 1, :3] = (x, y, -1), (x + 2, y + 2, 2)
            rows[4 * i + 1, 3] = 1
            right, up = i + 1 if i % 2 == 0 else None, i + 2 if i < 2 else None
            left, down = i - 1 if i % 2 else None, i - 2 if i > 1 else None
            links = [VOID if s is None else 4 * s for s in (left, right, down, up)]
            rows[4 * i + 2], rows[4 * i + 3] = links, (VOID, VOID, 0, 0)
        prim_ids = np.array([[0, -1, -1, -1]], np.int32)
        graph = GraphArrays(rows, 4, prim_ids, np.zeros((1, 1, 1), np.uint32))
        check(graph._asdict(), triangles)
        rows[4 * 2 + 2, 1] = 4 * 1  # from the upper left one through its right face
        check(graph._asdict(), triangles)
        rows[4 * 1 + 2, 3] = 4 * 2  # from the lower right one through its upper face
        with pytest.raises(ValueError, match="form a cycle"):
            check(graph._asdict(), triangles)

    @pytest.mark.parametrize(
        ("word", "change", "message"),
        [
            (0, np.float32(np.nan).view(np.uint32), "invalid bounding box"),
            (4, np.float32(-9.0).view(np.uint32), "invalid bounding box"),
            (3, 2**30, "list is out of range"),
            (7, 2**32 - 1, "list is out of range"),
            (9, 2**31, "link is out of range"),
            (9, 2**31 - 4, "link is out of range"),
            (9, 6, "link is out of range"),
            (9, VOID, "do not touch"),
            (9, 0, "do not touch"),
        ],
    )
    def test_words_of_a_sector(self, word, change, message):
        def changed(rows):
            rows = rows.copy()
            rows.reshape(-1)[word] = change
            return rows

        with pytest.raises(ValueError, match=message):
            check(self.graph(rows=changed), self.TRIANGLES)

    @pytest.mark.parametrize(
        ("word", "change", "message"),
        [
            (0, np.float32(np.nan).view(np.uint32), "plane is not between"),
            (0, np.float32(99.0).view(np.uint32), "plane is not between"),
            (1, 3, "link node"),
            (2, VOID, "comes later, or to nowhere"),
            (3, 2**31 - 4, "link is out of range"),
        ],
    )
    def test_words_of_a_link_node(self, word, change, message):
        def changed(rows):
            rows = rows.copy()
            rows[-1, word] = change
            return rows

        with pytest.raises(ValueError, match=message):
            check(self.graph(rows=changed), self.TRIANGLES)

    def test_a_node_that_links_to_itself(self):
        def changed(rows):
            rows = rows.copy()
            rows[-1, 2] = NODE_BIT | (len(rows) - 1)
            return rows

        with pytest.raises(ValueError, match="comes later"):
            check(self.graph(rows=changed), self.TRIANGLES)

    @pytest.mark.parametrize("prim_id", [-2, 60, 2**31 - 1])
    def test_triangles_that_are_none(self, prim_id):
        def added(prim_ids):
            return np.concatenate([prim_ids, [[prim_id, -1, -1, -1]]]).astype(np.int32)

        with pytest.raises(ValueError, match="invalid triangle"):
            check(self.graph(prim_ids=added), self.TRIANGLES)

    @pytest.mark.parametrize(
        ("name", "change", "message"),
        [
            ("rows", lambda rows: rows[:-1], "range"),
            ("rows", lambda rows: rows[:8], "cannot hold"),
            ("rows", lambda rows: rows.view(np.int32), "dtype"),
            ("rows", lambda rows: rows[:, :3], "shape"),
            ("prim_ids", lambda ids: ids[:-1], "range"),
            ("prim_ids", lambda ids: ids[0], "shape"),
            ("bins", lambda bins: bins[0], "shape"),
            ("bins", lambda bins: bins[:0], "bin has no sector"),
            ("bins", lambda bins: bins + np.uint32(1), "bin has no sector"),
            ("bins", lambda bins: bins + np.uint32(2**20), "bin has no sector"),
            ("sector_count", lambda count: count + 10**6, "cannot hold"),
            ("sector_count", lambda count: -1, "cannot hold"),
            ("sector_count", lambda count: 1.0, "sector_count"),
            ("sector_count", lambda count: 0, "cannot hold anything"),
        ],
    )
    def test_wrong_arrays(self, name, change, message):
        with pytest.raises(ValueError, match=message):
            check(self.graph(**{name: change}), self.TRIANGLES)

    @pytest.mark.parametrize("name", ["rows", "prim_ids", "bins", "sector_count"])
    def test_missing_arrays(self, name):
        arrays = self.graph()
        del arrays[name]
        with pytest.raises(ValueError, match=name):
            check(arrays, self.TRIANGLES)

    def test_another_scene(self):
        arrays, others = self.graph(), triangles_of(*soup(61))
        with pytest.raises(ValueError, match="in no sector"):
            check(arrays, others)
        with pytest.raises(ValueError, match="contain the scene"):
            check_graph(saved(arrays), 9 * others.bounds, solid_mask(self.TRIANGLES))


def test_progress_while_building():
    seen = []
    triangles = triangles_of(*soup(20_000, 9, 0.01))
    build_graph(triangles, settings_with(), lambda done, total: seen.append((done, total)))
    assert seen[-1] == (20_000, 20_000)
    assert seen == sorted(seen)


def test_building_can_be_interrupted():
    def interrupt(done, total):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        build_graph(triangles_of(*soup(20_000, 9, 0.01)), settings_with(), interrupt)

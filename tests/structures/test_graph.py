"""Walks through the graph of sectors: start sectors, steps and cost."""

from __future__ import annotations

import io

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import raystream as rs
from cases import CASES
from conftest import assert_same_bits
from raystream.core.rays import RayBatch
from raystream.jit.cpu import kernel
from raystream.jit.simd import address
from raystream.kernels.local_frame import LocalRays
from raystream.kernels.ray import prepare_ray
from raystream.machines.ray_block import blocks
from raystream.structures.graph.layout import SECTOR_ROWS
from raystream.structures.graph.locate import MAX_WALK
from raystream.structures.graph.steps import (
    clip_to_scene,
    exit_face,
    follow_link,
    near_sector,
    sector_number,
    sector_ray,
    start_sector,
    walk_to,
)
from raystream.structures.graph.text_format import dump_graph

NOWHERE = np.int64(-1)
ROW_BYTES = np.uint64(16)
SECTOR_BYTES = np.uint64(16 * SECTOR_ROWS)


@kernel
def holders(graph, sector_count, max_coordinate, rays, t, rows, counts):
    """For each ray, a sector that contains it at t, and their number, by testing all sectors."""
    o, d = rays.origins, rays.directions
    for i in range(len(t)):
        ray = prepare_ray(o[i], d[i], max_coordinate)
        line = sector_ray(ray)
        counts[i] = 0
        rows[i] = NOWHERE
        for k in range(sector_count):
            sector = graph.rows + np.uint64(k) * SECTOR_BYTES
            # A walk that leaves no sector: none of its faces is on the wrong side of t.
            _, step_count = walk_to(graph, line, sector, t[i], np.uint64(1))
            if step_count == np.uint64(0):
                counts[i] += 1
                rows[i] = np.int64(k) * SECTOR_ROWS


@kernel
def follow(graph, max_coordinate, rays, i, most, rows, ends):
    """Write the sectors of ray i, and where it leaves them; returns their number."""
    o, d = rays.origins, rays.directions
    ray = prepare_ray(o[i], d[i], max_coordinate)
    is_active, t_in, t_end = clip_to_scene(graph, ray, rays.t_min[i], rays.t_max[i])
    if not is_active:
        return 0
    line = sector_ray(ray)
    sector, _ = start_sector(graph, line, ray, t_in)
    count = 0
    while count < most:
        face = exit_face(line, sector)
        rows[count] = np.int64((sector - graph.rows) // ROW_BYTES)
        ends[count] = min(face.t, t_end)
        count += 1
        if face.t >= t_end:
            break
        sector, _ = follow_link(graph, line, face.link, face.t)
    return count


def local_rays(structure, origins, directions):
    """A test's rays in the structure's frame."""
    batch = RayBatch(origins, directions, -np.inf, np.inf)
    (block,) = blocks(batch, structure.frame, np.zeros(len(batch), np.uint8), None)
    return block.rays


def graph_of(name, **options):
    return rs.Tracer(CASES[name](np.random.default_rng(5)).scene, "graph", **options).structure


def hard_rays(structure, rng, count=300):
    """Rays of all kinds, many from and through the planes, edges and corners of sectors."""
    sectors = structure.graph.rows[: SECTOR_ROWS * structure.graph.sector_count]
    boxes = sectors.reshape(-1, 16).view(np.float32)[:, [0, 1, 2, 4, 5, 6]].astype(np.float64)
    box = boxes[rng.integers(0, len(boxes), count)]
    share = rng.random((count, 3))
    share[rng.random((count, 3)) < 0.4] = 0.0
    share[rng.random((count, 3)) < 0.2] = 1.0
    share[rng.random(count) < 0.2] *= 40.0  # far outside
    origins = box[:, :3] + share * (box[:, 3:] - box[:, :3])
    directions = rng.normal(size=(count, 3))
    directions[rng.random((count, 3)) < 0.25] = 0.0
    target = boxes[rng.integers(0, len(boxes), count), :3]
    aimed = rng.random(count) < 0.4
    directions[aimed] = (target - origins)[aimed]
    directions[~directions.any(axis=1)] = [0.0, 0.0, 1.0]
    scale, center = float(structure.triangles.scale), structure.triangles.center
    return origins / scale + center, directions


NAMES = ["random_soup", "closed_mesh", "exact_edges_on_a_lattice", "flat_box", "huge_offset"]


@pytest.mark.parametrize("name", NAMES)
def test_all_routes_lead_to_the_one_sector_that_holds_the_ray(name, rng):
    structure = graph_of(name, crossing_cost=2.0, link_cost=0.5, max_leaf_size=1)
    graph = structure.graph
    max_coordinate = np.float32(structure.triangles.max_coordinate)
    rays = local_rays(structure, *hard_rays(structure, rng))
    count = len(rays.t_min)
    inside = structure.start_sectors(rays)
    is_active = inside.rows >= 0
    assert is_active.sum() > count // 4
    for t in (None, rng.normal(size=count).astype(np.float32)):
        from_bins = structure.start_sectors(rays, t)
        near = SECTOR_ROWS * rng.integers(0, graph.sector_count, count)
        displaced = structure.start_sectors(rays, t, near)
        np.testing.assert_array_equal(displaced.rows, from_bins.rows)
        at_home = structure.start_sectors(rays, t, from_bins.rows)
        np.testing.assert_array_equal(at_home.rows, from_bins.rows)
        assert not at_home.step_counts.any()
        if t is not None:
            rows, holder_counts = np.empty(count, np.int64), np.empty(count, np.int64)
            arguments = structure.view, graph.sector_count, max_coordinate, rays, t
            holders(*arguments, rows, holder_counts)
            # Planes that a ray meets at the same distance: sectors between them hold no t.
            assert (holder_counts[is_active] >= 1).all()
            alone = is_active & (holder_counts == 1)
            assert alone.sum() > 0.5 * is_active.sum()
            np.testing.assert_array_equal(from_bins.rows[alone], rows[alone])


def test_a_long_way_from_a_known_sector_is_not_walked(rng):
    """Beyond `MAX_WALK` sectors walks start from the bins, which are nearer here."""
    structure = graph_of("closed_mesh", crossing_cost=2.0, link_cost=0.5, max_leaf_size=1)
    rays = local_rays(structure, *hard_rays(structure, rng))
    near = SECTOR_ROWS * rng.integers(0, structure.graph.sector_count, len(rays.t_min))
    walked = structure.start_sectors(rays, None, near).step_counts
    assert walked.max() >= MAX_WALK
    bins = structure.start_sectors(rays).step_counts
    assert walked.max() <= MAX_WALK + bins.max()
    assert bins.mean() < 4.0


@pytest.mark.parametrize("name", NAMES)
def test_a_way_goes_on_and_ends(name, rng):
    """Ends of sectors never decrease, no sector is visited twice, and the last one ends the ray."""
    structure = graph_of(name, crossing_cost=2.0, link_cost=0.5, max_leaf_size=1)
    rays = local_rays(structure, *hard_rays(structure, rng))
    most = structure.graph.sector_count + 1
    rows, ends = np.empty(most, np.int64), np.empty(most, np.float32)
    longest = 0
    for i in range(len(rays.t_min)):
        max_coordinate = np.float32(structure.triangles.max_coordinate)
        count = follow(structure.view, max_coordinate, rays, i, most, rows, ends)
        assert count < most
        assert (np.diff(ends[:count]) >= 0).all()
        assert len(np.unique(rows[:count])) == count
        longest = max(longest, count)
    assert longest > 3


@settings(max_examples=40)
@given(seed=st.integers(0, 2**32 - 1), size=st.integers(1, 60), depth=st.integers(0, 20))
def test_graph_equals_brute_force(seed, size, depth):
    rng = np.random.default_rng(seed)
    vertices = rng.integers(-4, 5, (3 * size, 3)) * rng.choice([1.0, 0.37])
    scene = rs.Scene.from_arrays(vertices, np.arange(3 * size).reshape(-1, 3))
    graph = rs.Tracer(
        scene, "graph", crossing_cost=0.5, link_cost=0.1, max_leaf_size=1, max_depth=depth
    )
    origins = rng.integers(-6, 7, (64, 3)).astype(float)
    directions = rng.integers(-2, 3, (64, 3)).astype(float)
    expected = rs.Tracer(scene, "brute").multi_hit(origins, directions)
    found = graph.multi_hit(origins, directions)
    for column in ("ray_splits", "t", "u", "v", "prim_id"):
        assert getattr(found, column).tobytes() == getattr(expected, column).tobytes()


def test_the_cost_that_is_minimised_follows_what_rays_do(rng):
    """Over graphs of many costs, J ranks them as counted steps do (Spearman)."""
    scene = rs.load("spheres")
    low, high = scene.bounds
    corners = low + rng.random((2, 4000, 3)) * (high - low)
    directions = corners[1] - corners[0]
    origins = corners[0] - 10.0 * directions
    expected, counted = [], []
    prices = {"crossing_cost": 24.0, "intersection_cost": 1.0, "link_cost": 16.0}
    for depth in (2, 4, 6, 8, 11, 14, 20):
        for size in (4, 30):
            tracer = rs.Tracer(scene, "graph", max_depth=depth, max_leaf_size=size, counters=True)
            tracer.count_hits(origins, directions)
            total = tracer.counters.total
            expected.append(tracer.structure.quality()["cost"])
            counted.append(
                prices["crossing_cost"] * total["steps"]
                + prices["intersection_cost"] * total["tests"]
                + prices["link_cost"] * total["link_nodes"]
            )
    ranks = [np.argsort(np.argsort(numbers)) for numbers in (expected, counted)]
    assert np.corrcoef(*ranks)[0, 1] > 0.9


def test_options_are_checked():
    for options, message in (
        ({"crossing_cost": 0.0}, "crossing_cost: expected 1e-6 to 1e6"),
        ({"link_cost": -1.0}, "link_cost: expected 0 to 1e6"),
        ({"max_depth": 65}, "max_depth: expected 0 to 64"),
        ({"max_leaf_size": 0}, "max_leaf_size: expected 1 to 1024"),
        ({"intersection_cost": np.nan}, "intersection_cost: expected 1e-6"),
    ):
        with pytest.raises(ValueError, match=message):
            rs.Tracer(rs.Scene(), "graph", **options)


def test_rays_of_no_length_are_in_no_sector():
    structure = graph_of("one_triangle")
    none = np.zeros((0, 3), np.float32)
    empty = LocalRays(none, none, np.zeros(0, np.float32), np.zeros(0, np.float32))
    assert structure.start_sectors(empty).rows.shape == (0,)


def test_a_graph_is_dumped_as_text(tmp_path):
    structure = graph_of("closed_mesh")
    structure.dump(tmp_path / "graph.txt")
    expected = io.StringIO()
    dump_graph(expected, structure.graph, structure.triangles.corners)
    assert (tmp_path / "graph.txt").read_text() == expected.getvalue()
    assert [path.name for path in tmp_path.iterdir()] == ["graph.txt"]


# ---- Displacement: hits carry their sector, and rays that leave them begin there.


def bounces(tracer, rng, count=3000):
    """Hits of rays into a scene, and rays that leave them."""
    low, high = tracer.scene.bounds
    origins = rng.uniform(low, high, (count, 3))
    hits = tracer.first_hit(origins, rng.normal(size=(count, 3)))
    return hits, hits.spawn(rng.normal(size=(count, 3)))


@pytest.mark.parametrize("name", ["spheres", "cornell"])
def test_hits_carry_the_sector_in_which_they_are(name, rng):
    tracer = rs.Tracer(rs.load(name), "graph", crossing_cost=2.0)
    low, high = tracer.scene.bounds
    origins, directions = rng.uniform(low, high, (2000, 3)), rng.normal(size=(2000, 3))
    hits = tracer.first_hit(origins.reshape(40, 50, 3), directions.reshape(40, 50, 3))
    assert hits.sectors.shape == (40, 50)
    assert hits.sectors.dtype == np.int32
    assert np.array_equal(hits.sectors >= 0, hits.is_hit)
    structure = tracer.structure
    rays = local_rays(structure, origins, directions)
    # Distances in the local frame, where directions are scaled by a power of two.
    scale = np.linalg.norm(rays.directions, axis=1) / np.linalg.norm(directions, axis=1)
    is_hit = hits.is_hit.ravel()
    t = np.where(is_hit, hits.t.ravel() / scale * structure.triangles.scale**-1, 0.0)
    rows = structure.start_sectors(rays, t.astype(np.float32)).rows
    same = rows[is_hit] == SECTOR_ROWS * hits.sectors.ravel()[is_hit]
    assert same.mean() > 0.99  # rounding of t above
    assert len(np.unique(hits.sectors)) > 3
    one = hits[3, ::2]
    assert np.array_equal(one.sectors, hits.sectors[3, ::2])


@pytest.mark.parametrize("name", ["spheres", "cornell"])
def test_a_known_sector_changes_no_answer(name, rng):
    tracer = rs.Tracer(rs.load(name), "graph", crossing_cost=2.0)
    hits, rays = bounces(tracer, rng)
    count = tracer.structure.sector_count
    expected, seen = tracer.first_hit(*rays), tracer.any_hit(*rays, t_max=0.5)
    anywhere = rng.integers(-1, count, len(hits.t))
    for near in (hits.sectors, anywhere, np.int64(-1), [count - 1], anywhere.astype(np.uint8) % 2):
        found = tracer.first_hit(*rays, near=near)
        for column in ("t", "u", "v", "prim_id", "status", "sectors"):
            assert_same_bits(getattr(found, column), getattr(expected, column))
        assert_same_bits(tracer.any_hit(*rays, t_max=0.5, near=near), seen)
    counting = rs.Tracer.of_structure(tracer.structure, tracer.scene, counters=True)
    totals = []
    for near in (None, hits.sectors):
        assert_same_bits(counting.first_hit(*rays, near=near).t, expected.t)
        totals.append(counting.counters.total)
    assert totals[0] == totals[1]


@kernel
def begin_near(graph, max_coordinate, rays, last, rows):
    """The sector of each ray by `near_sector`; `last` is cleared before each."""
    o, d = rays.origins, rays.directions
    for i in range(np.uint64(len(rows))):
        last[i, 0] = last[i, 1] = 0
        ray = prepare_ray(o[i], d[i], max_coordinate)
        is_active, t_in, _ = clip_to_scene(graph, ray, rays.t_min[i], rays.t_max[i])
        rows[i] = NOWHERE
        if is_active:
            at = address(last) + i * np.uint64(16)
            sector = near_sector(graph, sector_ray(ray), ray, t_in, i, at)
            rows[i] = SECTOR_ROWS * np.int64(sector_number(graph, sector))


def test_bins_are_used_only_where_no_sector_near_is_known(rng):
    tracer = rs.Tracer(rs.load("spheres"), "graph", crossing_cost=2.0)
    structure = tracer.structure
    hits, (origins, directions) = bounces(tracer, rng)
    kept = hits.is_hit
    rays = local_rays(structure, origins[kept], directions[kept])
    near = np.where(rng.random(kept.sum()) < 0.3, -1, hits.sectors[kept]).astype(np.int32)
    graph = structure.view._replace(starts=np.uint64(near.ctypes.data))
    rows, last = np.empty(len(near), np.int64), np.ones((len(near), 2), np.uint64)
    begin_near(graph, np.float32(structure.triangles.max_coordinate), rays, last, rows)
    np.testing.assert_array_equal(rows, structure.start_sectors(rays).rows)
    uses_bin = last[:, 0] != 0
    active = rows >= 0
    assert (uses_bin[active] == (near[active] < 0)).mean() > 0.99


@pytest.mark.parametrize(
    ("options", "near", "error", "words"),
    [
        (
            {"structure": "bvh"},
            [0],
            ValueError,
            "near: expected None, since only structure='graph'",
        ),
        ({"machine": "multipass"}, [0], ValueError, "near: expected None"),
        ({}, [0.5], TypeError, "near: expected integers, got float64"),
        ({}, [-2], ValueError, "near: expected -1 to"),
        ({}, [10**6], ValueError, "near: expected -1 to"),
        ({}, [0, 0, 0], ValueError, r"near: shape \(3,\) does not broadcast to .* shape \(2,\)"),
    ],
)
def test_known_sectors_are_checked(options, near, error, words):
    tracer = rs.Tracer(rs.load("cornell"), **{"structure": "graph", **options})
    with pytest.raises(error, match=words):
        tracer.first_hit(np.zeros((2, 3)), np.ones((2, 3)), near=near)
    with pytest.raises(error, match=words):
        tracer.any_hit(np.zeros((2, 3)), np.ones((2, 3)), near=near)


def test_only_the_graph_s_branching_machine_knows_sectors():
    scene = rs.load("cornell")
    for options in ({"structure": "kdtree"}, {"structure": "graph", "machine": "multipass"}):
        hits = rs.Tracer(scene, **options).first_hit(np.zeros((2, 3)), np.ones((2, 3)))
        assert hits.sectors is None
        assert hits[0].sectors is None


@pytest.mark.parametrize("mode", ["ao", "kajiya"])
def test_renderers_begin_where_their_rays_leave(mode, monkeypatch):
    """Every secondary ray knows its sector, and images have the bits of other structures."""
    scene = rs.load("spheres")
    known = []

    def watch(name):
        original = getattr(rs.Tracer, name)

        def query(self, *rays, near=None, **options):
            known.append((name, rays[0].size // 3, near))
            return original(self, *rays, near=near, **options)

        monkeypatch.setattr(rs.Tracer, name, query)

    watch("first_hit")
    watch("any_hit")
    options = {"size": (24, 16), "samples": 1, "seed": 3, "lights": "file"}
    image = rs.render(scene, mode, structure="graph", **options)
    primary = [(query, count) for query, count, near in known if near is None]
    assert {query for query, _ in primary} == {"first_hit"}
    assert sum(count for _, count in primary) == 24 * 16 + 24  # the first row compiles
    later = [near for *_, near in known if near is not None]
    assert sum(map(len, later)) > 24 * 16
    assert all((near >= 0).all() for near in later)
    expected = rs.render(scene, mode, structure="bvh", **options)
    assert_same_bits(image.pixels, expected.pixels)

"""Walks through the graph of sectors: start sectors, steps and cost."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import raystream as rs
from cases import CASES
from raystream.core.rays import RayBatch
from raystream.jit.cpu import kernel
from raystream.kernels.local_frame import LocalRays
from raystream.kernels.ray import prepare_ray
from raystream.machines.ray_block import blocks
from raystream.structures.graph.layout import SECTOR_ROWS
from raystream.structures.graph.locate import MAX_WALK
from raystream.structures.graph.steps import (
    clip_to_scene,
    exit_face,
    follow_link,
    sector_ray,
    start_sector,
    walk_to,
)
from raystream.structures.graph.text_format import load_graph

NOWHERE = np.int64(-1)
ROW_BYTES = np.uint64(16)
SECTOR_BYTES = np.uint64(16 * SECTOR_ROWS)


@kernel
def holders(graph, sector_count, max_coordinate, rays, t, rows, counts):
    """For each ray, a sector that contains it at t, and their number, by testing all sectors."""
    o, d = rays.origins, rays.directions
    for i in range(len(t)):
        ray = prepare_ray(o[i, 0], o[i, 1], o[i, 2], d[i, 0], d[i, 1], d[i, 2], max_coordinate)
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
    ray = prepare_ray(o[i, 0], o[i, 1], o[i, 2], d[i, 0], d[i, 1], d[i, 2], max_coordinate)
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
            arguments = structure.arrays, graph.sector_count, max_coordinate, rays, t
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
        count = follow(structure.arrays, max_coordinate, rays, i, most, rows, ends)
        assert count < most
        assert (np.diff(ends[:count]) >= 0).all()
        assert len(np.unique(rows[:count])) == count
        longest = max(longest, count)
    assert longest > 3


@settings(max_examples=40, deadline=None)
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
    with (tmp_path / "graph.txt").open() as file:
        graph, corners = load_graph(file)
    for name in ("rows", "prim_ids", "bins"):
        np.testing.assert_array_equal(getattr(graph, name), getattr(structure.graph, name))
    np.testing.assert_array_equal(corners, structure.triangles.corners)
    assert [path.name for path in tmp_path.iterdir()] == ["graph.txt"]

"""What is made of hits of instances of any kind: filters, worlds, files, views, walks, counters."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import raystream as rs
from placed_scenes import rays, rows_of, transforms
from raystream.stepper import walk

COUNT = 9
OBJECT_IDS = np.arange(COUNT) % 3
WORLDS = np.arange(COUNT) % 3 - 1
MASKS = np.array([0, 0, 8, 0, 2, 0, 16, 1, 0], np.uint32)
COLUMNS = ("t", "u", "v", "prim_id", "instance_id", "mesh_id", "positions", "normals")
CAMERA = rs.Camera((0.0, 0.0, 14.0), (0.0, 0.0, 0.0), fov=50.0)

KINDS = ("mixed", "float64")


def _soup(rng: Any, count: int) -> rs.Scene:
    """Triangles of two meshes, with a mask each."""
    vertices, faces = rng.normal(size=(60, 3)), rng.integers(0, 60, (count, 3))
    half = count // 2
    return rs.Scene(
        [rs.Mesh(vertices, faces[:half], mask=1), rs.Mesh(vertices, faces[half:], mask=6)]
    )


@cache
def objects(kind: str) -> tuple[rs.Scene, ...]:
    rng = np.random.default_rng(4)
    if kind == "float64":
        return _soup(rng, 40), _soup(rng, 20), _soup(rng, 10)
    balls = rs.Scene.spheres(rng.normal(size=(20, 3)), rng.uniform(0.1, 0.5, 20), mask=5)
    heights = rng.normal(size=(6, 5))
    heights[2, 2] = np.nan
    field = rs.Scene.height_field(heights, origin=(-2, -2, 0), spacing=0.8, mask=2)
    return balls, rs.Scene.combine([_soup(rng, 20), field, balls]), _soup(rng, 30)


def scene(kind: str, rows: Any = slice(None), even: bool = False, **options: Any) -> rs.Scene:
    """Some of the instances; `options` of `Scene.instances`."""
    return rs.Scene.instances(
        objects(kind), transforms(COUNT, even=even)[rows], OBJECT_IDS[rows], **options
    ).replace(camera=CAMERA)


def tracer(kind: str, structure: str = "bvh", counters: bool = False, **options: Any) -> rs.Tracer:
    precision: Any = "float64" if kind == "float64" else "float32"
    return rs.Tracer(scene(kind, **options), structure, precision=precision, counters=counters)


@cache
def in_worlds(kind: str, structure: str = "bvh") -> rs.Tracer:
    return tracer(kind, structure, worlds=WORLDS, masks=MASKS)


def alone(kind: str) -> tuple[rs.Tracer, np.ndarray]:
    """A tracer of the instances in world 1, and their numbers."""
    rows = np.flatnonzero(np.isin(WORLDS, [-1, 1]))
    return tracer(kind, rows=rows, masks=MASKS[rows]), rows


def small(tables: Any) -> np.ndarray:
    """Which hits a filter keeps: `kept` has the same rule."""
    found: np.ndarray = (tables.u > 0.3) & (tables.instance_id != 3)
    found &= (tables.prim_id + tables.mesh_id) % 3 != 1
    return found


def kept(hit: Any) -> bool:
    is_kept: bool = hit.u > 0.3 and hit.instance_id != 3 and (hit.prim_id + hit.mesh_id) % 3 != 1
    return is_kept


def _masks_of(every: rs.MultiHits, kind: str) -> np.ndarray:
    """The mask of each hit."""
    of_meshes = [1, 6] * (3 if kind == "float64" else 2)
    masks = np.array([*of_meshes, *([] if kind == "float64" else [2, 5])], np.uint32)
    placed = MASKS[every.instance_id]
    chosen: np.ndarray = np.where(placed > 0, placed, masks[every.mesh_id])
    return chosen


@pytest.mark.parametrize("structure", ["bvh", "brute"])
@pytest.mark.parametrize("kind", KINDS)
def test_filters_masks_and_skips_choose_among_all_hits(kind: str, structure: str) -> None:
    made, (origins, directions) = in_worlds(kind, structure), rays(800)
    rng = np.random.default_rng(7)
    worlds = rng.integers(0, 2, 800)
    every = made.multi_hit(origins, directions, worlds=worlds)
    rows, ids = rows_of(every), every.ray_id
    masks = rng.integers(0, 32, 800).astype(np.uint32)
    skipped = rng.integers(-1, 60, (800, 3))
    first = made.first_hit(origins, directions, worlds=worlds)
    of_hits = _masks_of(every, kind)
    is_masked = of_hits & masks[ids] > 0
    is_skipped = (skipped[ids] == every.prim_id[:, None]).any(axis=1)
    is_first = (first.prim_id[ids] == every.prim_id) & (first.instance_id[ids] == every.instance_id)
    cases: list[tuple[np.ndarray, dict[str, Any]]] = [
        (of_hits & 3 > 0, {"mask": 3}),
        (is_masked, {"mask": masks}),
        (~is_skipped, {"skip_prim_ids": skipped}),
        (~is_first, {"skip_prim_ids": first}),
        (small(every), {"on_hit": kept}),
        (
            small(every) & is_masked & ~is_skipped,
            {"on_hit": kept, "mask": masks, "skip_prim_ids": skipped},
        ),
    ]
    for keeps, given in cases:
        assert 100 < keeps.sum() < len(rows)
        wanted = [row for row, keep in zip(rows, keeps, strict=True) if keep]
        options = {**given, "worlds": worlds}
        assert rows_of(made.multi_hit(origins, directions, **options)) == wanted
        counts = np.bincount(ids[keeps], minlength=800)
        np.testing.assert_array_equal(made.count_hits(origins, directions, **options), counts)
        np.testing.assert_array_equal(made.any_hit(origins, directions, **options), counts > 0)
        nearest = {row[0]: row for row in reversed(wanted)}
        hits = made.first_hit(origins, directions, **options)
        np.testing.assert_array_equal(hits.is_hit, counts > 0)
        columns = hits.t.tolist(), hits.instance_id.tolist(), hits.prim_id.tolist()
        for ray, row in nearest.items():
            assert tuple(one[ray] for one in columns) == row[1:]
        few = made.multi_hit(origins, directions, max_hits=2, **options)
        places = np.arange(keeps.sum()) - np.repeat(np.cumsum(counts) - counts, counts)
        assert rows_of(few) == [row for row, k in zip(wanted, places, strict=True) if k < 2]


@pytest.mark.parametrize("kind", KINDS)
def test_one_world_is_a_scene_of_its_instances(kind: str) -> None:
    made, (own, numbers) = in_worlds(kind), alone(kind)
    world = made.in_world(1)
    origins, directions = rays(400)
    hits, wanted = (one.multi_hit(origins, directions) for one in (world, own))
    for name in COLUMNS:
        np.testing.assert_array_equal(getattr(hits, name), getattr(wanted, name), name)
    there = made.multi_hit(origins, directions, worlds=1)
    np.testing.assert_array_equal(there.t, wanted.t)
    np.testing.assert_array_equal(there.instance_id, numbers[wanted.instance_id])
    first = own.first_hit(origins, directions)
    for k in range(20):
        for found in (
            made.cast(origins[k], directions[k], world=1),
            walk(world, origins[k], directions[k]),
        ):
            assert (found.t, found.prim_id) == (first.t[k], first.prim_id[k])
    points = origins / 4.0
    numbers_there = made.winding_number(points, worlds=np.ones(400, int))
    np.testing.assert_allclose(numbers_there, own.winding_number(points), atol=1e-6)
    np.testing.assert_array_equal(world.winding_number(points), own.winding_number(points))
    for measure in (rs.visible_faces, rs.view_factors):
        given: dict[str, Any] = {"rays": 64} if measure is rs.view_factors else {"size": (40, 30)}
        for one, other in zip(measure(world, **given), measure(own, **given), strict=True):
            np.testing.assert_array_equal(one, other)
    pictures = [rs.render(one, "raycast", size=(20, 15)).pixels for one in (world, own)]
    np.testing.assert_array_equal(*pictures)
    returns = rs.lidar_returns(made, origins, directions, worlds=1)
    alone_returns = rs.lidar_returns(own, origins, directions)
    np.testing.assert_array_equal(returns.ranges, alone_returns.ranges)
    np.testing.assert_array_equal(returns.incidence_angle, alone_returns.incidence_angle)
    depth = rs.thickness(made, origins, directions, worlds=1, nested="inner")
    alone_depth = rs.thickness(own, origins, directions, nested="inner")
    np.testing.assert_array_equal(depth.t_exit, alone_depth.t_exit)
    np.testing.assert_array_equal(depth.instance_id, numbers[alone_depth.instance_id])


@pytest.mark.parametrize("kind", KINDS)
def test_lidar_measures_angles_to_normals(kind: str) -> None:
    own, _ = alone(kind)
    origins, directions = rays(400)
    returns, hits = rs.lidar_returns(own, origins, directions), own.first_hit(origins, directions)
    length = np.linalg.norm(directions, axis=1)
    cosine = np.abs(np.einsum("ij,ij->i", hits.normals, directions)) / length
    rows = returns.ray_id
    np.testing.assert_allclose(np.cos(np.radians(returns.incidence_angle)), cosine[rows], atol=1e-5)
    np.testing.assert_allclose(returns.ranges, (hits.t * length)[rows], rtol=1e-5)


@pytest.mark.parametrize("kind", KINDS)
def test_files_have_the_same_hits_and_masks(kind: str, tmp_path: Path) -> None:
    origins, directions = rays(400)
    made = in_worlds(kind)
    made.save(tmp_path / "a.npz")
    for given in (None, made.scene):
        loaded = rs.Tracer.load(tmp_path / "a.npz", given)
        for options in ({"worlds": 1}, {"worlds": 0, "mask": 3}):
            hits, wanted = (one.multi_hit(origins, directions, **options) for one in (loaded, made))
            for name in COLUMNS:
                np.testing.assert_array_equal(getattr(hits, name), getattr(wanted, name), name)


@pytest.mark.parametrize("kind", KINDS)
def test_what_is_seen_is_what_the_flattened_scene_shows(kind: str) -> None:
    made = tracer(kind, even=True)
    flat = rs.Tracer(made.scene.flattened(), precision=made.structure.precision)
    for size in ((128, 96), (16, 12)):
        one, other = (rs.visible_faces(x, CAMERA, size) for x in (made, flat))
        assert len(one.prim_ids) == len(other.prim_ids) > 20
        np.testing.assert_array_equal(np.sort(one.pixel_counts), np.sort(other.pixel_counts))
    origins, directions = rays(300)
    hits = [x.first_hit(origins, directions) for x in (made, flat)]
    both = hits[0].is_hit & hits[1].is_hit
    both[both] = np.abs(hits[0].t[both] - hits[1].t[both]) < 1e-4
    held = [one[both] for one in hits]
    for ends in ([origins[:60]] * 2, held):
        seen = [
            rs.visibility(x, own[:50], end)
            for x, own, end in zip((made, flat), held, ends, strict=True)
        ]
        assert 0.1 < seen[0].mean() < 0.9
        assert np.mean(seen[0] != seen[1]) < 1e-3


@pytest.mark.parametrize("kind", KINDS)
def test_counters_count_what_is_searched(kind: str) -> None:
    origins, directions = rays(400)
    tree, brute = (tracer(kind, one, counters=True) for one in ("bvh", "brute"))
    counts = [one.count_hits(origins, directions) for one in (tree, brute)]
    np.testing.assert_array_equal(*counts)
    store: Any = tree.structure.triangles
    least = store.first_ids[-1] * 400
    assert brute.counters.total["tests"] >= (least if kind == "float64" else least // 2)
    assert 0 < tree.counters.total["tests"] < least // 4
    x, y = np.arange(20) + 0.5, np.arange(15)[:, None] + 0.5
    heat = rs.heatmap(tree, "tests", size=(20, 15))
    tree.first_hit(*CAMERA.rays(20, 15, x, y))
    assert heat.counts.sum() == tree.counters.total["tests"] > 0

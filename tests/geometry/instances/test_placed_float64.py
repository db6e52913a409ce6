"""Instances with precision="float64": the answers of each object alone, in world order."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest

import raystream as rs
from meshes import icosphere
from placed_scenes import rays, rows_of, transforms

STRUCTURES = ("bvh", "brute")
COLUMNS = ("t", "u", "v", "prim_id", "instance_id", "mesh_id")


@cache
def objects() -> tuple[rs.Scene, rs.Scene]:
    rng = np.random.default_rng(4)
    soups = (
        rs.Scene.from_arrays(rng.normal(size=(60, 3)), rng.integers(0, 60, (count, 3)))
        for count in (40, 20)
    )
    first, second = soups
    return first, second


@cache
def scene() -> rs.Scene:
    return rs.Scene.instances(objects(), transforms(9), np.arange(9) % 2)


@cache
def tracer(structure: str = "bvh") -> rs.Tracer:
    return rs.Tracer(scene(), structure, precision="float64")


def products(matrix: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """The products in the order of kernels, so that the bits are the same."""
    x, y, z = vectors.T
    rows = (x * row[0] + y * row[1] + z * row[2] for row in matrix)
    return np.stack(list(rows), axis=1)


def test_hits_have_the_bits_of_the_objects_alone() -> None:
    origins, directions = rays(2000)
    placed: Any = scene().placements
    alone = [rs.Tracer(one, precision="float64") for one in objects()]
    wanted = []
    for k in range(9):
        back = placed.inverses[k]
        moved = products(back[:, :3], origins) + back[:, 3], products(back[:, :3], directions)
        own = alone[k % 2].multi_hit(*moved)
        prims = own.prim_id + 40 * (k % 2)
        columns = own.ray_id, own.t, np.full(len(prims), k), prims
        wanted += zip(*(one.tolist() for one in columns), strict=True)
    assert len(wanted) > 2000
    assert rows_of(tracer().multi_hit(origins, directions)) == sorted(wanted)


def test_structures_agree_to_the_bit_in_every_query() -> None:
    origins, directions = rays(1500)
    bvh, brute = tracer("bvh"), tracer("brute")
    # One of the limits is a distance: both ends are included.
    t = bvh.first_hit(origins, directions).t
    limits = {"t_min": 0.2, "t_max": np.where(np.isfinite(t), t, 1.5)}
    for given in ({}, limits):
        first, other = (one.first_hit(origins, directions, **given) for one in (bvh, brute))
        rows, others = (one.multi_hit(origins, directions, **given) for one in (bvh, brute))
        for name in COLUMNS:
            np.testing.assert_array_equal(getattr(first, name), getattr(other, name))
            np.testing.assert_array_equal(getattr(rows, name), getattr(others, name))
        for one in (bvh, brute):
            np.testing.assert_array_equal(one.any_hit(origins, directions, **given), first.is_hit)
            np.testing.assert_array_equal(one.count_hits(origins, directions, **given), rows.counts)
        starts = rows.ray_splits[:-1][first.is_hit]
        np.testing.assert_array_equal(rows.t[starts], first.t[first.is_hit])
    np.testing.assert_array_equal(first.t[first.is_hit], t[first.is_hit])


def test_the_flattened_scene_is_within_rounding() -> None:
    origins, directions = rays(2000)
    flat = rs.Tracer(scene().flattened(), precision="float64")
    found, wanted = (one.first_hit(origins, directions) for one in (tracer(), flat))
    np.testing.assert_array_equal(found.is_hit, wanted.is_hit)
    hit = found.is_hit
    assert found.t.dtype == np.float64
    np.testing.assert_allclose(found.t[hit], wanted.t[hit], rtol=1e-11)
    np.testing.assert_allclose(found.positions[hit], wanted.positions[hit], atol=1e-11)
    np.testing.assert_allclose(found.normals[hit], wanted.normals[hit], atol=1e-11)


@pytest.mark.parametrize("structure", STRUCTURES)
def test_equal_hits_are_ordered_by_instance_then_triangle(structure: str) -> None:
    square = rs.Scene.from_arrays([[-1, -1, 5], [3, -1, 5], [-1, 3, 5]], [[0, 1, 2], [0, 1, 2]])
    same = np.tile(np.eye(4)[:3], (3, 1, 1))
    made = rs.Scene.instances(square, same)
    hits = rs.Tracer(made, structure, precision="float64").multi_hit([0, 0, 0], [0, 0, 1])
    assert hits.t.tolist() == [5.0] * 6
    assert hits.instance_id.tolist() == [0, 0, 1, 1, 2, 2]
    assert hits.prim_id.tolist() == [0, 1] * 3


def test_rays_leave_triangles() -> None:
    hits = tracer().first_hit(*rays(2000))
    held = hits[hits.is_hit]
    away = np.random.default_rng(5).normal(size=(len(held.t), 3))
    again = tracer().multi_hit(*held.spawn(away))
    same = (again.prim_id == held.prim_id[again.ray_id]) & (
        again.instance_id == held.instance_id[again.ray_id]
    )
    assert not same.any()


def test_unit_lengths_do_not_matter_far_from_the_origin() -> None:
    """Instances as far as Earth's radius keep what float32 would lose."""
    ball = rs.Scene([rs.Mesh(*icosphere(2))])
    far = np.tile(np.eye(4)[:3], (2, 1, 1))
    far[:, 0, 3] = [6.4e6, 6.4e6 + 4.0]
    made = rs.Tracer(rs.Scene.instances(ball, far), precision="float64")
    for length in (1.0, 1e-3, 2.0**300):
        hits = made.multi_hit([6.4e6 - 5.0, 0.1, 0.2], [length, 0, 0])
        alone = rs.Tracer(ball, precision="float64").multi_hit([-5.0, 0.1, 0.2], [length, 0, 0])
        assert len(hits.t) == 4
        np.testing.assert_allclose(hits.t[:2], alone.t, rtol=1e-9)
        np.testing.assert_allclose(hits.t[2:] - hits.t[:2], 4.0 / length, rtol=1e-9)
    assert made.first_hit([0, 0, 0], [2.0**600, 0, 0]).status == rs.RayStatus.INVALID


def test_filters_and_worlds() -> None:
    origins, directions = rays(800)
    every = tracer().multi_hit(origins, directions)
    cosine = np.einsum("ij,ij->i", every.normals, directions[every.ray_id])

    def entries(hit: Any) -> bool:
        return hit.is_entering and hit.instance_id != 3

    found = tracer().multi_hit(origins, directions, on_hit=entries)
    kept = (cosine < 0.0) & (every.instance_id != 3)
    assert rows_of(found) == [row for row, keep in zip(rows_of(every), kept, strict=True) if keep]
    worlds = np.arange(9) // 3 - 1
    placed: Any = scene().placements
    made = rs.Scene.instances(objects(), placed.transforms, np.arange(9) % 2, worlds=worlds)
    own = rs.Tracer(made, precision="float64").multi_hit(origins, directions, worlds=1)
    kept = np.isin(worlds[every.instance_id], [-1, 1])
    assert rows_of(own) == [row for row, keep in zip(rows_of(every), kept, strict=True) if keep]


def test_thickness_of_scaled_balls() -> None:
    ball = rs.Scene([rs.Mesh(*icosphere(3))])
    places = np.zeros((2, 3, 4))
    places[0, :, :3], places[1, :, :3] = np.diag([2.0, 1.0, 1.0]), np.diag([-1.0, 3.0, 1.0])
    places[1, 0, 3] = 10.0
    made = rs.Tracer(rs.Scene.instances(ball, places), precision="float64")
    found = rs.thickness(made, [-10.0, 0.01, 0.02], [1.0, 0, 0])
    assert found.instance_id.tolist() == [0, 1]
    np.testing.assert_allclose(found.t_exit - found.t_entry, [4.0, 2.0], rtol=0.02)


@pytest.mark.parametrize("size", [1.0, 1000.0])
def test_images_with_lamps_are_those_in_float32(size: float) -> None:
    box = rs.load("cornell")
    place = np.eye(4)[:3] * [size, size, size, 1.0]
    eye, target = (np.array(one) * size for one in (box.camera.eye, box.camera.look_at))
    camera = rs.Camera(tuple(eye), tuple(target), fov=box.camera.fov)
    made = rs.Scene.instances([box], place[None], camera=camera)
    wide, narrow = (
        rs.render(
            rs.Tracer(made, precision=one), "path", size=(24, 24), samples=64, layers=["depth"]
        )
        for one in ("float64", "float32")
    )
    np.testing.assert_allclose(wide.pixels.mean(), narrow.pixels.mean(), rtol=1e-3)
    np.testing.assert_allclose(wide.layers["depth"], narrow.layers["depth"], rtol=1e-4)

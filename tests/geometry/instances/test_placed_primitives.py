"""Instances of spheres and height fields: values, ids, ties, and what is derived from hits."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest

import raystream as rs
from placed_scenes import rays, rows_of, transforms

STRUCTURES = ("bvh", "brute")


@cache
def objects() -> tuple[rs.Scene, ...]:
    """Spheres; spheres, a field with holes and triangles; and triangles alone."""
    rng = np.random.default_rng(1)
    balls = rs.Scene.spheres(rng.normal(size=(20, 3)), rng.uniform(0.1, 0.5, 20))
    heights = rng.normal(size=(6, 5))
    heights[2, 2] = np.nan
    field = rs.Scene.height_field(heights, origin=(-2, -2, 0), spacing=0.8)
    mesh = rs.Scene.from_arrays(rng.normal(size=(30, 3)), rng.integers(0, 30, (20, 3)))
    return balls, rs.Scene.combine([mesh, field, balls]), mesh


@cache
def mixed(even: bool = False) -> rs.Scene:
    return rs.Scene.instances(objects(), transforms(9, even=even), np.arange(9) % 3)


@pytest.mark.parametrize("structure", STRUCTURES)
def test_hits_are_those_of_the_objects_alone(structure: str) -> None:
    scene, (origins, directions) = mixed(), rays(1500)
    placed: Any = scene.placements
    found = rs.Tracer(scene, structure).multi_hit(origins, directions)
    # prim_id counts all triangles, then those of fields, then spheres.
    mesh = objects()[2].triangle_count
    firsts = {0: [0, 0, 2 * mesh + 40], 1: [0, 2 * mesh, 2 * mesh + 60], 2: [mesh, 0, 0]}
    wanted = []
    for k in range(9):
        back = placed.inverses[k]
        own = rs.Tracer(objects()[k % 3], structure).multi_hit(
            origins @ back[:, :3].T + back[:, 3], directions @ back[:, :3].T
        )
        store: Any = own._triangles
        counts = np.cumsum([0, *store.part_counts])
        part = np.searchsorted(counts[1:], own.prim_id, side="right")
        prims = own.prim_id - counts[part] + np.array(firsts[k % 3])[part]
        columns = own.ray_id, own.t, np.full(len(prims), k), prims
        wanted += zip(*(one.tolist() for one in columns), strict=True)
    wanted.sort()
    assert len(wanted) > 1000
    assert [(row[0], *row[2:]) for row in rows_of(found)] == [(row[0], *row[2:]) for row in wanted]
    np.testing.assert_allclose(found.t, [row[1] for row in wanted], rtol=3e-6)


def test_structures_agree_to_the_bit_in_every_query() -> None:
    origins, directions = rays(1500)
    bvh, brute = (rs.Tracer(mixed(), one) for one in STRUCTURES)
    limits = {"t_min": 0.5, "t_max": np.linspace(0.6, 1.5, 1500)}
    for given in ({}, limits):
        first, other = (one.first_hit(origins, directions, **given) for one in (bvh, brute))
        rows, others = (one.multi_hit(origins, directions, **given) for one in (bvh, brute))
        for name in ("t", "u", "v", "prim_id", "instance_id", "mesh_id", "material_id"):
            np.testing.assert_array_equal(getattr(first, name), getattr(other, name))
            np.testing.assert_array_equal(getattr(rows, name), getattr(others, name))
        for one in (bvh, brute):
            np.testing.assert_array_equal(one.any_hit(origins, directions, **given), first.is_hit)
            np.testing.assert_array_equal(one.count_hits(origins, directions, **given), rows.counts)
        starts = rows.ray_splits[:-1][first.is_hit]
        np.testing.assert_array_equal(rows.t[starts], first.t[first.is_hit])
    cast = [bvh.cast(origins[i], directions[i]) for i in range(50)]
    assert [(one.t, one.prim_id, one.instance_id) for one in cast] == [
        (first.t[i], first.prim_id[i], first.instance_id[i])
        for first in [bvh.first_hit(origins[:50], directions[:50])]
        for i in range(50)
    ]


def test_stretched_spheres_are_ellipsoids() -> None:
    ball = rs.Scene.spheres([[1.0, 2.0, 3.0]], 0.5)
    matrices = transforms(40, seed=7)
    tracer = rs.Tracer(rs.Scene.instances(ball, matrices))
    origins, directions = rays(4000)
    hits = tracer.multi_hit(origins, directions)
    assert len(hits.t) > 500
    # Points satisfy |inverse(p) - c| = r, and normals are the gradients of that.
    placed: Any = tracer.scene.placements
    back = placed.inverses[hits.instance_id]
    points = origins[hits.ray_id] + hits.t[:, None].astype(float) * directions[hits.ray_id]
    inside = np.einsum("kij,kj->ki", back[:, :, :3], points) + back[:, :, 3] - [1.0, 2.0, 3.0]
    np.testing.assert_allclose(np.linalg.norm(inside, axis=1), 0.5, atol=2e-5)
    gradient = np.einsum("kji,kj->ki", back[:, :, :3], inside)
    gradient /= np.linalg.norm(gradient, axis=1, keepdims=True)
    np.testing.assert_allclose(hits.normals, gradient, atol=2e-4)
    np.testing.assert_allclose(hits.positions, points, atol=1e-4)
    # Entries come before exits, in pairs.
    entering = np.einsum("ij,ij->i", hits.normals, directions[hits.ray_id]) < 0.0
    assert abs(int(entering.sum()) * 2 - len(entering)) <= 4


def test_flattened_scenes_have_the_same_hits() -> None:
    scene = mixed(even=True)
    flat = scene.flattened()
    assert flat.placements is None
    assert flat.has_primitives
    origins, directions = rays(2000)
    found, wanted = (rs.Tracer(one).first_hit(origins, directions) for one in (scene, flat))
    same = found.is_hit == wanted.is_hit
    assert same.mean() > 0.998
    both = found.is_hit & wanted.is_hit
    np.testing.assert_allclose(found.t[both], wanted.t[both], rtol=2e-4)
    close = np.einsum("ij,ij->i", found.normals[both], wanted.normals[both])
    assert np.mean(close > 0.999) > 0.99
    with pytest.raises(ValueError, match="instance 0 makes ellipsoids"):
        mixed().flattened()


def test_equal_hits_are_ordered_by_instance_then_primitive() -> None:
    ball = rs.Scene.spheres([[0, 0, 5], [0, 0, 5]], 1.0)
    same = np.tile(np.eye(4)[:3], (3, 1, 1))
    for structure in STRUCTURES:
        hits = rs.Tracer(rs.Scene.instances(ball, same), structure).multi_hit([0, 0, 0], [0, 0, 1])
        assert hits.t.tolist() == [4.0] * 6 + [6.0] * 6
        assert hits.instance_id.tolist() == [0, 0, 1, 1, 2, 2] * 2
        assert hits.prim_id.tolist() == [0, 1] * 6


def test_rays_leave_spheres_of_instances() -> None:
    tracer = rs.Tracer(mixed())
    hits = tracer.first_hit(*rays(3000))
    held = hits[hits.is_hit & hits.is_on_sphere]
    rng = np.random.default_rng(5)
    away = rng.normal(size=(len(held.t), 3))
    outside = np.einsum("ij,ij->i", held.normals, away) > 0.0
    again = tracer.multi_hit(*held.spawn(away))
    same = (again.prim_id == held.prim_id[again.ray_id]) & (
        again.instance_id == held.instance_id[again.ray_id]
    )
    met = np.bincount(again.ray_id[same], minlength=len(away))
    # Outwards never again, inwards the other side, once.
    assert not met[outside].any()
    assert (met[~outside] == 1).all()


def test_filters_and_skips_see_what_hits_report() -> None:
    tracer = rs.Tracer(mixed())
    origins, directions = rays(1500)
    every = tracer.multi_hit(origins, directions)
    cosine = np.einsum("ij,ij->i", every.normals, directions[every.ray_id])

    def even_entries(hit: Any) -> bool:
        return hit.is_entering and (hit.prim_id + hit.instance_id + hit.mesh_id) % 2 == 0

    found = tracer.multi_hit(origins, directions, on_hit=even_entries)
    kept = (cosine < 0.0) & ((every.prim_id + every.instance_id + every.mesh_id) % 2 == 0)
    assert rows_of(found) == [row for row, keep in zip(rows_of(every), kept, strict=True) if keep]
    first = tracer.first_hit(origins, directions)
    others = tracer.first_hit(origins, directions, skip_prim_ids=first)
    is_other = (others.prim_id != first.prim_id) | (others.instance_id != first.instance_id)
    assert is_other[others.is_hit].all()


def test_masks_of_instances_and_of_their_parts() -> None:
    near = rs.Scene.spheres([[0, 0, 5]], 1.0, mask=1)
    far = rs.Scene.height_field(np.full((2, 2), 9.0), origin=(-1, -1, 0), spacing=2.0, mask=2)
    both = rs.Scene.combine([near, far])
    places = np.tile(np.eye(4)[:3], (2, 1, 1))
    places[1, 2, 3] = 20.0
    scene = rs.Scene.instances(both, places, masks=[0, 4])
    ray = [0.1, 0.2, 0], [0, 0, 1]
    for structure in STRUCTURES:
        tracer = rs.Tracer(scene, structure)
        counts = [tracer.count_hits(*ray, mask=mask).item() for mask in (1, 2, 3, 4, 7)]
        assert counts == [2, 1, 3, 3, 6]


def test_thickness_of_ellipsoids_is_their_chords() -> None:
    tracer = rs.Tracer(mixed())
    origins, directions = rays(400)
    hits = tracer.multi_hit(origins, directions)
    found = rs.thickness(tracer, origins, directions, nested="inner")
    spheres = hits.is_on_sphere
    assert found.mesh_id.max() == hits.mesh_id.max()
    # Each instance's spheres are a solid: its chord is the union of those of its spheres.
    total = np.zeros((400, 9))
    for ray in range(400):
        for k in range(9):
            own = spheres & (hits.ray_id == ray) & (hits.instance_id == k)
            depth, begin = 0, 0.0
            open_ = set()
            for t, prim in zip(hits.t[own].tolist(), hits.prim_id[own].tolist(), strict=True):
                begin = t if depth == 0 else begin
                depth += -1 if prim in open_ else 1
                open_ ^= {prim}
                total[ray, k] += (t - begin) if depth == 0 else 0.0
    both = rs.thickness(rs.Tracer(_spheres_alone()), origins, directions)
    lengths = np.zeros((400, 9))
    of = (both.ray_id, both.instance_id)
    np.add.at(lengths, of, both.t_exit.astype(float) - both.t_entry)
    alone = np.array([0, 3, 6])
    np.testing.assert_allclose(lengths[:, alone], total[:, alone], atol=1e-5)
    assert lengths[:, alone].any()


def _spheres_alone() -> rs.Scene:
    """The mixed scene's instances of spheres, under the same numbers."""
    scene = mixed()
    placed: Any = scene.placements
    far = placed.transforms.copy()
    far[np.arange(9) % 3 > 0, :, 3] += 1e4
    return scene.with_transforms(far)


def test_instances_beside_what_is_placed_once() -> None:
    box = rs.load("cornell")
    forest = rs.Scene.instances(box, np.tile(np.eye(4)[:3], (2, 1, 1)))
    ball = rs.Scene.spheres([[278, 273, 280]], 50.0)
    scene = rs.Scene.combine([forest, ball])
    hits = rs.Tracer(scene).multi_hit([278.0, 273.0, -800.0], [0, 0, 1])
    assert hits.instance_id[hits.is_on_sphere].tolist() == [2, 2]
    assert hits.t[hits.is_on_sphere].tolist() == [1030.0, 1130.0]
    assert set(hits.instance_id.tolist()) == {0, 1, 2}


def test_images_are_those_of_the_flattened_scene() -> None:
    camera = rs.Camera((0.0, 0.0, 14.0), (0.0, 0.0, 0.0), fov=40.0)
    light = rs.DirectionalLight((-1.0, -1.0, -2.0), (3.0, 3.0, 3.0))
    scene = mixed(even=True).replace(camera=camera, lights=[light])
    flat = scene.flattened()
    one, other = (rs.render(rs.Tracer(x), "whitted", size=(64, 48)).pixels for x in (scene, flat))
    assert one.std() > 0.05
    assert np.mean(np.abs(one - other).max(axis=-1) > 0.05) < 0.02


def test_updates_move_instances() -> None:
    tracer = rs.Tracer(mixed())
    origins, directions = rays(500)
    moved = transforms(9, seed=11)
    tracer.update(transforms=moved)
    wanted = rs.Tracer(mixed().with_transforms(moved)).first_hit(origins, directions)
    found = tracer.first_hit(origins, directions)
    np.testing.assert_array_equal(found.t, wanted.t)
    np.testing.assert_array_equal(found.instance_id, wanted.instance_id)


def test_far_origins_meet_the_same_surfaces() -> None:
    origins, directions = rays(500)
    found = rs.Tracer(mixed()).first_hit(origins - 1e6 * directions, directions)
    wanted = rs.Tracer(mixed(), "brute").first_hit(origins - 1e6 * directions, directions)
    np.testing.assert_array_equal(found.t, wanted.t)
    np.testing.assert_array_equal(found.prim_id, wanted.prim_id)


def test_points_are_inside_ellipsoids() -> None:
    tracer = rs.Tracer(mixed())
    points = np.random.default_rng(6).normal(size=(4000, 3)) * 4.0
    placed: Any = tracer.scene.placements
    held: Any = objects()[0].geometry.spheres
    count = np.zeros(len(points))
    for k in (0, 1, 3, 4, 6, 7):
        back = placed.inverses[k]
        own = points @ back[:, :3].T + back[:, 3]
        gaps = np.linalg.norm(own[:, None] - held.centers, axis=2) - held.radii
        count += (gaps < 0.0).sum(axis=1)
    assert (count > 0).sum() > 20
    balls = rs.Scene.instances(objects()[:1], placed.transforms[[0, 1, 3, 4, 6, 7]])
    numbers = rs.Tracer(balls).winding_number(points)
    np.testing.assert_array_equal(numbers, count)
    inside = rs.Tracer(balls, "brute").contains(points, method="rays")
    np.testing.assert_array_equal(inside, count > 0)
    flat = rs.Tracer(mixed(even=True).flattened()).winding_number(points)
    np.testing.assert_allclose(rs.Tracer(mixed(even=True)).winding_number(points), flat, atol=1e-4)

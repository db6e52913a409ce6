"""Thickness and LiDAR of spheres, height fields and triangles in float64."""

from __future__ import annotations

import numpy as np
import pytest

import raystream as rs
from cards import over_ground
from field_rays import mesh_of
from meshes import cube, icosphere


def chords(rng: np.random.Generator, count: int, radius: float) -> tuple[np.ndarray, ...]:
    """Parallel rays along z, and their lengths in a sphere around the origin."""
    origins = np.column_stack(
        [rng.uniform(-1.2 * radius, 1.2 * radius, (count, 2)), np.full(count, -9.0 * radius)]
    )
    square = radius**2 - (origins[:, :2] ** 2).sum(axis=1)
    return origins, 2.0 * np.sqrt(np.maximum(square, 0.0))


def test_the_thickness_of_a_sphere_is_the_length_of_the_chord() -> None:
    origins, wanted = chords(np.random.default_rng(1), 20_000, 2.0)
    tracer = rs.Tracer(rs.Scene.spheres([[0, 0, 0]], 2.0))
    found = rs.thickness(tracer, origins, [0.0, 0.0, 3.0])
    assert found.is_complete.all()
    np.testing.assert_allclose(found.total_length(), wanted, atol=3e-5)
    assert found.mesh_names == ("spheres",)
    assert found.mesh_is_closed.all()


def test_spheres_that_overlap_are_one_solid() -> None:
    tracer = rs.Tracer(rs.Scene.spheres([[0, 0, 0], [0, 0, 1.5], [0, 0, 6]], 1.0))
    found = rs.thickness(tracer, [0, 0, -5], [0, 0, 1])
    assert list(zip(found.t_entry, found.t_exit, strict=True)) == [(4.0, 7.5), (10.0, 12.0)]


def test_rays_that_graze_spheres_are_complete() -> None:
    angles = np.linspace(0.0, 6.0, 5000)
    near = 1.0 - 2.0 ** -np.linspace(20.0, 52.0, 5000)
    origins = np.column_stack([near * np.cos(angles), near * np.sin(angles), np.full(5000, -3.0)])
    found = rs.thickness(rs.Tracer(rs.Scene.spheres([[0, 0, 0]], 1.0)), origins, [0, 0, 1])
    assert found.is_complete.all()


def test_segments_are_clipped_within_spheres() -> None:
    tracer = rs.Tracer(rs.Scene.spheres([[0, 0, 0]], 2.0))
    found = rs.thickness(tracer, [0, 0, 0], [0, 0, 1], t_max=1.0, ends="clip")
    assert found.total_length().item() == 1.0
    assert found.exit_prim_id.tolist() == [-1]


def test_spheres_and_closed_meshes_displace_each_other() -> None:
    mesh = rs.Scene.from_arrays(*icosphere(3))
    ball = rs.Scene.spheres([[0, 0, 0]], 0.5)
    tracer = rs.Tracer(rs.Scene.combine([mesh, ball]))
    with pytest.warns(rs.RaystreamWarning, match="spheres"):
        both = rs.thickness(tracer, [0.01, 0.02, -4], [0, 0, 1])
    inner = rs.thickness(tracer, [0.01, 0.02, -4], [0, 0, 1], nested="inner")
    alone = rs.thickness(rs.Tracer(mesh), [0.01, 0.02, -4], [0, 0, 1])
    assert both.mesh_id.tolist() == [0, 1]
    assert inner.mesh_id.tolist() == [0, 1, 0]
    assert inner.total_length().item() == pytest.approx(alone.total_length().item(), abs=1e-5)


def test_a_height_field_has_the_crossings_of_its_mesh() -> None:
    rng = np.random.default_rng(2)
    heights = rng.uniform(-1.0, 1.0, (9, 8))
    scene, mesh = rs.Scene.height_field(heights), mesh_of(heights)
    origins = rng.uniform([-1, -1, -2], [8, 9, 2], (2000, 3))
    directions = rng.uniform(-1.0, 1.0, (2000, 3))
    found, wanted = (rs.thickness(rs.Tracer(one), origins, directions) for one in (scene, mesh))
    for name in ("ray_splits", "t_entry", "t_exit", "unpaired_ray", "unpaired_t", "unpaired_kind"):
        assert np.array_equal(getattr(found, name), getattr(wanted, name)), name
    assert not found.mesh_is_closed.any()


@pytest.mark.parametrize("ends", ["report", "clip"])
def test_thickness_in_float64_is_that_of_float32_but_for_rounding(ends: str) -> None:
    scene = rs.Scene.from_arrays(*icosphere(2))
    rng = np.random.default_rng(3)
    origins, directions = rng.uniform(-1.5, 1.5, (2, 5000, 3))
    wide = rs.thickness(rs.Tracer(scene, precision="float64"), origins, directions, ends=ends)
    near = rs.thickness(rs.Tracer(scene), origins, directions, ends=ends)
    assert wide.t_exit.dtype == np.float64
    assert np.array_equal(wide.ray_splits, near.ray_splits)
    np.testing.assert_allclose(wide.path_length, near.path_length, atol=2e-5)
    assert np.array_equal(wide.unpaired_ray, near.unpaired_ray)


def test_thickness_in_float64_is_right_far_from_the_origin() -> None:
    vertices = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
    faces = [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1]]
    faces += [[2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]]
    away = np.array([6.4e6, 1e6, -3e6]) + 1.0 / 3.0
    tracer = rs.Tracer(rs.Scene.from_arrays(vertices + away, faces), precision="float64")
    found = rs.thickness(tracer, away + [0.3, 0.6, -7.0], [0.0, 0.0, 1.0])
    assert found.is_complete.all()
    assert found.total_length().item() == pytest.approx(1.0, abs=1e-8)


def test_lidar_in_float64_is_that_of_float32_but_for_rounding() -> None:
    scene = rs.load("cornell")
    rng = np.random.default_rng(4)
    rays = rng.uniform(100.0, 450.0, (1000, 3)), rng.normal(size=(1000, 3))
    wide, near = (
        rs.lidar_returns(rs.Tracer(scene, precision=precision), *rays, transmission=0.5)
        for precision in ("float64", "float32")
    )
    assert np.array_equal(wide.prim_id, near.prim_id)
    np.testing.assert_allclose(wide.ranges, near.ranges, rtol=1e-5, atol=1e-3)
    np.testing.assert_allclose(wide.intensity, near.intensity, atol=1e-5)


def plate(low: float, height: float, turned: bool = False) -> rs.Mesh:
    """A closed box over the unit square; turned, its faces look inward."""
    vertices, faces = cube()
    unit = (vertices - vertices.min(axis=0)) / np.ptp(vertices, axis=0)
    corners = unit[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    outward = np.einsum("nk,nk->", normals, corners.mean(axis=1) - 0.5) > 0.0
    faces = faces if outward != turned else faces[:, ::-1]
    return rs.Mesh(unit * [1.0, 1.0, height] + [0.0, 0.0, low], faces)


def test_solids_thinner_than_float32_resolves() -> None:
    """Their vertices are the same, rounded to float32: their volumes are lost there."""
    gap = 2.0**-33
    plates = [plate(0.625, gap, turned=True), plate(0.75, 2 * gap), plate(0.75 + gap / 2, gap)]
    tracer = rs.Tracer(rs.Scene([plate(-3.0, 1.0), *plates]), precision="float64")
    found = rs.thickness(tracer, [0.3, 0.4, 2.0], [0.0, 0.0, -1.0], nested="inner")
    assert found.mesh_is_flipped.tolist() == [False, True, False, False]
    assert found.mesh_id.tolist() == [2, 3, 2, 1, 0]
    assert (found.path_length / gap).tolist() == [0.5, 1.0, 0.5, 1.0, 1.0 / gap]
    steps = np.array([-1.0, 0.25, 0.5, 0.75, 2.0])
    points = np.column_stack([np.full((5, 2), 0.3), 0.625 + gap * steps])
    for method in ("rays", "winding"):
        inside = tracer.contains(points, method=method)
        assert inside.tolist() == [False, True, True, True, False]
        distances = tracer.signed_distance(points, method=method) / gap
        assert distances.tolist() == [1.0, -0.25, -0.5, -0.25, 1.0]


def test_a_crack_narrower_than_float32_resolves_is_open() -> None:
    whole = plate(0.0, 1.0)
    corners = whole.vertices[whole.faces].astype(np.float64) + 1.0
    corners[0] += 2.0**-33 * np.array([1.0, 1.0, 0.0])
    cracked = rs.Scene.from_arrays(corners.reshape(-1, 3), np.arange(36).reshape(12, 3))
    ray = [1.3, 1.4, 4.0], [0.0, 0.0, -1.0]
    for precision, is_closed in (("float64", False), ("float32", True)):
        tracer = rs.Tracer(cracked, precision=precision)
        assert rs.thickness(tracer, *ray).mesh_is_closed.tolist() == [is_closed]
    with pytest.raises(ValueError, match="open, or faces are oriented"):
        rs.Tracer(cracked, precision="float64").contains([[1.5, 1.5, 1.5]])


@pytest.mark.parametrize("kind", ["mask", "blend", "vertices"])
def test_lidar_through_cut_outs_in_float64(kind: str) -> None:
    """What is cut out lets pulses pass, as if it were not there: the left half of a card."""
    scene = over_ground(kind)
    x = np.arange(-0.95, 1.0, 0.1)
    origins = np.stack([*np.meshgrid(x, x), np.full((20, 20), 2.0)], axis=-1).reshape(-1, 3)
    wide, single, solid = (
        rs.lidar_returns(rs.Tracer(scene, precision=one), origins, [0, 0, -1.0], cutouts=cutouts)
        for one, cutouts in (("float64", True), ("float32", True), ("float64", False))
    )
    np.testing.assert_array_equal(wide.ranges, np.where(origins[:, 0] < 0.0, 3.0, 2.0))
    np.testing.assert_array_equal(wide.prim_id, single.prim_id)
    assert (solid.ranges == 2.0).all()

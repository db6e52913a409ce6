"""Open3D's interface on NumPy arrays: names, shapes and dtypes, and the right hits."""

from __future__ import annotations

import subprocess
import sys
from types import SimpleNamespace

import numpy as np
import pytest

from conftest import child_environment
from meshes import cube, icosphere, soup
from oracles import check_counts, check_first, judge
from raystream.adapters.open3d import RaycastingScene

INVALID = 4294967295


def scene_of(*meshes, **options):
    scene = RaycastingScene(**options)
    for vertices, faces in meshes:
        scene.add_triangles(vertices, faces)
    return scene


def rays_of(shape, seed=0):
    rng = np.random.default_rng(seed)
    return np.concatenate(
        [rng.uniform(-2, 2, (*shape, 3)), rng.normal(size=(*shape, 3))], axis=-1
    ).astype(np.float32)


@pytest.mark.ci
def test_casts_agree_with_the_oracle():
    first, second = soup(40, seed=1), icosphere(1)
    scene = scene_of(first, second)
    rays = rays_of((1500,))
    vertices = np.concatenate([first[0], second[0]])
    faces = np.concatenate([first[1], second[1] + len(first[0])])
    count = len(rays)
    verdict = judge(
        vertices, faces, rays[:, :3], rays[:, 3:], np.zeros(count), np.full(count, np.inf)
    )
    found = scene.cast_rays(rays)
    hit = found["geometry_ids"] != INVALID
    assert 200 < hit.sum() < count
    prim = found["primitive_ids"].astype(np.int64) + np.where(
        found["geometry_ids"] == 1, len(first[1]), 0
    )
    check_first(verdict, found["t_hit"], np.where(hit, prim, -1))
    assert (found["primitive_ids"][~hit] == INVALID).all()
    assert np.isinf(found["t_hit"][~hit]).all()

    corners = vertices[faces[prim[hit]]]
    u, v = found["primitive_uvs"][hit].T[..., None]
    points = (1 - u - v) * corners[:, 0] + u * corners[:, 1] + v * corners[:, 2]
    along = rays[hit, :3] + found["t_hit"][hit, None] * rays[hit, 3:]
    assert np.abs(points - along).max() < 1e-4
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    assert np.abs(normals - found["primitive_normals"][hit]).max() < 1e-5
    assert not found["primitive_normals"][~hit].any()
    assert not found["primitive_uvs"][~hit].any()

    assert (scene.test_occlusions(rays) == hit).all()
    counts = scene.count_intersections(rays)
    check_counts(verdict, counts)
    listed = scene.list_intersections(rays)
    assert (np.diff(listed["ray_splits"]) == counts).all()
    assert (listed["ray_ids"] == np.repeat(np.arange(count), counts)).all()
    inner = np.diff(listed["ray_ids"]) == 0
    assert (np.diff(listed["t_hit"])[inner] >= 0).all()
    starts = listed["ray_splits"][:-1][counts > 0]
    for name in ("t_hit", "geometry_ids", "primitive_ids", "primitive_uvs"):
        assert (listed[name][starts] == found[name][hit]).all()


def test_shapes_and_dtypes():
    scene = scene_of(icosphere(1))
    for shape in ((), (7,), (4, 5), (2, 3, 4), (0,), (3, 0)):
        rays = rays_of(shape)
        found = scene.cast_rays(rays)
        assert list(found) == [
            "t_hit",
            "geometry_ids",
            "primitive_ids",
            "primitive_uvs",
            "primitive_normals",
        ]
        assert [one.shape for one in found.values()] == [
            shape,
            shape,
            shape,
            (*shape, 2),
            (*shape, 3),
        ]
        kinds = [one.dtype for one in found.values()]
        assert kinds == [np.float32, np.uint32, np.uint32, np.float32, np.float32]
        seen, counts = scene.test_occlusions(rays), scene.count_intersections(rays)
        assert (seen.shape, seen.dtype) == (shape, bool)
        assert (counts.shape, counts.dtype) == (shape, np.int32)
        listed = scene.list_intersections(rays)
        total = int(counts.sum())
        assert {name: (one.shape, one.dtype) for name, one in listed.items()} == {
            "ray_splits": ((int(np.prod(shape)) + 1,), np.uint32),
            "ray_ids": ((total,), np.uint32),
            "t_hit": ((total,), np.float32),
            "geometry_ids": ((total,), np.uint32),
            "primitive_ids": ((total,), np.uint32),
            "primitive_uvs": ((total, 2), np.float32),
        }
        for one in (*found.values(), seen, counts, *listed.values()):
            assert type(one.numpy()) is np.ndarray
            assert np.shares_memory(one.numpy(), one) or one.size == 0


def test_occlusions_end_where_they_are_told():
    scene = scene_of(([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]]))
    ray = [[0.25, 0.25, 2, 0, 0, -1]]  # hits at 2
    assert scene.test_occlusions(ray).tolist() == [True]
    assert scene.test_occlusions(ray, tfar=2.0).tolist() == [True]  # closed
    assert scene.test_occlusions(ray, 2.0, 3.0).tolist() == [True]
    assert scene.test_occlusions(ray, tfar=1.999).tolist() == [False]
    assert scene.test_occlusions(ray, tnear=2.001).tolist() == [False]
    assert scene.test_occlusions(ray * 2, tnear=[0.0, 2.5], nthreads=2).tolist() == [True, False]


def test_meshes_come_in_many_forms():
    vertices, faces = cube()
    rays = rays_of((300,))
    wanted = scene_of((vertices, faces)).cast_rays(rays)
    tensor_mesh = SimpleNamespace(vertex={"positions": vertices}, triangle={"indices": faces})
    legacy_mesh = SimpleNamespace(vertices=vertices.tolist(), triangles=faces.tolist())
    for args, kwargs in (
        ((vertices.astype(np.float32), faces.astype(np.uint32)), {}),
        ((), {"vertex_positions": vertices, "triangle_indices": faces}),
        ((tensor_mesh,), {}),
        ((legacy_mesh,), {}),
        ((), {"mesh": legacy_mesh}),
    ):
        scene = RaycastingScene(nthreads=1, device="CPU:0")
        assert scene.add_triangles(*args, **kwargs) == 0
        found = scene.cast_rays(rays, nthreads=1)
        assert all((found[name] == wanted[name]).all() for name in wanted)


def test_meshes_may_be_added_later():
    scene = scene_of()
    rays = np.array([[0.25, 0.25, 2, 0, 0, -1]], np.float32)
    assert scene.cast_rays(rays)["geometry_ids"].tolist() == [INVALID]
    triangle = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], float)
    assert scene.add_triangles(triangle, [[0, 1, 2]]) == 0
    assert scene.cast_rays(rays)["t_hit"].tolist() == [2.0]
    assert scene.add_triangles(triangle + [0, 0, 1], [[0, 1, 2], [0, 2, 1]]) == 1
    found = scene.cast_rays(rays)
    assert found["t_hit"].tolist() == [1.0]
    assert found["geometry_ids"].tolist() == [1]
    assert found["primitive_ids"].tolist() == [0]
    assert scene.count_intersections(rays).tolist() == [3]


def towards(points, direction=(0, 0, -1)):
    """Rays that pass exactly through points, from three directions before them."""
    points = np.asarray(points, np.float32)
    direction = np.broadcast_to(np.asarray(direction, np.float32), points.shape)
    return np.concatenate([points - 3 * direction, direction], axis=-1)


def test_a_ray_through_a_diagonal_of_a_box_crosses_two_faces():
    """As in Open3D's own tests: from outside, from inside, and beside it."""
    scene = scene_of(cube())
    rays = [[0.5, 0.5, -1, 0, 0, 1], [0.5, 0.5, 0.5, 0, 0, 1], [10, 10, 10, 1, 0, 0]]
    assert scene.count_intersections(rays).tolist() == [2, 1, 0]
    listed = scene.list_intersections(rays)
    assert listed["t_hit"].tolist() == [1.0, 2.0, 0.5]
    assert listed["ray_splits"].tolist() == [0, 2, 3, 3]
    assert listed["ray_ids"].tolist() == [0, 0, 1]
    found = scene.cast_rays(rays)
    assert found["t_hit"].tolist() == [1.0, 0.5, np.inf]
    assert found["primitive_ids"][0] <= listed["primitive_ids"][0]  # of both triangles, the first


def test_the_edge_of_two_triangles_is_crossed_once():
    square = [[0, 0, 0], [2, 0, 0], [2, 2, 0], [0, 2, 0]]
    rays = towards(np.linspace([0.25, 0.25, 0], [1.75, 1.75, 0], 7))
    for faces in ([[0, 1, 2], [0, 2, 3]], [[0, 1, 2], [0, 3, 2]]):  # one turned over
        scene = scene_of((square, faces))
        assert (scene.count_intersections(rays) == 1).all()
        assert (scene.list_intersections(rays)["t_hit"] == 3).all()


def test_a_vertex_is_crossed_once():
    vertices, faces = icosphere(2)
    scene = scene_of((vertices, faces))
    inwards = towards(vertices, -vertices)
    assert scene.count_intersections(inwards).dtype == np.int32
    assert (scene.count_intersections(inwards) == 2).all()
    assert (scene.count_intersections(towards(vertices, vertices)) % 2 == 0).all()
    fan = [[np.cos(a), np.sin(a), 0] for a in np.arange(6) * np.pi / 3]
    around = scene_of(([[0, 0, 0], *fan], [[0, 1 + k, 1 + (k + 1) % 6] for k in range(6)]))
    assert around.count_intersections(towards([[0, 0, 0]])).tolist() == [1]


def test_each_geometry_is_crossed_by_itself():
    """Equal ones, and boxes that share a face, on the diagonals of which rays pass."""
    vertices, faces = cube()
    for offset, t in (([0, 0, 0], [2, 2, 3, 3]), ([0, 0, 1], [2, 3, 3, 4])):
        scene = scene_of((vertices + offset, faces), (vertices, faces))
        rays = [[0.5, 0.5, 3 + offset[2], 0, 0, -1]]
        assert scene.count_intersections(rays).tolist() == [4]
        listed = scene.list_intersections(rays)
        assert listed["t_hit"].tolist() == t
        assert sorted(listed["geometry_ids"].tolist()) == [0, 0, 1, 1]


def test_what_a_ray_grazes_is_seen_but_crossed_an_even_number_of_times():
    scene = scene_of(cube())
    corner = towards([[1, 1, 1], [1, 0, 1]])
    assert (scene.cast_rays(corner)["t_hit"] == 3).all()
    assert scene.test_occlusions(corner).all()
    assert (scene.count_intersections(corner) % 2 == 0).all()


def test_a_scene_far_from_the_origin():
    vertices, faces = icosphere(2)
    offset = np.array([4e6, -2e6, 1e6])
    rays = rays_of((500,)).astype(np.float64)
    wanted = scene_of((vertices, faces)).cast_rays(rays)
    rays[:, :3] += offset
    found = scene_of((vertices + offset, faces)).cast_rays(rays)
    same = found["primitive_ids"] == wanted["primitive_ids"]
    assert same.mean() > 0.99
    hit = same & (wanted["primitive_ids"] != INVALID)
    assert hit.sum() > 50
    assert np.abs(found["t_hit"][hit] - wanted["t_hit"][hit]).max() < 1e-5


def test_pinhole_rays():
    rays = RaycastingScene.create_rays_pinhole(
        fov_deg=90, center=[0, 0, 0], eye=[0, 0, 2], up=[0, 1, 0], width_px=4, height_px=2
    )
    assert rays.shape == (2, 4, 6)
    assert rays.dtype == np.float32
    assert (rays[..., :3] == [0, 0, 2]).all()
    # Half the width is at 45 degrees; the first pixel is at the lower right, as Open3D has it.
    assert np.allclose(rays[0, 0, 3:], [0.75, -0.25, -1])
    assert np.allclose(rays[1, 3, 3:], [-0.75, 0.25, -1])
    focal = 2.0
    intrinsic = [[focal, 0, 2], [0, focal, 1], [0, 0, 1]]
    extrinsic = np.diag([-1.0, 1, -1, 1])
    extrinsic[:3, 3] = -extrinsic[:3, :3] @ [0, 0, 2]
    same = RaycastingScene.create_rays_pinhole(intrinsic, extrinsic, 4, 2)
    assert np.allclose(rays, same)
    assert np.allclose(
        rays, RaycastingScene.create_rays_pinhole(90, [0, 0, 0], [0, 0, 2], [0, 1, 0], 4, 2)
    )


@pytest.mark.parametrize(
    ("arguments", "error", "match"),
    [
        ({"center": [0, 0, 2]}, ValueError, "center, eye"),
        ({"up": [0, 0, 1]}, ValueError, "up: parallel"),
        ({"fov_deg": 180}, ValueError, "fov_deg"),
        ({"fov_deg": np.nan}, ValueError, "fov_deg"),
        ({"eye": [0, 0]}, ValueError, "eye: expected shape"),
        ({"eye": [0, 0, np.nan]}, ValueError, "eye: expected finite"),
        ({"width_px": 0}, ValueError, "width_px"),
        ({"width_px": 1.5}, TypeError, "integer"),
        ({"other": 1}, TypeError, "expected"),
    ],
)
def test_bad_cameras_are_named(arguments, error, match):
    good = {
        "fov_deg": 90,
        "center": [0, 0, 0],
        "eye": [0, 0, 2],
        "up": [0, 1, 0],
        "width_px": 4,
        "height_px": 2,
    }
    with pytest.raises(error, match=match):
        RaycastingScene.create_rays_pinhole(**(good | arguments))


def test_bad_arguments_are_named():
    scene = scene_of(cube())
    for method in (
        scene.cast_rays,
        scene.test_occlusions,
        scene.count_intersections,
        scene.list_intersections,
    ):
        with pytest.raises(ValueError, match=r"rays: expected shape \(..., 6\), got \(2, 3\)"):
            method(np.zeros((2, 3)))
        with pytest.raises(TypeError, match="rays: expected real numbers"):
            method([["x"] * 6])
    with pytest.raises(TypeError, match="add_triangles: expected a mesh"):
        scene.add_triangles(np.zeros((3, 3)))
    with pytest.raises(TypeError, match="not both"):
        scene.add_triangles(np.zeros((3, 3)), mesh=SimpleNamespace())
    with pytest.raises(ValueError, match="faces: vertex index 3"):
        scene.add_triangles(np.zeros((3, 3)), [[0, 1, 3]])
    with pytest.raises(ValueError, match="device"):
        scene_of(cube(), device="SYCL:0").cast_rays(np.zeros((1, 6)))
    assert "1 meshes, 12 triangles" in repr(scene)


def test_bad_rays_miss():
    scene = scene_of(cube())
    rays = np.array([[0.5, 0.5, 3, 0, 0, -1]] * 4)
    rays[0, 0], rays[1, 4], rays[2, 3:], rays[3, 2] = np.nan, np.inf, 0, -np.inf
    found = scene.cast_rays(rays)
    assert (found["primitive_ids"] == INVALID).all()
    assert np.isinf(found["t_hit"]).all()
    assert not found["primitive_normals"].any()
    assert not scene.count_intersections(rays).any()


@pytest.mark.ci
def test_open3d_is_not_imported():
    code = (
        "import sys; from raystream.adapters.open3d import RaycastingScene as S; s = S(); "
        "s.add_triangles([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]]); "
        "s.cast_rays([[0, 0, 1, 0, 0, -1]]); assert 'open3d' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], env=child_environment(), check=True, timeout=120)

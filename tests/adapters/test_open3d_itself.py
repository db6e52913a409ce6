"""The adapter and Open3D, side by side, with tensors."""

from __future__ import annotations

import inspect

import numpy as np
import pytest

o3d = pytest.importorskip("open3d", exc_type=ImportError)  # it needs libraries of the system

from meshes import dented_sphere, icosphere
from raystream.adapters.open3d import RaycastingScene

Tensor = o3d.core.Tensor


@pytest.fixture(scope="module")
def scenes():
    """Open3D's scene and ours, of two meshes."""
    both = []
    for kind in (o3d.t.geometry.RaycastingScene, RaycastingScene):
        scene = kind()
        for vertices, faces in (dented_sphere(3), icosphere(2)):
            number = scene.add_triangles(
                Tensor(vertices.astype(np.float32)), Tensor(faces.astype(np.uint32))
            )
        assert number == 1
        both.append(scene)
    return both


def tensor_rays(shape):
    rng = np.random.default_rng(0)
    origins, directions = rng.uniform(-3, 3, (*shape, 3)), rng.normal(size=(*shape, 3))
    return Tensor(np.concatenate([origins, directions], axis=-1).astype(np.float32))


def test_names_are_open3ds():
    public = {name for name in dir(o3d.t.geometry.RaycastingScene) if not name.startswith("_")}
    assert public == {name for name in dir(RaycastingScene) if not name.startswith("_")}
    assert RaycastingScene.INVALID_ID == o3d.t.geometry.RaycastingScene.INVALID_ID
    for name in public - {"INVALID_ID", "create_rays_pinhole", "add_triangles"}:
        text = getattr(o3d.t.geometry.RaycastingScene, name).__doc__
        ours = list(inspect.signature(getattr(RaycastingScene, name)).parameters)
        positions = [text.partition("\n")[0].find(f"{one}:") for one in ours[1:]]
        assert positions == sorted(positions), text
        assert min(positions) > 0


@pytest.mark.parametrize("shape", [(3000,), (20, 30)])
def test_results_are_open3ds(scenes, shape):
    rays = tensor_rays(shape)
    theirs, ours = (scene.cast_rays(rays) for scene in scenes)
    assert set(theirs) == set(ours)
    for name in theirs:
        assert isinstance(ours[name], Tensor)
        assert theirs[name].dtype == ours[name].dtype, name
        assert theirs[name].shape == ours[name].shape, name
    theirs = {name: value.numpy() for name, value in theirs.items()}
    ours = {name: value.numpy() for name, value in ours.items()}
    same = theirs["primitive_ids"] == ours["primitive_ids"]
    assert same.mean() > 0.998
    assert (theirs["geometry_ids"] == ours["geometry_ids"])[same].all()
    for name, tolerance in (("t_hit", 1e-4), ("primitive_uvs", 1e-3), ("primitive_normals", 1e-5)):
        one, two = theirs[name][same], ours[name][same]
        assert np.allclose(one, two, rtol=tolerance, atol=tolerance), name
    for one, two in (
        [scene.test_occlusions(rays, tnear=0.5, tfar=2.0) for scene in scenes],
        [scene.count_intersections(rays) for scene in scenes],
    ):
        assert one.dtype == two.dtype
        assert one.shape == two.shape
        assert (one.numpy() == two.numpy()).mean() > 0.998


def test_lists_are_open3ds_but_sorted(scenes):
    rays = tensor_rays((2000,))
    theirs, ours = (scene.list_intersections(rays) for scene in scenes)
    assert set(theirs) == set(ours)
    for name in theirs:
        assert theirs[name].dtype == ours[name].dtype, name
        assert len(theirs[name].shape) == len(ours[name].shape)
    rows = [
        {
            *zip(
                *(
                    one[name].numpy().ravel().tolist()
                    for name in ("ray_ids", "geometry_ids", "primitive_ids")
                ),
                strict=True,
            )
        }
        for one in (theirs, ours)
    ]
    assert len(rows[0] ^ rows[1]) < 2e-3 * len(rows[0])
    splits, t = ours["ray_splits"].numpy(), ours["t_hit"].numpy()
    inner = np.ones(len(t) - 1, bool)
    ends = splits[1:-1]
    inner[ends[(ends > 0) & (ends < len(t))] - 1] = False
    assert (np.diff(t)[inner] >= 0).all()


def test_camera_rays_are_open3ds():
    view = {"fov_deg": 57.0, "center": [0.2, 0.1, -0.3], "eye": [2, -3, 1.5], "up": [0.1, 0.2, 1]}
    size = {"width_px": 17, "height_px": 11}
    theirs = o3d.t.geometry.RaycastingScene.create_rays_pinhole(**view, **size)
    ours = RaycastingScene.create_rays_pinhole(**view, **size)
    assert np.allclose(theirs.numpy(), ours, atol=2e-6)
    intrinsic = np.array([[20.0, 0.5, 8], [0, 22, 5], [0, 0, 1]])
    extrinsic = np.eye(4)
    extrinsic[:3, :3], _ = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))
    extrinsic[:3, 3] = [0.3, -1, 2]
    if np.linalg.det(extrinsic[:3, :3]) < 0:
        extrinsic[:3, 0] *= -1
    for kind in (o3d.t.geometry.RaycastingScene, RaycastingScene):
        rays = kind.create_rays_pinhole(Tensor(intrinsic), Tensor(extrinsic), **size)
        assert isinstance(rays, Tensor)
        theirs = rays.numpy() if kind is not RaycastingScene else theirs
    assert np.allclose(theirs, rays.numpy(), atol=2e-6)


def test_meshes_of_open3d():
    legacy = o3d.geometry.TriangleMesh.create_sphere(1.0)
    rays = tensor_rays((500,))
    answers = []
    for mesh in (legacy, o3d.t.geometry.TriangleMesh.from_legacy(legacy)):
        scene = RaycastingScene(device=o3d.core.Device("CPU:0"))
        assert scene.add_triangles(mesh) == 0
        answers.append(scene.cast_rays(rays)["primitive_ids"].numpy())
    assert (answers[0] == answers[1]).mean() > 0.998  # legacy meshes are float64
    assert 10 < (answers[0] != RaycastingScene.INVALID_ID).sum() < 500


def test_point_queries_are_open3ds(scenes):
    points = Tensor(np.random.default_rng(4).uniform(-3, 3, (40, 50, 3)).astype(np.float32))
    theirs, ours = (scene.compute_closest_points(points) for scene in scenes)
    assert set(theirs) == set(ours)
    for name in theirs:
        assert theirs[name].dtype == ours[name].dtype, name
        assert theirs[name].shape == ours[name].shape, name
    theirs, ours = ({k: v.numpy() for k, v in one.items()} for one in (theirs, ours))
    same = theirs["primitive_ids"] == ours["primitive_ids"]
    assert same.mean() > 0.6  # the nearest point is often on an edge, where they choose any
    assert (theirs["geometry_ids"] == ours["geometry_ids"]).mean() > 0.999
    lengths = [np.linalg.norm(one["points"] - points.numpy(), axis=-1) for one in (theirs, ours)]
    assert (lengths[1] <= lengths[0] + 1e-6).all()  # ours is not the farther one
    assert (lengths[0] - lengths[1] < 1e-5).all()
    for name in ("primitive_uvs", "primitive_normals"):
        assert np.abs(theirs[name] - ours[name])[same].max() < 2e-3
    for name in ("compute_distance", "compute_signed_distance", "compute_occupancy"):
        one, two = (getattr(scene, name)(points) for scene in scenes)
        assert one.dtype == two.dtype
        assert one.shape == two.shape
        assert (np.abs(one.numpy() - two.numpy()) < 1e-5).mean() > 0.999

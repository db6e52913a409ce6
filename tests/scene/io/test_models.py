"""The models that developers have: counts and bounds as published with them."""

from __future__ import annotations

import os
import time
import warnings
from pathlib import Path

import numpy as np
import pytest

from raystream.core.errors import RaystreamWarning
from raystream.scene.io.formats import read_model
from raystream.scene.scene import Scene

FOLDER = Path(os.environ.get("RAYSTREAM_SCENES", ""))

pytestmark = pytest.mark.skipif(
    "RAYSTREAM_SCENES" not in os.environ, reason="RAYSTREAM_SCENES names no folder of models"
)

MODELS = [
    ("bunny/bun_zipper.ply", 69_451, (-0.0947, 0.0330, -0.0619), (0.0610, 0.1873, 0.0588)),
    ("cornell_box/CornellBox-Original.obj", 36, (-1.02, 0, -1.04), (1.00, 1.99, 0.99)),
    ("cornell_box/CornellBox-Mirror.obj", 36, (-1.02, 0, -1.04), (1.00, 1.99, 0.99)),
    ("teapot/teapot.obj", 15_704, (-71.89, 0, -47.93), (82.29, 79.01, 47.93)),
    ("teapot/teapot_bezier31.ply", 61_256, (-3, -2, 0), (3.434, 2, 3.15)),
    ("bart/kitchen/aff/kitchen.aff", 110_561, (-2, -1.1, -3.75), (6, 2.9, 4.33)),
    ("bart/robots/aff/Robot.aff", 71_708, (-164.15, -0.62, -435.36), (164.15, 535.36, 250.10)),
    ("sponza/sponza.obj.gz", 66_450, (-17.40, -0.91, -7.80), (17.42, 15.65, 7.80)),
    ("sibenik/sibenik.obj.gz", 75_284, (-20.14, -15.31, -8.50), (20.14, 15.30, 8.50)),
    ("conference/conference.obj.gz", 331_179, (-1020.1, -2.79, -1055.7), (1685.8, 650.3, 668.5)),
    ("gltf/BoxTextured.glb", 12, (-0.5, -0.5, -0.5), (0.5, 0.5, 0.5)),
    ("gltf/CornellBox_bevy.glb", 36, (-556, 0, -559.2), (0, 548.8, 0)),
    ("gltf/CesiumMilkTruck.glb", 3_624, (-2.431, 0.002, -1.396), (2.438, 2.584, 1.396)),
    ("gltf/DamagedHelmet/DamagedHelmet.gltf", 15_452, (-0.945, -0.901, -1), (0.945, 0.901, 1)),
]


def read(name: str) -> Scene:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RaystreamWarning)
        return read_model(FOLDER / name)


@pytest.mark.parametrize(("name", "count", "low", "high"), MODELS)
def test_counts_and_bounds(
    name: str, count: int, low: tuple[float, ...], high: tuple[float, ...]
) -> None:
    begin = time.perf_counter()
    scene = read(name)
    took = time.perf_counter() - begin
    assert scene.triangle_count == count
    extent = np.subtract(high, low).max()
    np.testing.assert_allclose(scene.bounds, [low, high], atol=5e-4 * extent)
    assert took < 20.0  # hangs and squares, not slow machines


def test_bart_cameras() -> None:
    kitchen = read("bart/kitchen/aff/kitchen.aff").camera
    assert kitchen.eye == (3.75, 2.3, 3.6)
    assert kitchen.look_at == pytest.approx((3.43654, 1.88019, 2.74824), abs=1e-5)
    assert kitchen.up == pytest.approx((-0.1270, 0.9074, -0.4005), abs=1e-4)
    robots = read("bart/robots/aff/Robot.aff").camera
    assert robots.look_at == pytest.approx((-3.4412, 2.0987, -203.9934), abs=1e-4)
    assert robots.fov == pytest.approx(36.87, abs=1e-2)


def test_bart_camera_tracks() -> None:
    """Keys as they stand in the files, and a point half way from one to the next.

    By hand: half way p = (p1 + p2) / 2 + (leaving - arriving) / 8. From t = 0 to 5 the
    kitchen's camera leaves its first place at rest, weight 5 / 6, and arrives with weight
    5 / 6.7 of the steps before and after, (-0.25, -2.1, -3.5) and (0, 0, 0.6).
    """
    kitchen = read("bart/kitchen/aff/kitchen.aff")
    assert kitchen.camera_track is not None
    assert kitchen.camera_track.times == (0.0, 19.7)
    assert kitchen.camera_at(0.0).eye == kitchen.camera.eye
    at_key = kitchen.camera_at(5.0)
    assert at_key.eye == pytest.approx((3.5, 0.2, 0.1))
    assert at_key.look_at == pytest.approx((3.5, 0.2, 1.1))  # -z turned by 180 degrees about y
    assert kitchen.camera_at(2.5).eye == pytest.approx((3.6222792, 1.2271455, 1.7559391), abs=1e-6)
    assert kitchen.camera_at(99.0).eye == pytest.approx((3.27488, 0.334545, 2.98028))
    robots = read("bart/robots/aff/Robot.aff")
    assert robots.camera_track is not None
    assert robots.camera_track.times == (0.0, 45.0)
    assert robots.camera_at(5.6).eye == pytest.approx((-3.5, 2, -202))
    assert robots.camera_at(40.0).eye == pytest.approx((0, 10, 0))
    assert robots.camera_at(40.0).basis()[2] == pytest.approx((0, 0, -1))  # not turned
    assert robots.camera_at(50.0).fov == robots.camera.fov


def test_materials_of_the_cornell_box() -> None:
    scene = read("cornell_box/CornellBox-Mirror.obj")
    counts = {mesh.name: mesh.triangle_count for mesh in scene.meshes}
    walls = dict.fromkeys(["floor", "ceiling", "backWall", "rightWall"], 2)
    # In the file, each block comes before the line of its group.
    assert counts == walls | {"leftWall": 14, "shortBox": 12, "light": 2}
    used = {scene.materials[i].name: scene.materials[i] for i in scene.attributes.material_ids}
    assert used["tallBox"].reflection == (0.95, 0.95, 0.95)
    assert [name for name, material in used.items() if material.emits] == ["light"]
    (light,) = scene.area_lights
    assert len(light.prim_ids) == 2


@pytest.mark.parametrize("name", ["sponza/sponza.obj.gz", "bart/kitchen/aff/kitchen.aff"])
def test_every_texture_is_found(name: str) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error", RaystreamWarning)
        warnings.filterwarnings("ignore", message=".*never be hit")
        scene = read_model(FOLDER / name)
    textures = {t.path for m in scene.materials for t in m.textures.values()}
    assert len(textures) > 5
    assert all(path is not None and path.is_file() for path in textures)


@pytest.mark.parametrize(
    "name", ["bunny/bun_zipper.ply", "gltf/CesiumMilkTruck.glb", "gltf/CornellBox_bevy.glb"]
)
def test_trimesh_agrees(name: str) -> None:
    import trimesh

    theirs = trimesh.load_scene(FOLDER / name, process=False).to_mesh()
    ours = read(name)
    area = 0.0
    for mesh in ours.meshes:
        a, b, c = mesh.vertices[mesh.faces].astype(np.float64).transpose(1, 0, 2)
        area += float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2)
    assert ours.triangle_count == len(theirs.faces)
    assert area == pytest.approx(theirs.area, rel=1e-5)
    np.testing.assert_allclose(ours.bounds, theirs.bounds, rtol=1e-5, atol=1e-4)

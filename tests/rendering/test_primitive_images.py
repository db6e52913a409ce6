"""Images of spheres and height fields: those of fine meshes, in all modes."""

from __future__ import annotations

import numpy as np
import pytest

import raystream as rs
from meshes import icosphere

SIZE = (64, 48)
MODES = ("vis", "raycast", "shadow", "whitted", "ao", "kajiya", "path", "xray")
LIGHTS = [
    rs.DirectionalLight((0.4, 0.3, -1.0), (2.0, 2.0, 2.0)),
    rs.PointLight((2, -3, 5), (30, 30, 30)),
]
CAMERA = rs.Camera((1.0, -6.0, 4.0), (1.5, 1.5, 0.2), up=(0.0, 0.0, 1.0))
RED = rs.Material(diffuse=(0.8, 0.2, 0.1), name="red")
GREEN = rs.Material(diffuse=(0.2, 0.6, 0.2), name="green")


def heights() -> np.ndarray:
    at = np.linspace(0.0, 5.0, 16)
    return 0.3 * np.sin(at)[:, None] * np.cos(at)


def with_primitives() -> rs.Scene:
    ground = rs.Scene.height_field(heights(), spacing=0.25, materials=[GREEN])
    balls = rs.Scene.spheres([[1.0, 1.0, 0.8], [2.5, 2.0, 0.9]], [0.5, 0.7], materials=[RED])
    return rs.Scene.combine([ground, balls], lights=LIGHTS, camera=CAMERA, up=(0, 0, 1))


def of_meshes() -> rs.Scene:
    ground = rs.terrain(heights(), spacing=0.25).scene.meshes[0].with_material_ids(0)
    vertices, faces = icosphere(5)
    balls = [
        rs.Mesh(vertices * radius + center, faces, normals=vertices, material_ids=1)
        for center, radius in (([1.0, 1.0, 0.8], 0.5), ([2.5, 2.0, 0.9], 0.7))
    ]
    parts = {"lights": LIGHTS, "camera": CAMERA, "up": (0, 0, 1)}
    return rs.Scene([ground, *balls], materials=[GREEN, RED], **parts)


@pytest.mark.parametrize("mode", MODES)
def test_images_are_those_of_meshes(mode) -> None:
    options = {"mode": mode, "size": SIZE, "samples": 4, "seed": 3}
    ours, meshes = (rs.render(one, **options).pixels for one in (with_primitives(), of_meshes()))
    assert np.isfinite(ours).all()
    assert ours.max() > 0.0
    if mode == "vis":  # colours of primitives
        same = (ours.sum(axis=-1) > 0) == (meshes.sum(axis=-1) > 0)
        assert np.count_nonzero(~same) < 20
        return
    scale = float(np.quantile(meshes, 0.95))
    difference = np.abs(ours - meshes).max(axis=-1) / scale
    # Outlines and the edges of shadows differ by the polygons of the mesh.
    assert np.median(difference) < 0.01
    assert np.count_nonzero(difference > 0.1) < 0.06 * difference.size
    assert abs(ours.mean() / meshes.mean() - 1.0) < 0.02


def test_meshes_keep_their_attributes_beside_spheres() -> None:
    """A textured, smooth and coloured scene is the same with a sphere that no ray meets."""
    room = rs.load("spheres")
    beside = rs.Scene.combine(
        [room, rs.Scene.spheres([[0.0, -1e3, 0.0]], 1.0)],
        lights=room.lights,
        camera=room.camera,
        up=room.up,
    )
    options = {"mode": "shadow", "size": SIZE, "lights": "file"}
    a, b = rs.render(room, **options).pixels, rs.render(beside, **options).pixels
    assert np.count_nonzero(np.abs(a - b).max(axis=-1) > 1e-3) < 10


def test_layers_and_checkpoints(tmp_path) -> None:
    scene = with_primitives()
    options = {"mode": "raycast", "size": SIZE, "layers": "all"}
    image = rs.render(scene, checkpoint=tmp_path / "image.npz", **options)
    again = rs.render(scene, checkpoint=tmp_path / "image.npz", **options)
    np.testing.assert_array_equal(image.pixels, again.pixels)
    triangle_count = 2 * 15 * 15
    assert image.layers["prim_id"].max() == triangle_count + 1


@pytest.mark.parametrize("alphas", [False, True])
def test_shares_of_rays_pass_through_spheres_and_height_fields(alphas) -> None:
    """A field, and each of the two sides of a sphere, cover a quarter, each by its own chance."""
    black = rs.Material(diffuse=(0, 0, 0), opacity=0.25)
    ball = rs.Scene.spheres([[0, 0, 0]], 5.0, materials=[black])
    at = {"origin": (-9, -9, -7), "spacing": 9.0}
    field = rs.Scene.height_field(np.zeros((3, 3)), **at, materials=[black])
    parts = {"background": (1, 1, 1), "camera": rs.Camera((0, 0, 30), (0, 0, 0), fov=5)}
    hidden = rs.Mesh([[0, 0, 99], [1, 0, 99], [0, 1, 99]], [[0, 1, 2]], colors=np.full((3, 4), 0.5))
    beside = [rs.Scene([hidden])] if alphas else []
    for scenes, share in (([field], 0.75), ([ball], 0.75**2), ([ball, field], 0.75**3)):
        scene = rs.Scene.combine([*scenes, *beside], **parts)
        pixels = rs.render(scene, "path", (32, 32), 16, sampler="random").pixels
        assert abs(pixels.mean() - share) < 4 * np.sqrt(share * (1 - share) / (32 * 32 * 16))


@pytest.mark.parametrize("mode", ["vis", "raycast", "shadow", "whitted", "xray"])
def test_what_is_cut_out_is_not_in_images(mode) -> None:
    clear = rs.Material(opacity=0.3, alpha_cutoff=0.5)
    scene, options = with_primitives(), {"size": SIZE, "samples": 2, "seed": 3}
    parts = {"lights": LIGHTS, "camera": CAMERA, "up": (0, 0, 1), "materials": [GREEN, clear]}
    ground = rs.Scene.height_field(heights(), spacing=0.25, **parts)
    found = rs.render(scene.replace(materials=[GREEN, clear]), mode, **options).pixels
    np.testing.assert_array_equal(found, rs.render(ground, mode, **options).pixels)

"""Layers of rendered images: the first visible surfaces, against closed forms."""

from __future__ import annotations

import math

import numpy as np
import pytest

import raystream as rs
from meshes import icosphere
from raystream.rendering import sample_bands

NAMES = ("depth", "normal", "albedo", "prim_id")

FLOOR = np.array([[-50, 0, -50], [50, 0, -50], [50, 0, 50], [-50, 0, 50.0]])
FACES = [[0, 2, 1], [0, 3, 2]]


def test_depth_of_a_plane_is_the_way_to_it():
    """A floor 2 below: the ray's way is 2 over its cosine; beside it, nothing is near."""
    half = rs.Mesh(np.maximum(FLOOR, [0.0, -9, -50]), FACES)
    camera = rs.Camera((0, 2, 0), (0, 0, 0), (0, 0, -1), 60)
    image = rs.render(rs.Scene([half]), "vis", (16, 12), camera=camera, layers=NAMES)
    _, directions = camera.rays(16, 12)
    way = 2.0 * np.linalg.norm(directions, axis=2) / np.abs(directions[..., 1])
    np.testing.assert_allclose(image.layers["depth"][:, 8:], way[:, 8:], rtol=1e-6)
    np.testing.assert_array_equal(image.layers["depth"][:, :8], np.inf)
    np.testing.assert_array_equal(image.layers["prim_id"][:, :8], -1)
    assert set(np.unique(image.layers["prim_id"][:, 8:])) <= {0, 1}
    np.testing.assert_array_equal(image.layers["normal"][:, 8:], [[[0, 1, 0]] * 8] * 12)
    assert not image.layers["normal"][:, :8].any()
    assert not image.layers["albedo"][:, :8].any()


@pytest.mark.parametrize("samples", [1, 4])
def test_normals_of_a_sphere_are_its_places(samples):
    """Smooth normals and, seen from inside, turned to the eye."""
    vertices, faces = icosphere(4)
    scene = rs.Scene([rs.Mesh(vertices, faces, normals=vertices)])
    for eye, side in (((0.0, 0.0, 3.0), 1.0), ((0.0, 0.0, 0.1), -1.0)):
        camera = rs.Camera(eye, (0, 0, -1), (0, 1, 0), 20)
        image = rs.render(
            scene, "vis", (12, 12), samples, camera=camera, layers=["normal", "depth"]
        )
        origins, directions = camera.rays(12, 12)
        unit = directions / np.linalg.norm(directions, axis=2, keepdims=True)
        places = origins + image.layers["depth"][..., None] * unit
        atol = 0.01 if samples == 1 else 0.03
        np.testing.assert_allclose(image.layers["normal"], side * places, atol=atol)
        assert set(image.layers) == {"normal", "depth", "variance", "samples"}


def test_albedo_is_what_a_surface_scatters():
    """A texture of two colours; and matte and gloss, but neither mirror nor glass."""
    texels = np.array([[[255, 0, 0], [0, 255, 0]]], np.uint8)
    textured = rs.Material(diffuse=(0.5, 0.5, 1.0), textures={"diffuse": rs.Texture(texels)})
    mixed = rs.Material(
        diffuse=(0.1, 0.2, 0.3),
        specular=(0.2, 0.2, 0.2),
        reflection=(0.3, 0.1, 0.4),
        transmission=(0.2, 0.1, 0.1),
    )
    texcoords = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], float)
    corners = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0.0]])
    quad = rs.Mesh(corners, [[0, 1, 2], [0, 2, 3]], texcoords=texcoords)
    other = rs.Mesh(corners + [5, 0, 0], [[0, 1, 2], [0, 2, 3]], material_ids=1)
    scene = rs.Scene([quad, other], materials=[textured, mixed])
    # In between, halfway in linear light.
    expected = {-0.5: (0.5, 0, 0), 0.5: (0, 0.5, 0), 0.0: (0.25, 0.25, 0), 5.0: (0.3, 0.4, 0.5)}
    for x, color in expected.items():
        camera = rs.Camera((x, 0, 2), (x, 0, 0), (0, 1, 0), 1e-3)
        image = rs.render(scene, "path", (1, 1), camera=camera, layers=["albedo"])
        np.testing.assert_allclose(image.layers["albedo"][0, 0], color, atol=2e-3)


def test_means_leave_out_samples_that_see_nothing():
    """Half of a pixel is covered: its depth and albedo are those of the surface."""
    camera = rs.Camera((0, 2, 0), (0, 0, 0), (0, 0, -1), 1)
    half = rs.Mesh(np.maximum(FLOOR, [0.0, -9, -50]), FACES)
    scene = rs.Scene([half], materials=[rs.Material(diffuse=(0.5, 0.25, 0.75))])
    image = rs.render(scene, "vis", (1, 1), 64, camera=camera, layers="all")
    assert 0.3 < image.pixels[0, 0, 0] < 0.7
    np.testing.assert_allclose(image.layers["depth"], 2.0, rtol=1e-3)
    np.testing.assert_allclose(image.layers["albedo"][0, 0], [0.5, 0.25, 0.75], rtol=1e-6)
    first = rs.render(scene, "vis", (1, 1), 64, camera=camera, layers="all", seed=3)
    assert image.layers["prim_id"][0, 0] in (-1, 0, 1)
    ids = [
        rs.render(scene, "vis", (1, 1), 64, camera=camera, layers=["prim_id"], seed=seed)
        .layers["prim_id"]
        .item()
        for seed in range(12)
    ]
    assert ids[3] == first.layers["prim_id"].item()
    assert -1 in ids
    assert max(ids) >= 0


@pytest.mark.parametrize("mode", ["path", "whitted", "xray", "vis"])
def test_layers_change_no_light_and_are_the_same_in_every_mode(mode):
    tracer = rs.Tracer(rs.load("cornell"))
    plain = rs.render(tracer, mode, (20, 15), samples=3)
    image = rs.render(tracer, mode, (20, 15), samples=3, layers="all")
    np.testing.assert_array_equal(image.pixels, plain.pixels)
    assert set(plain.layers) == {"variance", "samples"}
    other = rs.render(tracer, "raycast", (20, 15), samples=3, layers="all")
    for name in NAMES:
        np.testing.assert_array_equal(image.layers[name], other.layers[name])


def test_emission_is_what_is_seen_of_lamps_and_the_background():
    """A lamp of radiance 3 in front of a blue background, over a floor that it lights."""
    materials = [rs.Material(), rs.Material(emission=(3.0, 2.0, 1.0))]
    up = np.array([[-1, 1, 0], [1, 1, 0], [1, 3, 0], [-1, 3, 0.0]])
    lamp = rs.Mesh(up, [[0, 1, 2], [0, 2, 3]], material_ids=1)
    scene = rs.Scene([rs.Mesh(FLOOR, FACES), lamp], materials=materials, background=(0, 0, 0.5))
    camera = rs.Camera((0, 2, 6), (0, 2, 0), (0, 1, 0), 50)
    image = rs.render(scene, "path", (21, 21), 1, camera=camera, layers="all")
    emission, prim_id = image.layers["emission"], image.layers["prim_id"]
    expected = np.select(
        [prim_id[..., None] >= 2, prim_id[..., None] < 0], [[3.0, 2.0, 1.0], [0, 0, 0.5]], 0.0
    )
    np.testing.assert_array_equal(emission, expected)
    assert len(np.unique(prim_id)) >= 4
    seen = (prim_id < 0) | (prim_id >= 2)
    assert (image.pixels[~seen] > 0).any()
    np.testing.assert_array_equal(image.pixels[prim_id < 0], emission[prim_id < 0])


def test_layers_do_not_depend_on_threads_and_bands(monkeypatch):
    scene = rs.load("cornell")
    whole = rs.render(scene, "vis", (40, 31), 3, layers="all")
    monkeypatch.setattr(sample_bands, "MOST_BAND", 100)
    for threads in (1, 3):
        try:
            rs.set_thread_count(threads)
            parts = rs.render(scene, "vis", (40, 31), 3, layers="all")
        finally:
            rs.set_thread_count(None)
        for name, layer in whole.layers.items():
            np.testing.assert_array_equal(parts.layers[name], layer)


def test_layers_go_on_from_a_checkpoint_to_the_same_bits(tmp_path):
    scene, options = rs.load("cornell"), {"size": (16, 12), "layers": "all"}
    whole = rs.render(scene, "vis", samples=7, **options)
    kept = tmp_path / "a.npz"
    rs.render(scene, "vis", samples=3, checkpoint=kept, **options)
    again = rs.render(scene, "vis", samples=7, checkpoint=kept, **options)
    assert set(again.layers) == {*NAMES, "emission", "variance", "samples"}
    for name, layer in whole.layers.items():
        np.testing.assert_array_equal(again.layers[name], layer)
    with pytest.raises(rs.FileFormatError, match="layers differ"):
        rs.render(scene, "vis", samples=9, checkpoint=kept, size=(16, 12), layers=["depth"])


@pytest.mark.parametrize("layers", ["depth", ["motion"], ["depth", "z"], [3]])
def test_bad_layers_are_named(layers):
    with pytest.raises(ValueError, match=r"^layers: expected .all. or a list of .depth."):
        rs.render(rs.load("cornell"), "vis", (4, 3), layers=layers)


def test_depth_is_that_of_the_hits_far_from_the_origin():
    """In scene units, of any scale."""
    for scale, offset in ((1e-20, 0.0), (1.0, 1e7), (1e20, 0.0)):
        scene = rs.Scene.from_arrays(FLOOR * scale + offset, FACES)
        eye = np.array([0.3, 2.0, 0.1]) * scale + offset
        camera = rs.Camera(eye, eye - [0, scale, 0], (0, 0, -1), 40)
        seen = rs.render(scene, "vis", (5, 5), camera=camera, layers=["depth"]).layers["depth"]
        np.testing.assert_allclose(seen[2, 2], 2.0 * scale, rtol=1e-5)
        corner = math.hypot(0.8 * math.tan(math.radians(20)), 0.8 * math.tan(math.radians(20)))
        np.testing.assert_allclose(seen[0, 0], 2.0 * scale * math.hypot(1, corner), rtol=1e-5)

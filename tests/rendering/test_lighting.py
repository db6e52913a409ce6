"""Lights that are too weak, and the light that is added to them."""

from __future__ import annotations

import math

import numpy as np
import pytest

import raystream as rs
from meshes import icosphere
from raystream.core.errors import FileFormatError
from raystream.rendering.contexts import make_context, seen_by
from raystream.rendering.lighting import ADDED, LEAST_LIGHT, LIGHTS, added_light, needs_light
from raystream.rendering.render import RENDERERS
from raystream.rendering.sample_bands import trace_sample
from raystream.rendering.sampling.sampler import Sampler

pytestmark = pytest.mark.filterwarnings("ignore:the scene's own lights")

BLACK = (0.0, 0.0, 0.0)
SIZE = (32, 24)


def terrain(glow, lights=(), **attributes):
    """Hills of 3,200 triangles, 40 x 40, of which a dozen glow as they are told."""
    steps = np.arange(41.0)
    x, z = (axis.ravel() for axis in np.meshgrid(steps, steps))
    vertices = np.stack([x, np.sin(x / 3) + np.cos(z / 4), z], axis=1)
    low = (np.arange(40)[:, None] * 41 + np.arange(40)).ravel()
    faces = np.concatenate([[low, low + 41, low + 1], [low + 1, low + 41, low + 42]], axis=1).T
    materials = np.zeros(len(faces), int)
    materials[::267] = 1
    assert materials.sum() == 12
    return rs.Scene(
        [rs.Mesh(vertices, faces, material_ids=materials)],
        materials=[rs.Material(diffuse=(0.5, 0.4, 0.3)), rs.Material("lamp", emission=glow)],
        lights=lights,
        camera=rs.Camera((20, 25, -15), (20, 0, 20), fov=50),
        **attributes,
    )


def lamp_in_a_box(radiance):
    """A ball and, apart from it, a lamp: one triangle of area 1/2, in a box of 4 x 4 x 4."""
    vertices, faces = icosphere(1)
    ball = rs.Mesh(np.where(np.abs(vertices) > 0.9, 2 * np.sign(vertices), vertices), faces)
    extent = np.ptp(ball.vertices, axis=0)
    lamp = rs.Mesh([[0, 1.5, 0], [1, 1.5, 0], [0, 1.5, 1]], [[0, 1, 2]], material_ids=1)
    materials = [rs.Material(), rs.Material(emission=(0.0, radiance, 0.0))]
    return rs.Scene([ball, lamp], materials=materials), 2 * float(extent @ np.roll(extent, 1))


# The measure


def test_power_over_the_area_of_the_box_decides():
    _, box_area = lamp_in_a_box(0.0)
    limit = LEAST_LIGHT * box_area / 0.5
    for factor, expected in ((0.99, True), (1.01, False)):
        scene, _ = lamp_in_a_box(factor * limit)
        assert len(scene.area_lights) == 1
        assert needs_light(scene) == expected
        assert not needs_light(scene, "file")


def inside(power):
    """Points of a box share its area: the mean irradiance is 4 pi I over that."""
    return rs.PointLight((0.3, 0, 0), (0, 0, power * 24 / 4))


#: In a box of 2 x 2 x 2; the radiance of a white surface is the argument.
LISTED = {
    "point": inside,
    "far point": lambda x: rs.PointLight((0, 100, 0), (x * math.pi * 1e4, 0, 0)),
    "steady point": lambda x: rs.PointLight((0, 900, 0), (x, x, x), "none"),
    "sun": lambda x: rs.DirectionalLight((0, -3, 0), (x * math.pi, 0, 0)),
    "sky": lambda x: rs.EnvironmentLight((0, x, 0)),
    "map": lambda x: rs.EnvironmentLight((0, 0, x / 5), np.full((2, 4, 3), 5.0)),
}


@pytest.mark.parametrize("kind", LISTED)
def test_listed_lights_count_by_what_a_white_surface_shows(kind):
    vertices, faces = icosphere(1)
    meshes = [rs.Mesh(vertices / vertices.max(), faces)]
    np.testing.assert_allclose(rs.Scene(meshes).bounds, [[-1] * 3, [1] * 3], atol=1e-6)
    for factor, expected in ((0.99, True), (1.01, False)):
        lights = [LISTED[kind](factor * LEAST_LIGHT)]
        assert needs_light(rs.Scene(meshes, lights=lights)) == expected
    two = [LISTED[kind](0.6 * LEAST_LIGHT)] * (1 if kind == "map" else 2)
    assert needs_light(rs.Scene(meshes, lights=two)) == (kind == "map")


def test_lights_that_are_off_need_no_light():
    """They say that the scene is meant to be dark."""
    off = [
        rs.PointLight((0, 9, 0), BLACK),
        rs.DirectionalLight((0, -1, 0), BLACK),
        rs.EnvironmentLight(image=np.zeros((2, 4, 3))),
    ]
    assert needs_light(terrain(BLACK))
    assert not needs_light(terrain((1e-3,) * 3, off))
    assert not rs.render(terrain(BLACK, off), "raycast", SIZE).pixels.any()


def test_backgrounds_light_paths_only():
    scene = terrain((1e-3,) * 3, background=(0.1, 0.2, 0.3))
    assert added_light(scene, "path") == ""
    assert added_light(scene, "raycast") == "a light at the eye"
    image = rs.render(scene, "path", SIZE, 4)
    own = rs.render(scene, "path", SIZE, 4, lights="file")
    np.testing.assert_array_equal(image.pixels, own.pixels)


@pytest.mark.parametrize("name", ["cornell", "cornell_mirrors", "boxes", "spheres", "robots"])
def test_built_in_scenes_have_light_enough(name):
    scene = rs.load(name)
    assert not needs_light(scene)
    assert [added_light(scene, mode) for mode in rs.MODES] == [""] * 8


# Images


@pytest.mark.parametrize("lights", [(), [rs.PointLight((20, 9, 20), (0.001, 0.001, 0.001))]])
@pytest.mark.parametrize("mode", ADDED)
def test_weak_emitters_leave_no_scene_dark(mode, lights):
    """With the light that a scene without any gets, and their own."""
    scene, bare = terrain((0.02, 0.02, 0.01), lights), terrain(BLACK)
    samples = 1 if ADDED[mode] == "a light at the eye" else 16
    dark = rs.render(scene, mode, SIZE, samples, lights="file")
    usual = rs.render(bare, mode, SIZE, samples)
    image = rs.render(scene, mode, SIZE, samples)
    is_seen = np.isfinite(rs.render(scene, "vis", SIZE, layers=["depth"]).layers["depth"])
    assert 0.3 < is_seen.mean() < 1.0
    assert dark.pixels.max() < 0.03
    assert image.pixels[is_seen].max(axis=1).min() > 0.05
    if samples == 1:
        np.testing.assert_allclose(image.pixels, usual.pixels + dark.pixels, atol=1e-6)
    else:
        assert abs(image.pixels.mean() - usual.pixels.mean()) < 0.01


@pytest.mark.parametrize("mode", ADDED)
def test_strong_lights_are_left_alone(mode):
    scene = terrain((4000.0, 4000.0, 2000.0))
    image = rs.render(scene, mode, SIZE)
    assert added_light(scene, mode) == ""
    np.testing.assert_array_equal(image.pixels, rs.render(scene, mode, SIZE, lights="file").pixels)


@pytest.mark.parametrize("mode", ADDED)
def test_scenes_without_lights_are_dark_if_asked(mode):
    scene = terrain(BLACK)
    assert rs.render(scene, mode, SIZE).pixels.any()
    assert not rs.render(scene, mode, SIZE, lights="file").pixels.any()
    assert added_light(scene, mode) == ""  # there are none to help


def test_modes_that_ignore_lights_are_named_none():
    scene = terrain((0.02, 0.02, 0.01))
    assert {mode: added_light(scene, mode) for mode in rs.MODES} == {
        **{"raycast": "a light at the eye", "vis": "", "shadow": "a light at the eye"},
        **{"whitted": "a light at the eye", "xray": "", "ao": ""},
        **{"kajiya": "a sun and a sky", "path": "a sun and a sky"},
    }
    assert not any(added_light(scene, mode, "file") for mode in rs.MODES)


def test_another_camera_keeps_the_choice():
    scene = terrain((0.02, 0.02, 0.01))
    tracer, renderer, one = rs.Tracer(scene), RENDERERS["raycast"], Sampler.of("sobol", 0, 1)
    far = rs.Camera((0, 30, 0), (20, 0, 20))
    for lights in LIGHTS:
        context = make_context(tracer, scene.camera, (8, 6), one, {}, chosen_lights=lights)
        light, _ = trace_sample(renderer, seen_by(context, far, SIZE), 0)
        expected = rs.render(tracer, "raycast", SIZE, camera=far, lights=lights).pixels
        np.testing.assert_array_equal(light.reshape(expected.shape), expected)


def test_a_checkpoint_with_other_lights_is_another_picture(tmp_path):
    kept = {"size": (4, 3), "checkpoint": tmp_path / "kept.npz"}
    rs.render(terrain((0.02, 0.02, 0.01)), "path", **kept)
    with pytest.raises(FileFormatError, match="another image"):
        rs.render(terrain((0.02, 0.02, 0.01)), "path", lights="file", **kept)


def test_frames_take_the_choice():
    scene = terrain((0.02, 0.02, 0.01))
    track = rs.CameraTrack(scene.camera, [[0, 20, 25, -15], [1, 20, 30, -15]])
    for lights in LIGHTS:
        ((_, image),) = rs.render_frames(
            scene, "raycast", frames=0, size=SIZE, camera=track, fps=2, lights=lights
        )
        expected = rs.render(scene, "raycast", size=SIZE, lights=lights)
        np.testing.assert_array_equal(image.pixels, expected.pixels)


def test_unknown_choices_are_refused():
    with pytest.raises(ValueError, match="lights: expected 'auto' or 'file' or 'added', got 'all'"):
        rs.render(terrain(BLACK), lights="all")

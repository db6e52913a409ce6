"""Images against results computed by hand."""

from __future__ import annotations

import math
import pickle
from types import FunctionType

import numpy as np
import pytest

import raystream as rs
from meshes import icosphere

FLOOR = np.array([[-50, 0, -50], [50, 0, -50], [50, 0, 50], [-50, 0, 50.0]])
FLOOR_FACES = [[0, 2, 1], [0, 3, 2]]
DOWN = rs.Camera((0, 2, 0), (0, 0, 0), (0, 0, -1), 60)


def floor(material=None, lights=(), **attributes):
    mesh = rs.Mesh(FLOOR, FLOOR_FACES, **attributes)
    return rs.Scene([mesh], materials=[material] if material else (), lights=lights, camera=DOWN)


def test_vis_is_the_cosine_to_the_viewer():
    """A sphere seen from afar: N.V falls from 1 to 0 as sqrt(1 - (r / R)^2)."""
    vertices, faces = icosphere(5)
    camera = rs.Camera((0, 0, 1000), (0, 0, 0), (0, 1, 0), math.degrees(2 * math.atan(1.25 / 1000)))
    image = rs.render(rs.Scene.from_arrays(vertices, faces), "vis", (101, 101), camera=camera)
    x = (np.arange(101) + 0.5 - 50.5) / 50.5 * 1.25
    radius = np.hypot(x[None, :], x[:, None])
    expected = np.sqrt(np.maximum(1 - radius**2, 0))
    inside = radius < 0.97
    np.testing.assert_allclose(image.pixels[inside, 0], expected[inside], atol=0.03)
    assert not image.pixels[radius > 1.01].any()
    np.testing.assert_array_equal(image.pixels[..., 0], image.pixels[..., 1])


def test_a_point_light_falls_with_the_square_and_the_cosine():
    """Radiance = albedo / pi * I cos / r^2, at every pixel."""
    light = rs.PointLight((1, 3, 0), (20.0, 10.0, 5.0))
    image = rs.render(floor(rs.Material(diffuse=(0.5, 0.25, 1.0)), [light]), "raycast", (64, 48))
    origins, directions = DOWN.rays(64, 48)
    points = origins + directions * (-origins[..., 1:2] / directions[..., 1:2])
    offset = np.array([1, 3, 0]) - points
    r2 = (offset**2).sum(axis=-1)
    factor = (3 / np.sqrt(r2) / r2 / math.pi)[..., None]
    expected = factor * np.array([20, 10, 5]) * [0.5, 0.25, 1.0]
    np.testing.assert_allclose(image.pixels, expected, rtol=1e-4)


@pytest.mark.parametrize("mode", ["raycast", "shadow", "whitted"])
def test_a_spot_fades_at_its_edge(mode):
    """Radiance = albedo / pi * I cos / r^2, times the formula of ``KHR_lights_punctual``."""
    light = rs.SpotLight((0.5, 3, 0), (0.1, -2, 0), (20.0, 10.0, 5.0), 5, 20)
    image = rs.render(floor(rs.Material(diffuse=(0.5, 0.25, 1.0)), [light]), mode, (64, 48))
    origins, directions = DOWN.rays(64, 48)
    points = origins + directions * (-origins[..., 1:2] / directions[..., 1:2])
    offset = np.array([0.5, 3, 0]) - points
    r2 = (offset**2).sum(axis=-1)
    axis = np.array([0.1, -2, 0]) / np.linalg.norm([0.1, -2, 0])
    outer, inner = np.cos(np.radians(20)), np.cos(np.radians(5))
    fading = np.clip((-offset @ axis / np.sqrt(r2) - outer) / (inner - outer), 0, 1) ** 2
    assert (fading == 0).any()
    assert (fading == 1).any()
    factor = (fading * 3 / np.sqrt(r2) / r2 / math.pi)[..., None]
    expected = factor * np.array([20, 10, 5]) * [0.5, 0.25, 1.0]
    np.testing.assert_allclose(image.pixels, expected, rtol=1e-3, atol=1e-5)


def test_a_light_without_falloff_shows_its_colour_on_white():
    light = rs.PointLight((0, 4000, 0), (0.5, 0.25, 1.0), falloff="none")
    image = rs.render(floor(rs.Material(diffuse=(1, 1, 1)), [light]), "raycast", (8, 6))
    np.testing.assert_allclose(
        image.pixels, np.broadcast_to([0.5, 0.25, 1.0], (6, 8, 3)), rtol=1e-4
    )


def test_a_directional_light_and_an_environment():
    lights = [rs.DirectionalLight((0, -2, 0), (math.pi, 0, 0)), rs.EnvironmentLight((0, 0.5, 0))]
    image = rs.render(floor(rs.Material(diffuse=(0.6, 0.6, 0.6)), lights), "raycast", (8, 6))
    np.testing.assert_allclose(image.pixels[2, 3], [0.6, 0.3, 0], rtol=1e-5)


def test_light_from_below_does_not_reach_the_top():
    image = rs.render(
        floor(lights=[rs.PointLight((0, -1, 0), (9, 9, 9))]), "raycast", (8, 6), lights="file"
    )
    assert not image.pixels.any()


def test_an_area_light_is_seen_and_lights_as_its_area_would():
    """A small square lamp above the floor: E = L A cos cos / r^2, beneath it L A / h^2."""
    side, height, radiance = 0.2, 10.0, 30.0
    lamp = np.array([[-1, 0, -1], [1, 0, -1], [1, 0, 1], [-1, 0, 1.0]]) * side / 2 + [0, height, 0]
    scene = rs.Scene(
        [
            rs.Mesh(FLOOR, FLOOR_FACES, material_ids=0),
            rs.Mesh(lamp, [[0, 1, 2], [0, 2, 3]], material_ids=1),
        ],
        materials=[rs.Material(diffuse=(1, 1, 1)), rs.Material(emission=(radiance,) * 3)],
        camera=DOWN,
    )
    assert [light.prim_ids.tolist() for light in scene.area_lights] == [[2, 3]]
    own = {"lights": "file"}  # too weak to see by
    image = rs.render(scene, "raycast", (9, 9), **own)
    box = scene.bounds[1] - scene.bounds[0]
    ambient = radiance * side**2 / (2 * (box[0] * box[1] + box[1] * box[2] + box[2] * box[0]))
    expected = radiance * side**2 / height**2 / math.pi + ambient
    np.testing.assert_allclose(image.pixels[4, 4], expected, rtol=2e-3)
    up = rs.Camera((0, 2, 0), (0, height, 0), (0, 0, 1), 0.5)
    glowing = rs.render(scene, "raycast", (3, 3), camera=up, **own).pixels
    np.testing.assert_allclose(glowing, radiance, rtol=1e-5)  # and a little ambient light
    behind = rs.Camera((0, 2 * height, 0), (0, height, 0), (0, 0, 1), 0.3)
    assert rs.render(scene, "raycast", (3, 3), camera=behind, **own).pixels.max() < 1


def test_a_highlight_is_where_the_mirror_points():
    shiny = rs.Material(diffuse=(0, 0, 0), specular=(1, 1, 1), shininess=200)
    light = rs.PointLight((1.0, 2, 0), (1, 1, 1), falloff="none")
    image = rs.render(floor(shiny, [light]), "raycast", (160, 120))
    row, column = np.unravel_index(image.pixels[..., 0].argmax(), (120, 160))
    origins, directions = DOWN.rays(160, 120)
    ray = directions[row, column]
    point = origins[row, column] - ray * (2 / ray[1])
    np.testing.assert_allclose(point, [0.5, 0, 0], atol=0.02)  # halfway, as both are at height 2
    assert image.pixels.max() > 0.95


def test_vertex_colours_and_normals_are_interpolated():
    colors = [[1, 0, 0], [0, 1, 0], [0, 1, 0], [1, 0, 0]]
    sun = [rs.DirectionalLight((0, -1, 0), (math.pi,) * 3)]
    image = rs.render(
        floor(rs.Material(diffuse=(1, 1, 1)), sun, colors=colors), "raycast", (41, 31)
    )
    origins, directions = DOWN.rays(41, 31)
    x = (origins - directions * (2 / directions[..., 1:2]))[..., 0]
    np.testing.assert_allclose(image.pixels[..., 1], (x + 50) / 100, atol=1e-4)
    np.testing.assert_allclose(image.pixels[..., 0], (50 - x) / 100, atol=1e-4)
    tilted = np.array([[0.6, 0.8, 0]] * 4)
    image = rs.render(floor(rs.Material(diffuse=(1, 1, 1)), sun, normals=tilted), "raycast", (5, 5))
    np.testing.assert_allclose(image.pixels, 0.8, rtol=1e-5)


def test_textures_are_decoded_repeated_and_right_side_up():
    """Lower left of the image at (0, 0); texels' centres show their own colour."""
    pixels = np.array([[[255, 0, 0], [0, 255, 0]], [[0, 0, 255], [188, 188, 188]]], np.uint8)
    material = rs.Material(diffuse=(1, 1, 1), textures={"diffuse": rs.Texture(pixels)})
    texcoords = FLOOR[:, [0, 2]] * [1, -1]  # one image per unit, up is -z
    sun = [rs.DirectionalLight((0, -1, 0), (math.pi,) * 3)]
    scene = floor(material, sun, texcoords=texcoords)
    targets = [
        (0.25, -0.25),
        (0.75, -0.25),
        (0.25, -0.75),
        (0.75, -0.75),
        (-1.75, 3.75),
        (0.5, -0.25),
    ]
    expected = [
        (0, 0, 1),
        (0.503, 0.503, 0.503),
        (1, 0, 0),
        (0, 1, 0),
        (0, 0, 1),
        (0.25, 0.25, 0.75),
    ]
    for (x, z), color in zip(targets, expected, strict=True):
        camera = rs.Camera((x, 1, z), (x, 0, z), (0, 0, -1), 1e-3)
        seen = rs.render(scene, "raycast", (1, 1), camera=camera).pixels[0, 0]
        np.testing.assert_allclose(seen, color, atol=3e-3)


def test_an_unreadable_texture_is_left_out_with_a_warning(tmp_path):
    (tmp_path / "broken.png").write_bytes(b"\x89PNG\r\n\x1a\nrubbish")
    texture = rs.Texture(tmp_path / "broken.png")
    scene = floor(rs.Material(textures={"diffuse": texture}), texcoords=FLOOR[:, :2])
    with pytest.warns(rs.RaystreamWarning, match=r"broken\.png"):
        image = rs.render(scene, size=(4, 3))
    assert image.pixels.any()


def test_rays_that_miss_see_the_background():
    scene = rs.Scene(background=(0.25, 0.5, 0.75), camera=DOWN)
    for mode in rs.MODES:
        seen = [0.0, 0.0, 0.0] if mode == "ao" else [0.25, 0.5, 0.75]  # it shows no light
        assert (rs.render(scene, mode, (4, 3)).pixels == seen).all(), mode


def test_samples_smooth_edges_and_keep_the_mean():
    """The edge of a half plane through a pixel: its cover is the mean of many samples."""
    camera = rs.Camera((0, 2, 0), (0, 0, 0), (0, 0, -1), 20)
    half = rs.Mesh([[0.001, 0, -9], [9, 0, -9], [9, 0, 9], [0.001, 0, 9]], FLOOR_FACES)
    scene = rs.Scene([half], camera=camera)
    one = rs.render(scene, "vis", (8, 6)).pixels
    many = rs.render(scene, "vis", (9, 6), samples=256).pixels
    assert set(np.unique(one > 0.5)) == {False, True}
    np.testing.assert_allclose(
        many[:, 4].mean(), 0.5, atol=0.02
    )  # the middle column is cut in half
    assert not many[:, :4].any()
    same = rs.render(scene, "vis", (9, 6), samples=4, seed=5).pixels
    np.testing.assert_array_equal(same, rs.render(scene, "vis", (9, 6), samples=4, seed=5).pixels)
    assert (same != rs.render(scene, "vis", (9, 6), samples=4, seed=6).pixels).any()


@pytest.mark.parametrize("mode", rs.MODES)
def test_structures_give_the_same_picture(mode):
    scene = rs.load("cornell")
    brute = rs.render(scene, mode, (40, 30), structure="brute")
    bvh = rs.render(rs.Tracer(scene), mode, (40, 30))
    np.testing.assert_array_equal(brute.pixels, bvh.pixels)
    assert brute.pixels.any()


def test_progress_counts_rays_and_can_end_the_rendering():
    seen = []
    rs.render(rs.load("cornell"), size=(600, 500), samples=2, progress=lambda *a: seen.append(a))
    assert seen
    assert seen[-1] == (600_000, 600_000)
    assert seen == sorted(seen)

    def stop(done, total):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        rs.render(rs.load("cornell"), progress=stop)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"mode": "photo"}, "mode: expected one of 'raycast', 'vis'"),
        ({"size": (0, 5)}, "size"),
        ({"size": (5,)}, "size"),
        ({"size": (1.5, 5)}, "size"),
        ({"size": (1 << 20, 1 << 20)}, "size"),
        ({"samples": 0}, "samples"),
        ({"structure": "octree"}, "structure: expected one of 'bvh', 'brute'"),
        ({"device": "abacus"}, "device: expected one of 'cpu'"),
    ],
)
def test_bad_options_are_named(options, words):
    with pytest.raises(ValueError, match=words):
        rs.render(rs.load("cornell"), **options)


def test_a_tracer_brings_its_own_structure():
    tracer = rs.Tracer(rs.load("cornell"))
    with pytest.raises(ValueError, match="has its own"):
        rs.render(tracer, structure="brute")
    with pytest.raises(TypeError, match="scene: expected a Scene"):
        rs.render("cornell")


@pytest.mark.parametrize("size", [(1, 1), (3, 700), (700, 3), (300, 301)])
def test_bands_and_threads_do_not_show(size, monkeypatch):
    scene = rs.load("cornell")
    monkeypatch.setattr("raystream.rendering.sample_bands.LEAST_BAND", 1 << 30)
    monkeypatch.setattr("raystream.rendering.sample_bands.MOST_BAND", 1 << 30)
    whole = rs.render(scene, size=size, samples=3).pixels
    assert whole.any() or size == (1, 1)
    monkeypatch.setattr("raystream.rendering.sample_bands.MOST_BAND", 1000)
    for threads in (1, 3):
        try:
            rs.set_thread_count(threads)
            bands = rs.render(scene, size=size, samples=3).pixels
        finally:
            rs.set_thread_count(None)
        np.testing.assert_array_equal(bands, whole)


def test_render_is_a_function_whatever_was_imported_first():
    import raystream.rendering.image  # noqa: F401

    assert isinstance(rs.render, FunctionType)
    assert "Render an image" in rs.render.__doc__
    assert pickle.loads(pickle.dumps(rs.render)) is rs.render


@pytest.mark.parametrize(("offset", "scale"), [(1e7, 1.0), (1e9, 1.0), (0, 1e-30), (0, 1e30)])
def test_pictures_do_not_depend_on_where_the_scene_is_nor_on_its_scale(offset, scale):
    vertices, faces = icosphere(3)

    def picture(offset, scale):
        lamp = rs.Mesh(
            np.array([[-1, 2, -1], [1, 2, -1], [0, 2, 1]]) * scale + offset,
            [[0, 1, 2]],
            material_ids=1,
        )
        eye, target = np.array([1.0, 2, 4]) * scale + offset, np.zeros(3) + offset
        scene = rs.Scene(
            [rs.Mesh(vertices * scale + offset, faces), lamp],
            materials=[rs.Material(), rs.Material(emission=(3, 3, 3))],
            lights=[rs.PointLight(np.array([3.0, 1, 1]) * scale + offset, falloff="none")],
            camera=rs.Camera(eye, target),
        )
        return rs.render(scene, "raycast", (40, 30)).pixels

    here, there = picture(0, 1.0), picture(offset, scale)
    # A silhouette's pixel may fall to the other side.
    different = np.abs(here - there).max(axis=2) > 2e-3
    assert np.count_nonzero(different) <= 3


def test_a_light_on_the_surface_is_no_nan():
    scene = floor(lights=[rs.PointLight((0, 0, 0), (1, 1, 1))])
    image = rs.render(
        scene,
        "raycast",
        (5, 5),
        camera=rs.Camera((0, 2, 0), (0, 0, 0), (0, 0, -1), 60),
        lights="file",
    )
    assert np.isfinite(image.pixels).all()


def test_a_scene_without_a_camera_fits_pictures_of_any_shape():
    vertices, faces = icosphere(2)
    for size in ((90, 30), (30, 90)):
        seen = rs.render(rs.Scene.from_arrays(vertices, faces), "vis", size).pixels[..., 0] > 0
        assert seen.any()
        assert not seen[[0, -1]].any()
        assert not seen[:, [0, -1]].any()

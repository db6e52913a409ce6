"""Path-traced images: equal in expectation for all strategies, and the same bits."""

from __future__ import annotations

import numpy as np
import pytest

import raystream as rs
from conftest import assert_same_bits
from meshes import cube, icosphere
from raystream.rendering.lighting import SKY as SKY_ADDED
from raystream.rendering.lighting import SUN as SUN_ADDED
from z_test import assert_equal_means, assert_mean, assert_zero, mean_of, spread_limits

WHITE = (1.0, 1.0, 1.0)
NONE = (0.0, 0.0, 0.0)

MATERIALS = [
    rs.Material("wall", diffuse=(0.7, 0.5, 0.3)),
    rs.Material("lamp", diffuse=(0.2, 0.2, 0.2), emission=(4.0, 3.0, 2.0)),
    rs.Material("ball", diffuse=(0.3, 0.3, 0.1), specular=(0.4, 0.4, 0.6), shininess=30.0),
    rs.Material("glass", diffuse=NONE, transmission=WHITE, ior=1.5),
    rs.Material("steel", diffuse=(0.1, 0.1, 0.1), reflection=(0.8, 0.8, 0.8)),
]
WALL, LAMP, BALL, GLASS, STEEL = range(5)


def part(shape, material_id, scale=1.0, at=(0.0, 0.0, 0.0)):
    vertices, faces = shape
    return rs.Mesh(vertices * np.asarray(scale) + at, faces, material_ids=material_id)


def room(ball=BALL, lights=(), scale=1.0):
    """A box without a front, with a large lamp below its ceiling, a ball and a mirror."""
    vertices, faces = cube()
    open_box = faces[~(vertices[faces][..., 2] == 1).all(axis=1)][:, ::-1]
    lamp = np.array([[0.2, 0.95, 0.2], [0.8, 0.95, 0.2], [0.8, 0.95, 0.8], [0.2, 0.95, 0.8]])
    parts = [
        part((vertices, open_box), WALL, scale),
        part((lamp, [[0, 1, 2], [0, 2, 3]]), LAMP, scale),
        part(icosphere(1), ball, 0.2 * scale, np.array([0.35, 0.25, 0.5]) * scale),
        part(cube(), STEEL, 0.3 * scale, np.array([0.6, 0.001, 0.2]) * scale),
    ]
    eye, target = np.array([0.5, 0.5, 2.2]) * scale, np.array([0.5, 0.45, 0.0]) * scale
    return rs.Scene(
        parts, materials=MATERIALS, lights=lights, camera=rs.Camera(eye, target, fov=40)
    )


def path(scene, samples=16, size=(32, 32), **options):
    return rs.render(scene, "path", size, samples, **{"seed": 1, "sampler": "random", **options})


# Means


SKY = [rs.EnvironmentLight((0.2, 0.4, 0.8))]


@pytest.mark.parametrize("bounces", [1, 5])
@pytest.mark.parametrize("lights", [[], SKY], ids=["lamp", "lamp and sky"])
@pytest.mark.parametrize("ball", [BALL, GLASS])
def test_samples_of_lights_change_no_mean(ball, lights, bounces):
    """Light found by chance, or by samples of the lights and weighed: part by part the same."""
    scene = room(ball, lights)
    sampled = path(scene, 64, max_bounces=bounces)
    chance = path(scene, 128, max_bounces=bounces, light_samples=False, seed=2)
    assert_equal_means(sampled, chance)
    assert_equal_means(sampled, chance, blocks=8)
    noise, chance_noise = mean_of(sampled)[1].sum(), mean_of(chance)[1].sum()
    assert noise < chance_noise  # with half the samples


def test_a_light_in_glass_is_found():
    """No ray to a light gets through glass: only paths that enter it by chance do."""
    lamp_in_ball = part(icosphere(1), LAMP, 0.5), part(icosphere(1), GLASS)
    floor = np.array([[-9, -1.2, -9], [9, -1.2, -9], [9, -1.2, 9], [-9, -1.2, 9.0]])
    floor = part((floor, [[0, 2, 1], [0, 3, 2]]), WALL)
    camera = rs.Camera((0, 2, 6), (2.5, -1.2, 2), fov=20)  # sees the floor only
    scene = rs.Scene([*lamp_in_ball, floor], materials=MATERIALS, camera=camera)
    chosen = {"max_bounces": 50, "lights": "file"}
    sampled = path(scene, 64, **chosen)
    chance = path(scene, 64, light_samples=False, seed=2, **chosen)
    assert_equal_means(sampled, chance, blocks=4)
    assert mean_of(sampled, 4)[0].min() > 0.0
    assert not path(scene, 8, max_bounces=1, lights="file").pixels.any()


def test_light_in_glass_leaves_it_thinner():
    """Radiance is the squared index of refraction times as large within: L / n^2 (1 - F)."""
    square = np.array([[-9, 0, -9], [9, 0, -9], [9, 0, 9], [-9, 0, 9.0]])
    faces = [[0, 2, 1], [0, 3, 2]]
    black = rs.Material(diffuse=NONE, emission=(4.0, 3.0, 2.0))
    scene = rs.Scene(
        [part((square, faces), 0), part((square, faces), 1, at=(0, 1, 0))],
        materials=[black, MATERIALS[GLASS]],
        camera=rs.Camera((0, 4, 0), (0, 0, 0), (0, 0, -1), 0.01),
    )
    through = 1 - ((1.5 - 1) / (1.5 + 1)) ** 2
    expected = np.array([4.0, 3.0, 2.0]) * through / 1.5**2
    assert_mean(path(scene, max_bounces=2), expected)


def test_lights_that_no_ray_can_hit_are_reported():
    floor = rs.Mesh([[-9, -9, 0], [9, -9, 0], [0, 9, 0]], [[0, 1, 2]])
    camera = rs.Camera(eye=(0, -3, 3), look_at=(0, 0, 0))
    lamp = rs.PointLight((0, 0, 5), (50.0, 50.0, 50.0))
    scene = rs.Scene([floor], lights=[lamp], camera=camera)
    with pytest.warns(rs.RaystreamWarning, match="no ray can hit this scene's lights"):
        image = rs.render(scene, "path", preset="arnold", size=(8, 8), lights="file")
    assert not image.pixels.any()
    assert rs.render(scene, "path", size=(8, 8)).pixels.any()
    for more in ({"background": (0.1, 0.1, 0.1)}, {"materials": [rs.Material(emission=(1, 1, 1))]}):
        lit = rs.Scene([floor], lights=[lamp], camera=camera, **more)
        assert rs.render(lit, "path", preset="arnold", size=(8, 8)).pixels.any()


def test_arnold_sees_diffuse_reflection_only():
    """Purcell 2002, section 3.1.4: as if the materials had nothing else."""
    scene = room()
    plain = [rs.Material(diffuse=one.diffuse, emission=one.emission) for one in scene.materials]
    options = {"size": (16, 16), "samples": 4}
    arnold = rs.render(scene, "path", preset="arnold", **options)
    usual = rs.render(scene, "path", **options, max_bounces=2, light_samples=False)
    bare = scene.replace(materials=plain)
    expected = rs.render(bare, "path", **options, max_bounces=2, light_samples=False)
    assert_same_bits(arnold.pixels, expected.pixels)
    assert (arnold.pixels != usual.pixels).any()
    deeper = rs.render(scene, "path", preset="arnold", max_bounces=3, **options)
    assert (deeper.pixels != arnold.pixels).any(), "options override a preset's"


def matte():
    """A room without mirrors and glass."""
    return rs.load("cornell")


@pytest.mark.parametrize("bounces", range(1, 4))
def test_kajiya_has_the_light_of_as_many_surfaces_as_path(bounces):
    """Its last surface only samples the lights, which finds all light of matte surfaces."""
    sizes = {"size": (16, 16), "samples": 256, "max_bounces": bounces}
    ours, kajiya = (rs.render(matte(), mode, **sizes) for mode in ("path", "kajiya"))
    error = np.sqrt(sum(image.layers["variance"].sum() for image in (ours, kajiya)))
    assert abs(ours.pixels.sum() - kajiya.pixels.sum()) < 4.0 * error
    assert not np.array_equal(ours.pixels, kajiya.pixels)


# Spread


SEEDS = 24
BLOCKS = 4


@pytest.fixture(scope="module")
def truth():
    return path(room(lights=SKY), 1024, (16, 16), max_bounces=3, seed=99)


@pytest.mark.ci
@pytest.mark.parametrize("sampler", ["sobol", "stratified", "random"])
def test_seeds_agree_and_spread_as_estimated(sampler, truth):
    """Means of blocks over seeds: chi-square about their own mean, and a Z-test of that.

    Even numbers spread less than estimated, never more; those of the sampler "random" just so.
    """
    scene = rs.Tracer(room(lights=SKY))
    options = {"sampler": sampler, "max_bounces": 3}
    pictures = [path(scene, 16, (16, 16), **options, seed=seed) for seed in range(SEEDS)]
    means, variances = map(np.array, zip(*(mean_of(p, BLOCKS) for p in pictures), strict=True))
    deviations = means - means.mean(axis=0)
    low, high = spread_limits(BLOCKS**2 * (SEEDS - 1))
    for channel in range(3):
        statistic = ((deviations**2).sum(axis=0) / variances.mean(axis=0))[:, channel].sum()
        assert statistic < high
        assert statistic > low or sampler != "random"
        assert statistic < low or sampler == "random"  # better than chance
    true_mean, true_variance = mean_of(truth, BLOCKS)
    mean_variances = variances.mean(axis=0) / SEEDS
    assert_zero(means.mean(axis=0) - true_mean, mean_variances + true_variance, true_mean)


# Bits


@pytest.mark.parametrize("sampler", ["sobol", "stratified", "random"])
def test_threads_do_not_show(sampler, monkeypatch):
    monkeypatch.setattr("raystream.rendering.sample_bands.LEAST_BAND", 64)
    scene = room(GLASS, SKY)
    pictures = []
    for threads in (1, 2, 3):
        try:
            rs.set_thread_count(threads)
            pictures.append(path(scene, 3, (37, 29), sampler=sampler))
        finally:
            rs.set_thread_count(None)
    for picture in pictures[1:]:
        assert_same_bits(picture.pixels, pictures[0].pixels)
        assert_same_bits(picture.layers["variance"], pictures[0].layers["variance"])


@pytest.mark.parametrize("sampler", ["sobol", "stratified", "random"])
def test_a_break_does_not_show(sampler, tmp_path):
    scene = room(GLASS, SKY)
    whole = path(scene, 6, sampler=sampler)
    file = tmp_path / "sums.npz"

    def stop(done, total):
        if done >= total / 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        path(scene, 6, sampler=sampler, checkpoint=file, progress=stop)
    parts = path(scene, 6, sampler=sampler, checkpoint=file)
    assert_same_bits(parts.pixels, whole.pixels)
    assert_same_bits(parts.layers["variance"], whole.layers["variance"])


@pytest.mark.parametrize("sampler", ["sobol", "random"])
def test_a_picture_may_have_more_samples_later(sampler, tmp_path):
    file = tmp_path / "sums.npz"
    scene = room(GLASS, SKY)
    path(scene, 3, sampler=sampler, checkpoint=file)
    more = path(scene, 5, sampler=sampler, checkpoint=file)
    assert_same_bits(more.pixels, path(scene, 5, sampler=sampler).pixels)


# Awkward scenes


def test_black_walls_show_lights_only():
    dark = rs.Material(diffuse=NONE)
    lit = room(lights=SKY)
    materials = [dark, rs.Material(diffuse=NONE, emission=(4.0, 3.0, 2.0)), dark, dark, dark]
    scene = rs.Scene(lit.meshes, materials=materials, lights=SKY, camera=lit.camera)
    image = path(scene, 4)
    assert_same_bits(image.pixels, path(scene, 4, max_bounces=0).pixels)
    assert (image.pixels == 0).any()
    assert (image.pixels > 0).any()


def test_lights_that_are_off_leave_it_dark():
    off = [rs.EnvironmentLight(NONE), rs.PointLight((0.5, 0.5, 0.5), NONE)]
    meshes = [mesh for mesh in room().meshes if LAMP not in mesh.material_ids]
    scene = rs.Scene(meshes, materials=MATERIALS, lights=off, camera=room().camera)
    assert not path(scene, 2).pixels.any()


def test_an_empty_scene_shows_its_sky():
    camera = rs.Camera((0, 0, 1), (0, 0, 0))
    assert (path(rs.Scene(camera=camera), 2).pixels == np.float32(SKY_ADDED)).all()
    sky = [rs.EnvironmentLight((0.25, 0.5, 0.25)), rs.PointLight((0, 0, 0))]
    lit = rs.Scene(camera=camera, lights=sky, background=(0.25, 0.0, 0.5))
    assert (path(lit, 2).pixels == [0.5, 0.5, 0.75]).all()


def test_a_scene_without_lights_stands_under_a_sky_and_a_sun():
    """The sun is over the viewer's left shoulder, wherever that is."""
    meshes = [mesh for mesh in room().meshes if LAMP not in mesh.material_ids]
    sky = rs.EnvironmentLight((SKY_ADDED,) * 3)
    back = rs.Camera((0.9, 0.8, 0.1), (0.2, 0.1, 0.9))
    for camera in (room().camera, back):
        right, up, forward = camera.basis()
        sun = rs.DirectionalLight(0.5 * right - 0.7 * up + 0.7 * forward, (np.pi * SUN_ADDED,) * 3)
        bare = rs.Scene(meshes, materials=MATERIALS, camera=camera)
        expected = path(bare.replace(lights=[sun, sky]), 2).pixels
        np.testing.assert_allclose(path(bare, 2).pixels, expected, rtol=1e-5)
        moved = rs.Tracer(bare.replace(camera=back))
        np.testing.assert_array_equal(path(moved, 2, camera=camera).pixels, path(bare, 2).pixels)


def test_degenerate_triangles_change_nothing():
    """Neither walls nor lamps: points, needles, and corners that are no numbers."""
    scene = room(GLASS, SKY)
    corners = [[0.5, 0.5, 0.5], [0.6, 0.6, 0.6], [0.7, 0.7, 0.7], [np.nan, 0, 0], [0, 0, 0.5]]
    faces = [[0, 0, 0], [0, 1, 2], [0, 1, 1], [0, 3, 4]]
    flat = [rs.Mesh(corners, faces, material_ids=material) for material in (WALL, LAMP, GLASS)]
    meshes = [*flat, *scene.meshes]
    more = rs.Scene(meshes, materials=MATERIALS, lights=SKY, camera=scene.camera)
    assert more.skipped_count >= 12
    assert_same_bits(path(more, 4).pixels, path(scene, 4).pixels)


@pytest.mark.parametrize("scale", [1e6, 1e-6])
@pytest.mark.parametrize("ball", [BALL, GLASS])
def test_radiance_does_not_change_with_scale(ball, scale):
    """The same paths except for rounding, which sends some past an edge."""
    here, there = path(room(ball, SKY)), path(room(ball, SKY, scale))
    assert_equal_means(here, there, blocks=4)
    difference = np.abs(here.pixels - there.pixels).max(axis=2)
    assert (difference > 1e-3).mean() < 0.02


@pytest.mark.parametrize("scale", [1e6, 1e-6])
def test_points_and_suns_scale_too(scale):
    """Intensity grows with the square of length; irradiance does not."""

    def picture(scale):
        lights = [
            rs.PointLight(np.array([0.5, 0.8, 1.5]) * scale, np.array([2, 1, 3]) * scale**2),
            rs.PointLight(np.array([0.2, 0.2, 1.5]) * scale, (0.1, 0.2, 0.1), falloff="none"),
            rs.DirectionalLight((0.1, -0.3, -1), (0.3, 0.6, 0.9)),
        ]
        return path(room(BALL, lights, scale))

    here, there = picture(1.0), picture(scale)
    assert_equal_means(here, there, blocks=4)
    difference = np.abs(here.pixels - there.pixels).max(axis=2)
    assert (difference > 1e-3).mean() < 0.02

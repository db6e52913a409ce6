"""Environment maps: where they are seen, how they are sampled, and the light that they give."""

from __future__ import annotations

import math

import numpy as np
import pytest

import raystream as rs
from chi_square import assert_follows
from extras import need
from meshes import icosphere
from raystream.jit.cpu import kernel
from raystream.rendering.environment import axes_of, mean_radiance, row_heights, texels_of
from raystream.rendering.shading.punctual_lights import punctual_lights_of
from raystream.rendering.shading.sky import relative_pdf, sample_image, sky_of, sky_radiance
from z_test import assert_equal_means, assert_mean, mean_of

UPS = {"y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0), "x": (-3.0, 0.0, 0.0), "any": (1.0, 2.0, -0.5)}

#: Light that does not reach the visible surfaces, so that no default sky is added.
OFF = rs.PointLight((0, 0, 0), (0, 0, 0))


def random_map(height=8, width=16):
    return np.random.default_rng(3).random((height, width, 3)).astype(np.float32)


def sunny_map(height=8, width=12):
    """A sun of one texel, a sky that is brighter above, and rows without light."""
    texels = random_map(height, width) * np.linspace(2.0, 0.0, height)[:, None, None] ** 2
    texels[height // 2 + 1 :] = 0.0
    texels[2, 3] = (900.0, 700.0, 500.0)
    return texels.astype(np.float32)


def patch(row, column, height=8, width=16):
    texels = np.zeros((height, width, 3), np.float32)
    texels[row, column] = (30.0, 20.0, 10.0)
    return texels


def path(scene, samples=16, size=(32, 32), **options):
    options = {"sampler": "random", "seed": 7, **options}
    return rs.render(scene, "path", size, samples, **options)


def floor(lights, material=None, **attributes):
    """A floor at y = 0, and a camera that sees one point of it."""
    corners = np.array([[-9, 0, -9], [9, 0, -9], [9, 0, 9], [-9, 0, 9.0]])
    material = material or rs.Material(diffuse=ALBEDO)
    camera = rs.Camera((-2, 1.5, 0.4), (0, 0, 0), fov=1e-3)
    return rs.Scene(
        [rs.Mesh(corners, [[0, 2, 1], [0, 3, 2]])],
        materials=[material],
        lights=lights,
        **{"camera": camera, **attributes},
    )


ALBEDO = (0.5, 0.6, 0.7)


# Where it is


def turned(vector, axis, degrees):
    """Rodrigues' formula."""
    axis, angle = np.array(axis) / np.linalg.norm(axis), math.radians(degrees)
    across = np.cross(axis, vector)
    along = axis * (axis @ vector) * (1 - math.cos(angle))
    return np.array(vector) * math.cos(angle) + across * math.sin(angle) + along


def middle_of(up, rotation):
    """Direction of the centre of an image, as documented."""
    up = np.array(up) / np.linalg.norm(up)
    side = np.array([0.0, 0, 1]) if abs(up[0]) == 1 else np.array([1.0, 0, 0])
    return turned(np.cross(up, side - (side @ up) * up), up, rotation)


@pytest.mark.parametrize("rotation", [0, 90, -1000])
@pytest.mark.parametrize("up", UPS)
def test_a_camera_around_sees_the_image(up, rotation):
    """A camera aimed at its centre, with as many pixels: texel by texel."""
    texels = random_map()
    light = rs.EnvironmentLight((1, 2, 3), texels, UPS[up], rotation)
    middle = middle_of(UPS[up], rotation)
    camera = rs.Camera((0, 0, 0), middle, UPS[up], projection="equirectangular")
    speck = rs.Mesh(np.eye(3) * 1e-6 + [300, 500, 700], [[0, 1, 2]])
    scene = rs.Scene([speck], lights=[light], camera=camera, background=(0.5, 0.0, 0.25))
    tracer = rs.Tracer(scene)
    for mode in ("raycast", "vis", "shadow", "whitted", "xray", "path"):
        image = rs.render(tracer, mode, (16, 8), 1)
        expected = texels * [1, 2, 3] + np.array([0.5, 0, 0.25])
        np.testing.assert_allclose(image.pixels, expected, rtol=1e-5, atol=1e-6, err_msg=mode)


def test_the_middle_is_where_it_is_said_to_be():
    assert middle_of(UPS["y"], 0) == pytest.approx([0, 0, -1])
    assert middle_of(UPS["z"], 0) == pytest.approx([0, 1, 0])
    assert middle_of(UPS["y"], 90) == pytest.approx([-1, 0, 0])
    right, up, middle = axes_of(rs.EnvironmentLight(image=random_map(), rotation=90))
    np.testing.assert_allclose([right, up, middle], [[0, 0, -1], [0, 1, 0], [-1, 0, 0]], atol=1e-15)


@pytest.mark.parametrize("mode", ["whitted", "path"])
def test_a_mirror_shows_the_sky(mode):
    """A camera just above the mirror sees below what it sees above."""
    texels = random_map()
    mirror = rs.Material(diffuse=(0, 0, 0), reflection=(1, 1, 1))
    camera = rs.Camera((0, 1e-3, 0), (0, 1e-3, -1), projection="equirectangular")
    scene = floor([rs.EnvironmentLight(image=texels)], mirror, camera=camera)
    pixels = rs.render(scene, mode, (16, 8), 1).pixels
    np.testing.assert_allclose(pixels[:4], texels[:4], rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(pixels[4:], texels[3::-1], rtol=1e-5, atol=1e-6)


# Its samples


@kernel
def sample_map(sky, points, directions, densities):
    for i in range(len(points)):
        toward, densities[i, 0] = sample_image(sky, points[i, 0], points[i, 1])
        for k in range(3):
            directions[i, k] = toward[k]
        densities[i, 1] = relative_pdf(sky, toward[0], toward[1], toward[2])


@kernel
def look(lights, directions, seen):
    for i in range(len(directions)):
        x, y, z = directions[i, 0], directions[i, 1], directions[i, 2]
        seen[i, 0], seen[i, 1], seen[i, 2] = sky_radiance(lights, x, y, z)


@kernel
def weigh(sky, directions, densities):
    for i in range(len(directions)):
        x, y, z = directions[i, 0], directions[i, 1], directions[i, 2]
        densities[i] = relative_pdf(sky, x, y, z)


MAPS = {"sunny": sunny_map(), "odd": random_map(5, 7), "row": random_map(1, 40)}


@pytest.mark.parametrize("name", MAPS)
def test_samples_follow_their_density(name):
    texels = MAPS[name]
    height, width = texels.shape[:2]
    light = rs.EnvironmentLight((1, 0.5, 2), texels, UPS["any"], 20)
    sky, _, kept = sky_of((0.0, 0.0, 0.0), light)
    count = 1 << 17
    points = np.random.default_rng(1).random((count, 2))
    directions, densities = np.empty((count, 3)), np.empty((count, 2))
    sample_map(sky, points, directions, densities)
    np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1.0, atol=1e-12)
    # A sample on the border of a texel may be rounded to the one beside.
    agree = np.isclose(densities[:, 0], densities[:, 1], rtol=1e-9)
    assert agree.mean() > 1 - 1e-5

    # Four cells of equal solid angle in each texel.
    right, up, middle = (directions @ axes_of(light).T).T
    ends = np.cos(np.arange(height + 1) * math.pi / height)
    ends = np.interp(np.arange(2 * height + 1) / 2, np.arange(height + 1), ends)
    rows = (np.searchsorted(-ends, -up, side="right") - 1).clip(0, 2 * height - 1)
    columns = (np.arctan2(right, middle) / (2 * math.pi) + 0.5) * 2 * width
    columns = columns.astype(int).clip(0, 2 * width - 1)
    counts = np.bincount(rows * 2 * width + columns, minlength=4 * height * width)

    latitudes = np.arcsin((ends[:-1] + ends[1:]) / 2)
    longitudes = ((np.arange(2 * width) + 0.5) / (2 * width) - 0.5) * 2 * math.pi
    latitudes, longitudes = np.meshgrid(latitudes, longitudes, indexing="ij")
    level = np.cos(latitudes)
    parts = level * np.sin(longitudes), np.sin(latitudes), level * np.cos(longitudes)
    middles = np.stack(parts, axis=-1).reshape(-1, 3) @ axes_of(light)
    pdf = np.empty(len(middles))
    weigh(sky, 7.0 * middles, pdf)  # of any length
    shares = pdf * np.repeat(-np.diff(ends), 2 * width) / 2 / (2 * width)
    assert shares.sum() == pytest.approx(1.0, abs=1e-12)
    assert_follows(counts, shares * count)
    del kept


def test_no_direction_has_light_and_no_density():
    """Next to a bright texel, too, where the image is bilinear; and bright ones are found."""
    texels = patch(0, 15)
    light = rs.EnvironmentLight(image=texels)
    sky, mean, kept = sky_of((0.0, 0.0, 0.0), light)
    directions = np.random.default_rng(2).normal(size=(1 << 14, 3))
    densities = np.empty(len(directions))
    weigh(sky, directions, densities)
    lights, kept_lights = punctual_lights_of(
        rs.Scene([], lights=[light]), rs.Camera((0, 0, 3), (0, 0, 0))
    )
    seen = np.empty((len(directions), 3))
    look(lights, directions, seen)
    assert (densities[seen[:, 0] > 0] > 0).all()
    assert 0.005 < (seen[:, 0] > 0).mean() < (densities > 0).mean() < 0.1
    assert mean == pytest.approx(
        row_heights(8)[0] / 2 / 16 * (np.array([30, 20, 10]) @ [0.2126, 0.7152, 0.0722])
    )
    del kept, kept_lights


# Its light


@pytest.mark.parametrize("light_samples", [True, False])
@pytest.mark.parametrize("material", ["matte", "metal", "glass"])
def test_what_loses_no_light_cannot_be_seen_under_a_white_map(material, light_samples):
    materials = {
        "matte": rs.Material(diffuse=(1, 1, 1)),
        "metal": rs.Material(diffuse=(1, 1, 1), reflection=(0.5, 0.5, 0.5)),
        "glass": rs.Material(diffuse=(0, 0, 0), transmission=(1, 1, 1), ior=1.5),
    }
    camera = rs.Camera((0.2, 0.5, 3), (0, 0, 0), fov=25)
    scene = rs.Scene(
        [rs.Mesh(*icosphere(1))],
        materials=[materials[material]],
        lights=[rs.EnvironmentLight((0.75, 0.5, 0.25), np.ones((4, 8, 3)))],
        background=(0.25, 0.5, 0.75),
        camera=camera,
    )
    assert_mean(path(scene, max_bounces=1000, light_samples=light_samples), 1.0)


def peak(width):
    """The integral of cos(x) times a hat of this half width around 0, which is 1 at 0."""
    return width * (math.sin(width / 2) / (width / 2)) ** 2


@pytest.mark.parametrize("light_samples", [True, False])
@pytest.mark.parametrize("row", [1, 2])
def test_a_bright_texel_lights_the_floor_below_it(row, light_samples):
    """Of cos sin = sin(2 x) / 2 over a hat of latitudes, times a hat of longitudes' width."""
    texels = patch(row, 9)
    polar, step = (row + 0.5) * math.pi / 8, math.pi / 8
    expected = texels[row, 9] * (2 * math.pi / 16) * math.sin(2 * polar) / 4 * peak(2 * step)
    scene = floor([rs.EnvironmentLight(image=texels, rotation=77)])
    image = path(scene, 64, max_bounces=1, light_samples=light_samples)
    assert_mean(image, np.array(ALBEDO) / math.pi * expected)


@pytest.mark.parametrize("column", [7, 10])
def test_a_bright_texel_lights_the_floor_beside_it(column):
    """Around z, the floor's normal is the image's middle: sin^2 over latitudes, cos over others."""
    texels = patch(2, column)
    polar, step = 2.5 * math.pi / 8, math.pi / 8
    by_latitude = (step - math.cos(2 * polar) * peak(2 * step) / 2) / 2
    by_longitude = math.cos(((column + 0.5) / 16 - 0.5) * 2 * math.pi) * peak(2 * math.pi / 16)
    expected = texels[2, column] * by_latitude * by_longitude
    scene = floor([rs.EnvironmentLight(image=texels, up=(0, 0, 2))])
    assert_mean(path(scene, 64, max_bounces=1), np.array(ALBEDO) / math.pi * expected)


def test_samples_of_the_map_change_no_mean():
    """Light found by chance, or by samples of the map and other lights, and weighed."""
    vertices, faces = icosphere(1)
    ball = rs.Mesh(vertices * 0.6 + [0, 0.6, 0], faces, material_ids=np.full(len(faces), 1))
    lamp = rs.Mesh(vertices * 0.2 + [-1, 1, 0], faces, material_ids=np.full(len(faces), 2))
    scene = floor(
        [rs.EnvironmentLight(image=sunny_map() / 20), rs.EnvironmentLight((0.1, 0.2, 0.3))],
        camera=rs.Camera((0.5, 1.5, 4), (0, 0.5, 0), fov=40),
    )
    scene = rs.Scene(
        [*scene.meshes, ball, lamp],
        materials=[
            *scene.materials,
            rs.Material(diffuse=(0.8, 0.5, 0.2), roughness=0.4, metallic=0.0),
            rs.Material(emission=(2, 2, 2)),
        ],
        lights=scene.lights,
        camera=scene.camera,
    )
    sampled = path(scene, 64, max_bounces=4)
    chance = path(scene, 128, max_bounces=4, light_samples=False, seed=2)
    assert_equal_means(sampled, chance)
    assert_equal_means(sampled, chance, blocks=8)
    assert mean_of(sampled)[1].sum() < mean_of(chance)[1].sum() / 4


def test_lights_as_places_take_the_mean():
    light = rs.EnvironmentLight((1, 2, 3), sunny_map())
    # By quadrature: each texel by its middle's latitude, finely.
    polar = (np.arange(8000) + 0.5) * math.pi / 8000
    rows = np.repeat(sunny_map().mean(axis=1, dtype=np.float64), 1000, axis=0)
    mean = [1, 2, 3] * (np.sin(polar) @ rows) * math.pi / 8000 / 2
    np.testing.assert_allclose(mean_radiance(light), mean, rtol=1e-6)
    for mode in ("raycast", "shadow", "whitted"):
        pixels = rs.render(floor([light]), mode, size=(2, 2)).pixels
        np.testing.assert_allclose(
            pixels, np.broadcast_to(mean * ALBEDO, (2, 2, 3)), rtol=1e-5, atol=1e-6
        )


def test_a_black_map_is_dark():
    scene = floor([rs.EnvironmentLight(image=np.zeros((2, 4, 3)))])
    assert not path(scene, 4).pixels.any()
    assert not rs.render(scene, size=(4, 4)).pixels.any()


# Its image


def test_files_are_maps(tmp_path):
    from PIL import Image

    encoded = np.random.default_rng(4).integers(0, 256, (4, 8, 3), np.uint8)
    Image.fromarray(encoded).save(tmp_path / "sky.png")
    Image.fromarray(encoded[:, :, 0]).save(tmp_path / "grey.png")
    Image.fromarray(encoded).save(tmp_path / "sky.JPG", quality=95)
    linear = rs.Image.load(tmp_path / "sky.png")
    found = texels_of(rs.EnvironmentLight(image=tmp_path / "sky.png"))
    np.testing.assert_array_equal(found, linear.pixels)
    assert texels_of(rs.EnvironmentLight(image=str(tmp_path / "sky.JPG"))).shape == (4, 8, 3)
    grey = texels_of(rs.EnvironmentLight(image=tmp_path / "grey.png"))
    np.testing.assert_array_equal(grey, np.repeat(linear.pixels[:, :, :1], 3, axis=2))
    size = b"#?RADIANCE\n\n-Y 1 +X 2\n"
    (tmp_path / "sky.hdr").write_bytes(size + bytes([128, 64, 32, 137, 1, 2, 3, 136]))
    found = texels_of(rs.EnvironmentLight(image=tmp_path / "sky.hdr"))
    np.testing.assert_array_equal(found, [[[256, 128, 64], [1, 2, 3]]])


def test_exr_files_are_maps(tmp_path):
    need("OpenEXR")
    rs.Image(sunny_map()).save(tmp_path / "sky.exr")
    light = rs.EnvironmentLight(image=tmp_path / "sky.exr")
    np.testing.assert_array_equal(texels_of(light), sunny_map())
    assert texels_of(light) is texels_of(light)  # read once
    rs.Image(sunny_map() - 1).save(tmp_path / "sky.exr")
    with pytest.raises(rs.FileFormatError, match=r"sky\.exr: expected finite radiance"):
        texels_of(rs.EnvironmentLight(image=tmp_path / "sky.exr"))


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: rs.EnvironmentLight(image=np.zeros((2, 2))), "image: expected shape"),
        (lambda: rs.EnvironmentLight(image=np.zeros((0, 2, 3))), "image: expected shape"),
        (lambda: rs.EnvironmentLight(image=np.full((1, 1, 3), -1)), "image: .* at least 0"),
        (lambda: rs.EnvironmentLight(image=np.full((1, 1, 3), np.nan)), "image: expected finite"),
        (lambda: rs.EnvironmentLight(image=np.full((1, 1, 3), 1e39)), "image: expected finite"),
        (lambda: rs.EnvironmentLight(up=(0, 0, 0)), "up"),
        (lambda: rs.EnvironmentLight(rotation=math.inf), "rotation"),
    ],
)
def test_bad_maps_are_named(make, words):
    with pytest.raises(ValueError, match=words):
        make()


@pytest.mark.parametrize("mode", ["raycast", "path"])
@pytest.mark.parametrize(
    ("images", "words"),
    [
        (["none.hdr"], r"none\.hdr: cannot be read"),
        (["none.png"], r"none\.png: cannot read"),
        (["sky.tiff"], r"sky\.tiff: the name must end in \.hdr or"),
        ([np.ones((1, 2, 3))] * 2, "lights: only one environment light may have an image, not 2"),
    ],
)
def test_maps_that_cannot_be_used_are_named(mode, images, words):
    scene = floor([rs.EnvironmentLight(image=image) for image in images])
    with pytest.raises(ValueError, match=words):
        rs.render(scene, mode, size=(2, 2))


def test_samples_of_another_map_are_no_beginning(tmp_path):
    kept = {"size": (4, 3), "samples": 1, "checkpoint": tmp_path / "kept.npz"}
    rs.render(floor([OFF, rs.EnvironmentLight(image=sunny_map())]), "path", **kept)
    rs.render(floor([OFF, rs.EnvironmentLight(image=sunny_map())]), "path", **kept)
    other = sunny_map()
    other[5, 5] += 1e-6
    for light in (
        rs.EnvironmentLight(image=other),
        rs.EnvironmentLight(image=sunny_map(), rotation=1),
    ):
        with pytest.raises(rs.FileFormatError, match=r"kept\.npz"):
            rs.render(floor([OFF, light]), "path", **kept)

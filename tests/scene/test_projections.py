"""The projections of a camera, and its lens."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import raystream as rs
from raystream.rendering.integrator import camera_paths
from raystream.rendering.sampling.sampler import Sampler
from raystream.scene.lens import disk_points

# Looks along +x with z up, so that right is -y: no axis is where it is by default.
PINHOLE = rs.Camera((1, 2, 3), (6, 2, 3), (0, 0, 1), 60)
RIGHT, UP, FORWARD = np.array([0, -1, 0]), np.array([0, 0, 1]), np.array([1, 0, 0])
CORNERS = [0, 8, 0, 8], [0, 0, 4, 4]  # upper left, upper right, lower left, lower right
SIDES = [(-1, 1), (1, 1), (-1, -1), (1, -1)]  # to the right, upward


def test_perspective_at_corners_and_in_the_middle():
    origins, directions = PINHOLE.rays(8, 4, *CORNERS)
    assert (origins == [1, 2, 3]).all()
    tangent = math.tan(math.radians(30))
    expected = [FORWARD + 2 * tangent * a * RIGHT + tangent * b * UP for a, b in SIDES]
    expected /= np.linalg.norm(expected, axis=1, keepdims=True)
    np.testing.assert_allclose(directions, expected, atol=1e-7)
    np.testing.assert_allclose(PINHOLE.rays(8, 4, 4, 2)[1], FORWARD, atol=1e-7)


def test_orthographic_at_corners_and_in_the_middle():
    camera = replace(PINHOLE, projection="orthographic", height=3.0)
    origins, directions = camera.rays(8, 4, *CORNERS)
    assert (directions == FORWARD).all()
    assert directions.dtype == np.float32
    assert directions.flags.writeable
    expected = [(1, 2, 3) + 3.0 * a * RIGHT + 1.5 * b * UP for a, b in SIDES]
    np.testing.assert_allclose(origins, expected, rtol=1e-15)
    np.testing.assert_array_equal(camera.rays(8, 4, 4, 2)[0], [1, 2, 3])


def test_equirectangular_at_corners_edges_and_in_the_middle():
    camera = replace(PINHOLE, projection="equirectangular")
    np.testing.assert_allclose(
        camera.rays(8, 4, *CORNERS)[1], [UP, UP, -UP, -UP], atol=1e-7
    )  # the poles
    x, y = [4, 6, 2, 0, 8, 5, 4], [2, 2, 2, 2, 2, 2, 3]
    origins, directions = camera.rays(8, 4, x, y)
    assert (origins == [1, 2, 3]).all()
    half = math.sqrt(0.5)
    slanting, below = half * (FORWARD + RIGHT), half * (FORWARD - UP)
    expected = [FORWARD, RIGHT, -RIGHT, -FORWARD, -FORWARD, slanting, below]
    np.testing.assert_allclose(directions, expected, atol=1e-7)


def test_equirectangular_pixels_see_the_whole_sphere():
    """Weighed by their area, the directions of all pixels add up to nothing, evenly."""
    camera = replace(PINHOLE, projection="equirectangular")
    directions = camera.rays(64, 32)[1].astype(float)
    weights = np.cos((np.arange(32) + 0.5 - 16) / 32 * math.pi)[:, None, None]
    total = weights.sum() * 64
    np.testing.assert_allclose((weights * directions).sum(axis=(0, 1)) / total, 0, atol=1e-7)
    squares = (weights * directions**2).sum(axis=(0, 1)) / total
    np.testing.assert_allclose(squares, 1 / 3, atol=1e-3)


def test_without_a_height_orthographic_shows_what_the_pinhole_does_at_look_at():
    camera = replace(PINHOLE, projection="orthographic")
    origins, directions = camera.rays(8, 4)
    pinhole = PINHOLE.rays(8, 4)[1].astype(float)
    seen = [1, 2, 3] + 5.0 * pinhole / (pinhole @ FORWARD)[..., None]
    np.testing.assert_allclose(origins + 5.0 * directions, seen, atol=1e-5)


@given(
    eye=st.tuples(*[st.floats(-5, 5)] * 3),
    focus=st.floats(0.1, 50),
    aperture=st.floats(1e-3, 2),
    seed=st.integers(0, 1000),
)
def test_a_lens_is_sharp_in_its_plane_and_rays_start_on_it(eye, focus, aperture, seed):
    camera = rs.Camera(eye, (7, 8, 9), (0, 0, 1), 50, aperture=aperture, focus=focus)
    generator = np.random.default_rng(seed)
    x, y = generator.random((2, 40)) * [[16], [9]]
    origins, directions = camera.rays(16, 9, x, y, generator.random((40, 2)))
    forward = camera.basis()[2]
    offsets = origins - np.array(camera.eye)
    assert np.linalg.norm(offsets, axis=1).max() <= aperture / 2 * (1 + 1e-6) + 1e-13
    assert np.abs(offsets @ forward).max() < 1e-13
    assert np.linalg.norm(offsets, axis=1).max() > 0.2 * aperture  # and not only in its middle
    pinhole = camera.rays(16, 9, x, y)[1].astype(float)
    target = np.array(camera.eye) + focus * pinhole / (pinhole @ forward)[:, None]
    directions = directions.astype(float)
    met = origins + focus * directions / (directions @ forward)[:, None]
    np.testing.assert_allclose(met, target, atol=2e-6 * (focus + aperture))
    np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1, rtol=1e-6)


def test_the_first_lens_sample_goes_right_and_the_second_up():
    camera = replace(PINHOLE, aperture=2.0, focus=4.0)
    lens = [[0.5, 0.5], [1 - 1e-12, 0.5], [0.5, 1 - 1e-12], [0, 0.5], [0.5, 0]]
    origins, _ = camera.rays(8, 4, 4, 2, lens)
    expected = np.array([0 * UP, RIGHT, UP, -RIGHT, -UP]) + [1, 2, 3]
    np.testing.assert_allclose(origins, expected, atol=1e-9)


def test_without_a_focus_the_lens_is_sharp_at_look_at():
    camera = replace(PINHOLE, aperture=1.0)
    lens = np.random.default_rng(0).random((50, 2))
    origins, directions = camera.rays(8, 4, 4, 2, lens)
    reach = 5.0 / (directions @ FORWARD)[:, None]
    np.testing.assert_allclose(
        origins + reach * directions, np.tile(PINHOLE.look_at, (50, 1)), atol=1e-6
    )


def test_equal_parts_of_the_square_cover_equal_parts_of_the_disk():
    side = (np.arange(400) + 0.5) / 400
    points = disk_points(np.stack(np.meshgrid(side, side), axis=-1)).reshape(-1, 2)
    radius = np.linalg.norm(points, axis=1)
    assert radius.max() <= 1 + 1e-12
    for inside in (0.25, 0.5, 0.8):
        assert (radius < inside).mean() == pytest.approx(inside**2, abs=4e-3)
    angles = np.arctan2(points[:, 1], points[:, 0])
    counts = np.histogram(angles, 16, (-math.pi, math.pi))[0]
    np.testing.assert_allclose(counts / len(points), 1 / 16, atol=1e-3)


@pytest.mark.parametrize("projection", ["perspective", "orthographic", "equirectangular"])
def test_without_an_aperture_lens_samples_change_no_bit(projection):
    camera = replace(PINHOLE, projection=projection, aperture=0.0, focus=3.3)
    plain = camera.rays(8, 4)
    lens = np.random.default_rng(0).random((4, 8, 2))
    for array, expected in zip(camera.rays(8, 4, lens=lens), plain, strict=True):
        np.testing.assert_array_equal(
            array.view(np.uint8), np.ascontiguousarray(expected).view("B")
        )
    shared = not any(camera.rays(8, 4, lens=lens)[0].strides[:-1])
    assert shared == (projection != "orthographic")  # the eye, repeated without copying
    several = camera.rays(8, 4, lens=np.zeros((3, 1, 1, 2)))
    assert several[0].shape == several[1].shape == (3, 4, 8, 3)


def test_a_lens_without_samples_is_a_pinhole():
    camera = replace(PINHOLE, aperture=1.0, focus=3.0)
    for array, expected in zip(camera.rays(8, 4), PINHOLE.rays(8, 4), strict=True):
        np.testing.assert_array_equal(array, expected)


def test_pixels_and_lens_samples_broadcast():
    camera = replace(PINHOLE, aperture=1.0, focus=3.0)
    lens = np.random.default_rng(0).random((5, 1, 1, 2))
    origins, directions = camera.rays(8, 4, lens=lens)
    assert origins.shape == directions.shape == (5, 4, 8, 3)
    one = camera.rays(8, 4, lens=lens[3])
    np.testing.assert_array_equal(origins[3], one[0])
    np.testing.assert_array_equal(directions[3], one[1])


@pytest.mark.parametrize(
    ("parts", "words"),
    [
        ({"aperture": -0.1}, "aperture: .* -0.1"),
        ({"aperture": math.nan}, "aperture"),
        ({"aperture": math.inf}, "aperture"),
        ({"aperture": None}, "aperture"),
        ({"aperture": 1, "projection": "orthographic"}, "aperture: only a perspective"),
        ({"aperture": 1, "projection": "equirectangular"}, "aperture: only a perspective"),
        ({"focus": 0}, "focus: .* above 0"),
        ({"focus": -1}, "focus"),
        ({"focus": math.nan}, "focus"),
        ({"height": 0}, "height"),
        ({"height": "tall"}, "height"),
        ({"height": 10**400}, "height"),
        ({"projection": "fisheye"}, "projection: .* 'orthographic' .* 'fisheye'"),
        ({"projection": None}, "projection"),
    ],
)
def test_bad_projections_and_lenses_are_named(parts, words):
    with pytest.raises(ValueError, match=words):
        replace(PINHOLE, **parts)


@pytest.mark.parametrize(
    ("lens", "words"),
    [
        ([[0.5, 1.0]], r"in \[0, 1\)"),
        ([[-0.1, 0.5]], r"in \[0, 1\)"),
        ([[math.nan, 0.5]], r"in \[0, 1\)"),
        ([["a", "b"]], r"in \[0, 1\)"),
        ([[0.5, 0.5, 0.5]], "ends in 2"),
        (0.5, "ends in 2"),
        (np.zeros((3, 8, 2)), "broadcast"),
    ],
)
@pytest.mark.parametrize("aperture", [0.0, 1.0])
def test_bad_lens_samples_are_named(lens, words, aperture):
    with pytest.raises(ValueError, match=f"^lens: .*{words}"):
        replace(PINHOLE, aperture=aperture).rays(8, 4, lens=lens)


def test_eye_rays_spread_over_pixels_and_lens():
    """Evenly, and where a ray passes the lens is not tied to where it is in the pixel."""
    camera = replace(PINHOLE, aperture=0.5, focus=5.0)
    count = 256
    sampler = Sampler.of("sobol", 7, count)
    streams = [camera_paths(camera, (3, 3), sampler, range(3), sample) for sample in range(count)]
    offsets = np.array([stream.origins for stream in streams]) - [1, 2, 3]
    directions = np.array([stream.directions for stream in streams], float)
    met = offsets + 5.0 * directions / (directions @ FORWARD)[..., None]
    size = 2 * 5.0 * math.tan(math.radians(30)) / 3
    columns, rows = np.arange(9) % 3 - 1, np.arange(9) // 3 - 1
    places = np.stack([met @ RIGHT / size - columns, met @ UP / size + rows], axis=-1)
    lens = np.stack([offsets @ RIGHT, offsets @ UP], axis=-1) / 0.25
    assert np.abs(places).max() < 0.5 + 1e-6
    assert np.linalg.norm(lens, axis=-1).max() <= 1 + 1e-12
    for points, spread in ((places, 1 / 12), (lens, 1 / 4)):
        np.testing.assert_allclose(points.mean(axis=0), 0, atol=0.05)
        np.testing.assert_allclose(points.var(axis=0), spread, rtol=0.1)
    for pixel in range(9):
        tied = np.corrcoef(places[:, pixel].T, lens[:, pixel].T)[:2, 2:]
        assert np.abs(tied).max() < 0.3


def test_one_sample_goes_through_the_middle_of_the_lens():
    sharp = camera_paths(PINHOLE, (4, 3), Sampler.of("sobol"), range(3), 0)
    stream = camera_paths(replace(PINHOLE, aperture=1.0), (4, 3), Sampler.of("sobol"), range(3), 0)
    np.testing.assert_array_equal(stream.origins, sharp.origins)
    np.testing.assert_array_equal(stream.directions, sharp.directions)


def test_a_square_in_an_orthographic_picture_keeps_its_size_at_any_distance():
    corners = [[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]
    scene = rs.Scene.from_arrays(corners, [[0, 1, 2], [0, 2, 3]])
    for distance in (0.5, 50.0):
        eye = (0, 0, distance)
        camera = rs.Camera(eye, (0, 0, 0), projection="orthographic", height=4)
        seen = rs.render(scene, "vis", (24, 16), camera=camera).pixels.any(axis=2)
        expected = np.zeros((16, 24), bool)
        expected[4:12, 8:16] = True
        np.testing.assert_array_equal(seen, expected)


def test_what_is_out_of_focus_is_blurred_as_wide_as_the_cone_of_rays_is_there():
    """Half a plane at 2: sharp in focus; with the focus at 4 the cone is half a lens wide."""
    corners = [[0, -9, 0], [9, -9, 0], [9, 9, 0], [0, 9, 0]]
    tracer = rs.Tracer(rs.Scene.from_arrays(corners, [[0, 1, 2], [0, 2, 3]]))
    for focus, columns in ((2.0, 0), (4.0, 2)):
        camera = rs.Camera((0, 0, 2), (0, 0, 0), fov=90, aperture=1.0, focus=focus)
        seen = np.zeros(32 * 32)
        for sample in range(32):  # a pixel is 1/8 wide at that distance
            stream = camera_paths(camera, (32, 32), Sampler.of("sobol", 0, 32), range(32), sample)
            seen += tracer.any_hit(stream.origins, stream.directions)
        covered = seen.reshape(32, 32).mean(axis=0) / 32
        assert not covered[: 16 - columns].any()
        assert (covered[16 + columns :] == 1).all()
        blurred = covered[16 - columns : 16 + columns]
        assert ((blurred > 0) & (blurred < 1)).all()
        assert (np.diff(blurred) > 0).all()

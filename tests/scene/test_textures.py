"""Textures made by functions."""

from __future__ import annotations

import numpy as np
import pytest
from PIL import Image

import raystream as rs
from raystream.rendering.color import decode_srgb


def at(texture, u, v):
    """The linear colour of the texel at a place."""
    pixels = texture.pixels()
    height, width = pixels.shape[:2]
    return decode_srgb(pixels[int((1 - v) * height), int(u * width)])


def test_functions_are_asked_at_the_texels_centres():
    asked = []

    def green(u, v):
        asked.append((u, v))
        return np.stack([0 * u, v, 0 * u], axis=2)

    texture = rs.textures.baked(green, (4, 2), encoding="plain", wrap="clamp")
    ((u, v),) = asked
    np.testing.assert_array_equal(u, [[0.125, 0.375, 0.625, 0.875]] * 2)
    np.testing.assert_array_equal(v, [[0.75] * 4, [0.25] * 4])
    np.testing.assert_array_equal(texture.pixels()[:, 0], [[0, 191, 0], [0, 64, 0]])
    assert (texture.name, texture.wrap) == ("green", "clamp")


def test_colours_are_kept_to_half_a_step():
    levels = np.linspace(-0.1, 1.1, 1001)
    pixels = rs.textures.baked(lambda u, v: levels, (1001, 1)).pixels()
    assert pixels.shape == (1, 1001, 1)
    steps = np.diff(decode_srgb(np.arange(256, dtype=np.uint8)))[np.clip(pixels[0, :, 0], 0, 254)]
    found, wanted = decode_srgb(pixels)[0, :, 0], np.clip(levels, 0, 1)
    assert (np.abs(found - wanted) <= 0.52 * steps + 1e-6).all()


def test_one_number_makes_an_even_texture():
    assert np.ptp(rs.textures.baked(lambda u, v: 0.5, (3, 2)).pixels()) == 0
    assert rs.textures.baked(lambda u, v: [[(0, 1, 0)]], (3, 2)).pixels().shape == (2, 3, 3)


def test_a_checker_has_its_squares_where_they_belong():
    one, other = (0.9, 0.1, 0.0), (0.0, 0.2, 1.0)
    texture = rs.textures.checker(one, other, (4, 2), texels=5)
    assert texture.pixels().shape == (10, 20, 3)
    for u, v, color in [
        (0.01, 0.01, one),
        (0.26, 0.01, other),
        (0.24, 0.49, one),
        (0.24, 0.51, other),
        (0.99, 0.99, one),
        (0.99, 0.01, other),
    ]:
        np.testing.assert_allclose(at(texture, u, v), color, atol=0.005)


def test_noise_repeats_without_a_seam_and_follows_its_seed():
    noise = rs.textures.noise(frequency=4, octaves=3, seed=5, size=128, encoding="plain")
    pixels = noise.pixels().astype(int)[:, :, 0]
    for axis in (0, 1):
        steps = np.abs(np.diff(pixels, axis=axis, append=np.take(pixels, [0], axis)))
        seam = np.take(steps, [-1], axis)
        assert seam.max() <= steps.max()
        assert seam.mean() < 1.5 * steps.mean()
    assert 100 < pixels.mean() < 155
    assert np.ptp(pixels) > 120
    again, other = (rs.textures.noise(frequency=4, octaves=3, seed=s, size=128) for s in (5, 6))
    assert np.array_equal(
        rs.textures.noise(frequency=4, octaves=3, seed=5, size=128).pixels(), again.pixels()
    )
    assert not np.array_equal(again.pixels(), other.pixels())


def test_noise_goes_from_one_colour_to_the_other():
    noise = rs.textures.noise((0.5, 0, 0), (0.5, 1, 0), size=64)
    pixels = noise.pixels()
    assert np.ptp(pixels[:, :, 0]) == 0
    assert not pixels[:, :, 2].any()
    assert np.ptp(pixels[:, :, 1]) > 100


def test_a_made_texture_is_seen():
    """On a square seen from above that emits its texture's colour."""
    colors = rs.textures.checker((1, 0, 0), (0, 0, 1), (2, 2), texels=16)
    mesh = rs.Mesh(
        [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]],
        [[0, 1, 2], [0, 2, 3]],
        texcoords=[[0, 0], [1, 0], [1, 1], [0, 1]],
    )
    material = rs.Material(diffuse=(0, 0, 0), emission=(3, 3, 3), textures={"emission": colors})
    camera = rs.Camera((0.5, 0.5, 1), (0.5, 0.5, 0), fov=2 * np.degrees(np.arctan(0.5)))
    image = rs.render(rs.Scene([mesh], materials=[material], camera=camera), "path", (4, 4), 1)
    red, blue = [3, 0, 0], [0, 0, 3]
    upper, lower = [blue, blue, red, red], [red, red, blue, blue]
    np.testing.assert_allclose(image.pixels, [upper, upper, lower, lower], atol=1e-6)


@pytest.mark.parametrize(
    ("make", "match"),
    [
        (lambda: rs.textures.baked(lambda u, v: u, (0, 4)), "size"),
        (lambda: rs.textures.baked(lambda u, v: u, (1 << 20, 1 << 20)), "size"),
        (lambda: rs.textures.baked(lambda u, v: u[:2, :2], (8, 8)), "function"),
        (lambda: rs.textures.baked(lambda u, v: u / 0 * np.nan, (8, 8)), "function"),
        (lambda: rs.textures.baked(lambda u, v: u, encoding="linear"), "encoding"),
        (lambda: rs.textures.checker((2, 0, 0)), "one"),
        (lambda: rs.textures.checker(count=(0, 2)), "count"),
        (lambda: rs.textures.checker(count=(1 << 16, 1 << 16)), "size"),
        (lambda: rs.textures.noise(high=(1, 1)), "high"),
        (lambda: rs.textures.noise(frequency=100, octaves=9), "octaves"),
    ],
)
@pytest.mark.filterwarnings("ignore:divide by zero", "ignore:invalid value")
def test_errors_name_the_argument(make, match):
    with pytest.raises(ValueError, match=match):
        make()


@pytest.mark.parametrize(
    ("source", "kind", "says"),
    [
        (np.zeros((4, 4, 3)), TypeError, "expected pixels of dtype uint8, 0 to 255, got float64"),
        (np.zeros((4, 4), np.uint8), ValueError, r"expected pixels of shape \(H, W, C\)"),
        (np.zeros((4, 4, 2), np.uint8), ValueError, r"C 1, 3 or 4, got \(4, 4, 2\)"),
        (np.zeros((0, 4, 3), np.uint8), ValueError, "source"),
        ([[0, 1]], TypeError, "expected a path, bytes or an array, got list"),
    ],
)
def test_what_is_no_image_is_refused(source, kind, says):
    """Colours from 0 to 1 would all be black."""
    with pytest.raises(kind, match=says):
        rs.Texture(source)


def test_names_of_files_are_paths(tmp_path):
    Image.fromarray(np.full((2, 3, 3), 99, np.uint8)).save(tmp_path / "grey.png")
    texture = rs.Texture(str(tmp_path / "grey.png"))
    assert (texture.path, texture.name) == (tmp_path / "grey.png", "grey.png")
    assert (texture.pixels() == 99).all()

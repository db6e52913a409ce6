"""Textures outside [0, 1], against their texels, and against bitmaps padded by NumPy."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

import raystream as rs
from raystream.rendering.color import decode_srgb
from raystream.scene.texture import WRAPS

TEXELS = np.random.default_rng(4).integers(0, 256, (3, 3, 3), dtype=np.uint8)

#: The same by NumPy's names.
PADDING = {"repeat": "wrap", "clamp": "edge", "mirror": "symmetric"}

#: Of a square from 0 to 1, all of it.
ABOVE = rs.Camera((0.5, 0.5, 1), (0.5, 0.5, 0), fov=2 * np.degrees(np.arctan(0.5)))
LAMP = rs.PointLight((0.25, 0.75, 0.75), (1.0, 0.75, 0.5))


def padded(texels, wraps, count):
    """A bitmap with `count` texels more on each side."""
    along_u, along_v = wraps
    rows = np.pad(texels, [(count, count), (0, 0), (0, 0)], PADDING[along_v])
    return np.pad(rows, [(0, 0), (count, count), (0, 0)], PADDING[along_u])


def image(role, mode, size, texture, low, high, **looks):
    """A square whose texture coordinates are from `low` to `high`."""
    corners = np.array([[0, 0], [1, 0], [1, 1], [0, 1.0]])
    vertices = np.column_stack([corners, np.zeros(4)])
    texcoords = low + corners * (np.asarray(high) - low)
    mesh = rs.Mesh(vertices, [[0, 1, 2], [0, 2, 3]], texcoords=texcoords)
    material = rs.Material(textures={role: texture}, **looks)
    scene = rs.Scene([mesh], materials=[material], lights=[LAMP], camera=ABOVE)
    return rs.render(scene, mode, (size, size), 1).pixels


@pytest.mark.parametrize("mode", ["path", "whitted"])
@pytest.mark.parametrize("along_u", WRAPS)
def test_texels_from_minus_2_to_3(along_u, mode):
    """At their centres, and in the middle between four of them."""
    for wraps in itertools.product([along_u], WRAPS):
        texture = rs.Texture(TEXELS, wrap=wraps)
        colors = decode_srgb(padded(TEXELS, wraps, 7))
        glows = {"diffuse": (0, 0, 0), "emission": (1, 1, 1)}
        found = image("emission", mode, 15, texture, -2.0, 3.0, **glows)
        np.testing.assert_allclose(found, colors[1:-1, 1:-1], atol=2e-5)
        half = 0.5 / 3
        found = image("emission", mode, 15, texture, half - 2.0, half + 3.0, **glows)
        columns = colors[:, 1:-1] / 2 + colors[:, 2:] / 2  # v points up
        np.testing.assert_allclose(found, columns[1:-1] / 2 + columns[:-2] / 2, atol=2e-5)


@pytest.mark.parametrize(
    ("role", "mode", "looks"),
    [
        ("diffuse", "raycast", {}),
        ("specular", "whitted", {"specular": (1, 1, 1), "shininess": 3}),
        ("metallic_roughness", "path", {"roughness": 1.0, "metallic": 1.0}),
        ("normal", "raycast", {}),
        ("bump", "whitted", {"bump_scale": 0.5}),
        ("bump", "raycast", {"bump_scale": 0.5}),
        ("opacity", "whitted", {"alpha_cutoff": 0.4}),
        ("opacity", "raycast", {"alpha_cutoff": 0.4}),
    ],
)
def test_every_role_looks_up_what_a_padded_bitmap_has(role, mode, looks):
    """Also slopes of bumps, which are reversed where a bitmap is mirrored."""
    still = image(role, mode, 32, rs.Texture(TEXELS), -1.4, 2.3, **looks)
    for wraps in (("mirror", "clamp"), ("clamp", "repeat"), ("repeat", "mirror")):
        found = image(role, mode, 32, rs.Texture(TEXELS, wrap=wraps), -1.4, 2.3, **looks)
        whole = rs.Texture(padded(TEXELS, wraps, 9))
        expected = image(role, mode, 32, whole, 1.6 / 7, 5.3 / 7, **looks)
        is_close = np.isclose(found, expected, rtol=2e-3, atol=2e-4).all(axis=2)
        assert is_close.mean() > 0.99  # but where the last bit decides on opacity
        assert is_close.all() or role == "opacity"
        assert (abs(found - still).max(axis=2) > 1e-3).mean() > 0.05


def test_one_word_is_for_both_axes():
    assert [rs.Texture(TEXELS, wrap=wrap).wraps for wrap in WRAPS] == [(w, w) for w in WRAPS]
    assert rs.Texture(TEXELS, wrap=("mirror", "mirror")).wrap == "mirror"
    assert rs.Texture(TEXELS, wrap=("mirror", "clamp")).wrap == ("mirror", "clamp")
    assert rs.Texture(TEXELS, wrap=("mirror", "clamp")).alpha().wrap == ("mirror", "clamp")


@pytest.mark.parametrize("wrap", ["border", ("clamp",), ("clamp", "clamp", "clamp"), None, [1, 2]])
def test_other_words_are_refused(wrap):
    with pytest.raises(ValueError, match="wrap: expected one of repeat, clamp, mirror, or two"):
        rs.Texture(TEXELS, wrap=wrap)


def test_samples_of_a_texture_looked_up_elsewhere_are_no_beginning(tmp_path):
    kept = {"size": (4, 3), "samples": 1, "checkpoint": tmp_path / "kept.npz"}

    def render(colors=None, **options):
        material = rs.Material(textures={"diffuse": rs.Texture(TEXELS, **options)})
        mesh = rs.Mesh(np.eye(3), [[0, 1, 2]], texcoords=np.eye(3, 2), colors=colors)
        rs.render(rs.Scene([mesh], materials=[material], lights=[LAMP]), "raycast", **kept)

    moved, mirrored = {"transform": (1, 0, 0.5, 0, 1, 0)}, {"wrap": ("repeat", "mirror")}
    render(**moved)
    render(**moved)
    for other in ({}, mirrored, {"transform": (1, 0, 0.25, 0, 1, 0)}, moved | mirrored):
        with pytest.raises(rs.FileFormatError, match=r"kept\.npz"):
            render(**other)
    with pytest.raises(rs.FileFormatError, match=r"kept\.npz"):
        render(np.full((3, 4), 1.0), **moved)

"""Textures with a transform, against meshes whose coordinates have it."""

from __future__ import annotations

import numpy as np
import pytest

import raystream as rs

FLOOR = np.array([[-3, 0, -3], [3, 0, -3], [3, 0, 3], [-3, 0, 3.0]])
FACES = [[0, 2, 1], [0, 3, 2]]
ABOVE = rs.Camera((0.5, 4, 1), (0, 0, 0), (0, 0, -1), 60)
LIGHTS = [rs.PointLight((1, 3, 0), (20.0, 10.0, 5.0))]
TEXCOORDS = np.array([[0, 0], [1, 0], [1, 1], [0, 1.0]])

#: To coordinates below 0 and above 1. The first is turned, stretched and moved.
TRANSFORM = (0.9, -1.2, 0.25, 1.1, 0.5, -0.75)
MOVE = (2.0, 0.0, -0.25, 0.0, 3.0, 0.5)

TEXELS = np.random.default_rng(1).integers(0, 256, (5, 7, 3), dtype=np.uint8)


def moved(a, b, c, d, e, f):
    u, v = TEXCOORDS.T
    return np.column_stack([a * u + b * v + c, d * u + e * v + f])


def image(mode, role, wrap, transform, texcoords):
    """A floor with the texture, and one below it with another texture that has no transform."""
    texture = rs.Texture(TEXELS, wrap=wrap, transform=transform)
    material = rs.Material(emission=(0.2, 0.3, 0.4), textures={role: texture}, bump_scale=0.5)
    other = rs.Material(textures={"diffuse": rs.Texture(TEXELS[::-1].copy())})
    meshes = [
        rs.Mesh(FLOOR, FACES, texcoords=texcoords),
        rs.Mesh(FLOOR - [2, 1, 0], FACES, texcoords=TEXCOORDS, material_ids=1),
    ]
    scene = rs.Scene(meshes, materials=[material, other], lights=LIGHTS, camera=ABOVE)
    return rs.render(scene, mode, (48, 32)).pixels


@pytest.mark.parametrize("wrap", ["repeat", "clamp"])
@pytest.mark.parametrize(
    ("mode", "role", "transform"),
    [
        ("raycast", "diffuse", TRANSFORM),
        ("path", "diffuse", TRANSFORM),
        ("whitted", "emission", TRANSFORM),
        ("whitted", "opacity", TRANSFORM),
        ("raycast", "normal", MOVE),  # which turns no tangents
        ("whitted", "bump", MOVE),
    ],
)
def test_a_transform_looks_up_where_moved_coordinates_do(mode, role, transform, wrap):
    by_texture = image(mode, role, wrap, transform, TEXCOORDS)
    by_mesh = image(mode, role, wrap, None, moved(*transform))
    still = image(mode, role, wrap, None, TEXCOORDS)
    is_close = np.isclose(by_texture, by_mesh, rtol=1e-3, atol=1e-4).all(axis=2)
    assert is_close.mean() > 0.995  # but where opacity is decided by the last bit
    assert is_close.all() or role == "opacity"
    assert (abs(by_texture - still).max(axis=2) > 1e-3).mean() > 0.1


@pytest.mark.parametrize("mode", ["raycast", "whitted"])
@pytest.mark.parametrize("wrap", ["repeat", "clamp"])
def test_a_transform_that_overflows_looks_up_some_texel(mode, wrap):
    seen = image(mode, "diffuse", wrap, (3e38,) * 6, TEXCOORDS + 1)
    assert np.isfinite(seen).all()
    assert seen.max() < 10


@pytest.mark.parametrize("transform", [(1, 2), (1, 0, 0, 0, 1, np.inf)])
def test_bad_transforms(transform):
    with pytest.raises(ValueError, match="transform: expected six finite numbers"):
        rs.Texture(TEXELS, transform=transform)

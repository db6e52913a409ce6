"""Normal maps and bump maps, against planes that are tilted as much."""

from __future__ import annotations

import numpy as np
import pytest

import raystream as rs
from raystream.rendering.shading.tangents import vertex_tangents
from raystream.rendering.vertex_attributes import VertexAttributes

FLOOR = np.array([[-9, 0, -9], [9, 0, -9], [9, 0, 9], [-9, 0, 9.0]])
UPWARD = [[0, 2, 1], [0, 3, 2]]
SUN = np.array([0.48, 0.8, -0.36])
X, Y, Z = np.eye(3)

#: Which way u and v grow on the floor: as in the bitmap, mirrored, turned.
LAID = {"upright": (X, -Z), "mirrored": (-X, -Z), "turned": (Z, X), "slanting": (X, X - Z)}


def floor(material, across=X, up=-Z, sun=SUN, eye=(-0.4, 1.5, 0.3), **attributes):
    """The floor under a sun of irradiance pi, and a camera that sees one point of it."""
    texcoords = np.stack([FLOOR @ across, FLOOR @ up], axis=1) / 18 + 0.5
    mesh = rs.Mesh(FLOOR, UPWARD, **{"texcoords": texcoords, **attributes})
    camera = rs.Camera(eye, (0.01, 0, -0.02), fov=1e-3)
    lights = [rs.DirectionalLight(-np.asarray(sun), (np.pi,) * 3)]
    return rs.Scene([mesh], materials=[material], lights=lights, camera=camera)


def seen(*arguments, mode="shadow", **options):
    return rs.render(floor(*arguments, **options), mode, (1, 1)).pixels[0, 0, 0]


def white(role, pixels, **factors):
    texture = rs.Texture(np.asarray(pixels, np.uint8), wrap=factors.pop("wrap", "repeat"))
    return rs.Material(diffuse=(1, 1, 1), textures={role: texture}, **factors)


def tilted(x, y, z, laid):
    """The unit normal of a relief: x is where u grows but v does not, and y a right angle on."""
    across, up, _ = np.linalg.inv([*laid, Y]).T
    across = across / np.linalg.norm(across)
    side = np.cross(Y, across)
    normal = x * across + y * np.sign(side @ up) * side + z * Y
    return normal / np.linalg.norm(normal)


@pytest.mark.parametrize("mode", ["shadow", "path"])
def test_a_flat_map_changes_nothing(mode):
    smooth = {"normals": [[0.1, 1, 0.2], [-0.3, 1, 0], [0, 1, 0.2], [0.2, 1, -0.1]]}
    plain = seen(rs.Material(diffuse=(1, 1, 1)), mode=mode, **smooth)
    for role, texel in (("normal", (128, 128, 255)), ("bump", (77, 77, 77))):
        assert seen(white(role, [[texel]]), mode=mode, **smooth) == pytest.approx(plain, rel=1e-6)


@pytest.mark.parametrize("factor", [1.0, 0.5, -1.0])
@pytest.mark.parametrize("laid", LAID)
def test_an_even_normal_map_tilts_the_surface(laid, factor):
    material = white("normal", [[(128 + 40, 128 - 25, 128 + 111)]], normal_scale=factor)
    normal = tilted(40 * factor, -25 * factor, 111, LAID[laid])
    for mode in ("shadow", "path"):
        assert seen(material, *LAID[laid], mode=mode) == pytest.approx(normal @ SUN, rel=1e-5)
    # From below, what was a bump is a dent.
    below = seen(material, *LAID[laid], sun=SUN * [1, -1, 1], eye=(-0.4, -1.5, 0.3))
    assert below == pytest.approx(-normal @ (SUN * [1, -1, 1]), rel=1e-5)


@pytest.mark.parametrize("wrap", ["repeat", "clamp"])
@pytest.mark.parametrize("height", [20.0, -30.0])
def test_a_ramp_tilts_the_surface_as_a_bump_map(height, wrap):
    ramp = np.repeat(np.arange(0, 256, 4), 32).reshape(64, 32, 1)  # darker to the top
    slope = height * 4 / 255
    for pixels, x, y in ((ramp, 0.0, slope), (ramp.swapaxes(0, 1), -slope, 0.0)):
        material = white("bump", pixels, bump_scale=height, wrap=wrap)
        for laid in LAID.values():
            expected = tilted(x, y, 1.0, laid) @ SUN
            assert seen(material, *laid) == pytest.approx(expected, rel=1e-4)


def test_heights_are_luminance():
    grey = np.repeat(np.arange(0, 256, 4), 32).reshape(64, 32, 1) // 4
    red = np.concatenate([grey * 4, grey * 0, grey * 0], axis=2)
    one = seen(white("bump", grey, bump_scale=0.2126 * 40))
    assert seen(white("bump", red, bump_scale=10)) == pytest.approx(one, rel=1e-5)


def test_bump_maps_that_hold_normals_are_normal_maps():
    texel = [[(128 + 24, 128 - 15, 128 + 124)]]
    one, other = white("normal", texel, normal_scale=0.5), white("bump", texel, bump_scale=0.5)
    assert seen(one) == seen(other)
    assert seen(one) != pytest.approx(SUN[1], rel=1e-2)


def test_without_texture_coordinates_there_is_no_relief():
    material = white("normal", [[(200, 128, 200)]])
    for texcoords in (None, np.zeros((4, 2)), np.full((4, 2), np.nan)):
        assert seen(material, texcoords=texcoords) == pytest.approx(SUN[1], rel=1e-6)


def test_mirrors_of_any_relief_lose_no_light():
    numbers = np.random.default_rng(1)
    normals = numbers.normal(size=(32, 32, 3))
    normals /= np.linalg.norm(normals, axis=2, keepdims=True)
    sheet = np.clip(128 + 127 * normals, 0, 255)
    mirror = {"diffuse": (0, 0, 0), "reflection": (1, 1, 1)}
    material = rs.Material(**mirror, textures={"normal": rs.Texture(sheet.astype(np.uint8))})
    scene = floor(material)
    camera = rs.Camera((-5, 0.4, 0), (0, 0, 0), fov=8)
    scene = rs.Scene(
        scene.meshes, materials=[material], lights=[rs.EnvironmentLight((1, 1, 1))], camera=camera
    )
    image = rs.render(scene, "path", (64, 32), 4, max_bounces=1)
    np.testing.assert_allclose(image.pixels, 1.0, rtol=1e-5)


def test_tangents_of_mirrored_halves_do_not_mix():
    """Two triangles share an edge on which the texture is folded over."""
    corners = np.array([[[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 0, 0], [0, 1, 0], [-1, 0, 0]]])
    texcoords = np.array([[0, 0], [1, 0], [0, 1], [1, 0]], np.float32)
    faces = np.array([[0, 1, 2], [0, 2, 3]], np.int32)
    vertices = VertexAttributes(None, texcoords, None, faces)
    upright, mirrored = vertex_tangents(corners.astype(np.float32), vertices, np.ones(2, bool))
    np.testing.assert_allclose(upright, [X, X, X, 0 * X], atol=1e-6)
    np.testing.assert_allclose(mirrored, [-X, 0 * X, -X, -X], atol=1e-6)


def test_tangents_are_means_between_triangles():
    """A strip bent by 90 degrees; flat triangles of the texture count for nothing."""
    places = np.array([[-1, 0, 0], [0, 0, 0], [0, 0, 1], [-1, 0, 1], [0, -1, 0], [0, -1, 1.0]])
    texcoords = np.array([[0, 0], [1, 0], [1, 1], [0, 1], [2, 0], [2, 1]], np.float32)
    faces = np.array([[0, 1, 2], [0, 2, 3], [1, 4, 5], [1, 5, 2], [0, 0, 1]], np.int32)
    vertices = VertexAttributes(None, texcoords, None, faces)
    tangents = vertex_tangents(places[faces].astype(np.float32), vertices, np.ones(5, bool)).sum(0)
    middle = (X - Y) / np.sqrt(2)
    np.testing.assert_allclose(tangents, [X, middle, middle, X, -Y, -Y], atol=1e-6)


@pytest.mark.parametrize("name", ["normal_scale", "bump_scale"])
def test_scales_must_be_finite(name):
    with pytest.raises(ValueError, match=name):
        rs.Material(**{name: float("nan")})

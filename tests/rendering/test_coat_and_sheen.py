"""Clear coats and sheen, against the formulas of glTF's extensions."""

from __future__ import annotations

import numpy as np
import pytest

import raystream as rs
from raystream.rendering.shading.sheen import LEAST_SHEEN, sheen_table
from rendering.test_metal import BASE, EYE, brdf, floor
from z_test import assert_at_most, assert_equal_means

VIEW = EYE / np.linalg.norm(EYE)
DARK = {"diffuse": (0, 0, 0), "normal_reflectance": (0, 0, 0), "grazing_reflectance": 0}
WHITE = np.ones(3)


def unit(*vector):
    return np.array(vector) / np.linalg.norm(vector)


MIRRORED = VIEW * [-1, 1, -1]
SUNS = [MIRRORED, unit(0.1, 1.0, 0.2), unit(2.0, 0.3, -1.0)]


def seen(material, toward=None, mode="path", texcoords=None):
    """Radiance of the floor, under a sun of irradiance 2."""
    toward = SUNS[1] if toward is None else toward
    scene = floor(material, [rs.DirectionalLight(-toward, (2, 2, 2))], texcoords)
    return rs.render(scene, mode, (1, 1), 1, lights="file").pixels[0, 0]


def coat_share(clearcoat, cosine):
    """`fresnel_coat` of ``KHR_materials_clearcoat``, with an index of refraction of 1.5."""
    return clearcoat * (0.04 + 0.96 * (1 - cosine) ** 5)


def masking(cosine, alpha):
    """Lambda of ``KHR_materials_sheen``."""
    share = (1 - alpha) ** 2
    soft = np.array([21.5473, 3.82987, 0.19823, -1.97760, -4.32054])
    sharp = np.array([25.3245, 3.32435, 0.16801, -1.27393, -4.85967])
    a, b, c, d, e = soft + (sharp - soft) * share

    def fitted(x):
        return a / (1 + b * x**c) + d * x + e

    cosine = np.asarray(cosine)
    low = np.exp(fitted(np.minimum(cosine, 0.5)))
    return np.where(cosine < 0.5, low, np.exp(2 * fitted(0.5) - fitted(np.maximum(1 - cosine, 0))))


def sheen(toward, view, roughness):
    """`sheen_brdf` for white fibres; the surface's normal is +y."""
    alpha = roughness**2
    half = toward + view
    height = half[..., 1] / np.linalg.norm(half, axis=-1)
    density = (2 + 1 / alpha) * (1 - height**2) ** (0.5 / alpha) / (2 * np.pi)
    light, seen = toward[..., 1], view[1]
    return density / ((1 + masking(light, alpha) + masking(seen, alpha)) * 4 * light * seen)


def albedo(cosine, roughness, count=500):
    """E of the extension, the integral of the BRDF times the cosine: midpoint rule."""
    root = (np.arange(count) + 0.5) / count
    y, angle = np.meshgrid(root**2, np.pi * root, indexing="ij")
    radius = np.sqrt(1 - y * y)
    toward = np.stack([radius * np.cos(angle), y, radius * np.sin(angle)], axis=-1)
    view = np.array([np.sqrt(1 - cosine**2), cosine, 0.0])
    values = sheen(toward, view, roughness) * y * 2 * np.sqrt(y)
    return 2 * np.pi * values.mean()


@pytest.mark.parametrize("roughness", [0.2, 0.6])
@pytest.mark.parametrize("clearcoat", [0.4, 1.0])
def test_light_of_a_sun_is_reflected_by_coat_and_base(clearcoat, roughness):
    looks = {"diffuse": tuple(BASE), "roughness": 0.5, "metallic": 0.4}
    material = rs.Material(**looks, clearcoat=clearcoat, clearcoat_roughness=roughness)
    share = coat_share(clearcoat, VIEW[1])
    for toward in SUNS:
        coat = brdf(toward, VIEW, roughness, 1.0, base=WHITE)
        base = brdf(toward, VIEW, 0.5, 0.4)
        expected = 2 * ((1 - share) * base + share * coat) * toward[1]
        np.testing.assert_allclose(seen(material, toward), expected, rtol=2e-4)
        around = (1 - share) * (0.4 * BASE + 0.6 * 0.04) + share  # grey, under the same sun
        expected = expected + around * (0.5 * 2 / np.pi)
        np.testing.assert_allclose(seen(material, toward, "shadow"), expected, rtol=2e-4)


@pytest.mark.parametrize("roughness", [0.1, 0.35, 1.0])
def test_light_of_a_sun_is_reflected_by_fibres_and_base(roughness):
    color = np.array([0.9, 0.3, 0.05])
    looks = {"diffuse": tuple(BASE), "roughness": 0.5, "metallic": 0.4}
    material = rs.Material(**looks, sheen_color=tuple(color), sheen_roughness=roughness)
    rest = 1 - color.max() * albedo(VIEW[1], roughness)
    for toward in SUNS:
        base = brdf(toward, VIEW, 0.5, 0.4)
        expected = 2 * (rest * base + color * sheen(toward, VIEW, roughness)) * toward[1]
        np.testing.assert_allclose(seen(material, toward), expected, rtol=2e-3)


def test_the_light_of_fibres_without_vectors_and_in_layers():
    """Whitted's shading is of single rays in float64; guides of denoisers have all albedos."""
    color = np.array([0.9, 0.3, 0.05])
    material = rs.Material(
        **DARK, roughness=0.5, metallic=0.0, sheen_color=tuple(color), sheen_roughness=0.5
    )
    scene = floor(material, [rs.DirectionalLight(-SUNS[1], (2, 2, 2))])
    image = rs.render(scene, "whitted", (1, 1), 1, lights="file")
    reflected = 0.9 * albedo(VIEW[1], 0.5)
    ambient = color / 0.9 * reflected * scene_ambient(scene)
    expected = 2 * color * sheen(SUNS[1], VIEW, 0.5) * SUNS[1][1] + ambient
    np.testing.assert_allclose(image.pixels[0, 0], expected, rtol=2e-3)
    image = rs.render(scene, "path", (1, 1), 1, lights="file", layers=["albedo"])
    np.testing.assert_allclose(image.layers["albedo"][0, 0], color / 0.9 * reflected, rtol=2e-3)


def scene_ambient(scene):
    """What a white surface adds to the light of the suns in Whitted's shading."""
    white = rs.Material(**(DARK | {"diffuse": (1, 1, 1)}), roughness=1.0, metallic=0.0)
    lit, expected = seen(white, mode="whitted"), 2 * SUNS[1][1] / np.pi
    return lit - expected


LAYERS = {
    "coat": {"clearcoat": 1.0, "clearcoat_roughness": 0.3},
    "sheen": {"sheen_color": (1.0, 0.8, 0.5), "sheen_roughness": 0.4},
    "both": {"clearcoat": 0.5, "sheen_color": (0.5, 0.8, 0.2), "sheen_roughness": 0.2},
}

STRIPS = [
    rs.Material(diffuse=(0.5, 0.4, 0.3), specular=(0.3, 0.3, 0.3), shininess=20),
    rs.Material(diffuse=(0.8, 0.5, 0.2), roughness=0.3, metallic=1.0),
    rs.Material(diffuse=(0.5, 0, 0), roughness=0.6, metallic=0.5, **LAYERS["coat"]),
    rs.Material(diffuse=(0.1, 0, 0.1), roughness=1.0, metallic=0.0, **LAYERS["sheen"]),
    rs.Material(diffuse=(0.2, 0.2, 0.4), roughness=0.5, metallic=0.0, **LAYERS["both"]),
    rs.Material(diffuse=(1, 1, 1), transmission=(1, 1, 1), roughness=0.5, metallic=0.0, ior=1.5),
    rs.Material(diffuse=(0, 0, 0), transmission=(1, 1, 1), ior=1.5),
]


@pytest.mark.ci
@pytest.mark.parametrize("mode", ["path", "whitted", "raycast"])
def test_materials_side_by_side_in_a_vector(mode):
    """One ray at a time, as the multipass machine shades them, gives the same bits."""
    strips = [
        rs.Mesh(
            [[k, 0, 0], [k + 1, 0, 0], [k + 1, 0, 9], [k, 0, 9]],
            [[0, 2, 1], [0, 3, 2]],
            material_ids=k,
        )
        for k in range(len(STRIPS))
    ]
    camera = rs.Camera((3.5, 1.4, 4.4), (3.5, 0, 4.5), up=(0, 0, 1), fov=40)
    lights = [rs.DirectionalLight((-0.3, -1, 0.2)), rs.EnvironmentLight((0.5, 0.6, 0.7))]
    scene = rs.Scene(strips, materials=STRIPS, lights=lights, camera=camera)
    one, other = (
        rs.render(scene, mode, (35, 5), 2, machine=machine).pixels
        for machine in ("branching", "multipass")
    )
    np.testing.assert_array_equal(one, other)
    assert (one.max(axis=(0, 2)) > 0.01).mean() > 0.6


def test_a_coat_is_above_the_fibres():
    looks = {**DARK, "roughness": 0.5, "metallic": 0.0, "sheen_color": (1, 1, 1)}
    looks |= {"sheen_roughness": 0.5, "clearcoat_roughness": 0.5}
    toward = SUNS[2]
    bare, coated = (seen(rs.Material(**looks, clearcoat=c), toward) for c in (0.0, 0.8))
    share = coat_share(0.8, VIEW[1])
    coat = 2 * brdf(toward, VIEW, 0.5, 1.0, base=WHITE) * toward[1]
    np.testing.assert_allclose(coated, (1 - share) * bare + share * coat, rtol=2e-4)


def test_table_of_albedos():
    table = sheen_table()
    rows, columns = table.shape
    for row in (0, 3, 12, rows - 1):
        roughness = LEAST_SHEEN + (1 - LEAST_SHEEN) * row / (rows - 1)
        for column in (1, 9, 20, columns - 1):
            expected = albedo((column / (columns - 1)) ** 2, roughness)
            assert table[row, column] == pytest.approx(expected, rel=3e-3, abs=1e-6)


@pytest.mark.ci
@pytest.mark.parametrize("metallic", [0.0, 1.0])
@pytest.mark.parametrize("layers", LAYERS)
def test_light_samples_do_not_change_the_mean(layers, metallic):
    material = rs.Material(diffuse=(0.95,) * 3, roughness=0.4, metallic=metallic, **LAYERS[layers])
    scene = floor(material, [rs.EnvironmentLight((1, 1, 1))])
    options = {"sampler": "random", "seed": 3, "max_bounces": 1}
    one, other = (
        rs.render(scene, "path", (32, 32), 64, light_samples=light_samples, **options)
        for light_samples in (True, False)
    )
    assert_equal_means(one, other)
    assert_at_most(one, 1.0)


def test_fibres_do_not_make_light():
    """The extension's formula does, at grazing angles, where fibres are nearly upright."""
    material = rs.Material(**DARK, roughness=1.0, metallic=0.0, sheen_color=(1, 1, 1))
    scene = floor(material, [rs.EnvironmentLight((1, 1, 1))], eye=(-5, 0.1, 0))
    assert albedo(unit(5, 0.1)[1], LEAST_SHEEN) > 1.5
    image = rs.render(scene, "path", (32, 32), 64, sampler="random", max_bounces=1)
    assert_at_most(image, 1.0)
    assert image.pixels.mean() > 0.9


def test_a_smooth_coat_on_white_metal_loses_nothing():
    material = rs.Material(diffuse=(1, 1, 1), roughness=0.0, metallic=1.0, clearcoat=1.0)
    scene = floor(material, [rs.EnvironmentLight((1, 1, 1))], eye=(0.1, 5, 0))
    image = rs.render(scene, "path", (16, 16), 16, max_bounces=1, light_samples=False)
    np.testing.assert_allclose(image.pixels, 1.0, atol=1e-3)


@pytest.mark.ci
@pytest.mark.parametrize("mode", ["path", "whitted"])
def test_what_is_behind_a_coated_pane(mode):
    """A coat takes its share of the light that passes below it."""
    pane = rs.Material(
        **(DARK | {"diffuse": (1, 1, 1)}),
        transmission=(1, 1, 1),
        roughness=0.0,
        metallic=0.0,
        clearcoat=1.0,
    )
    camera = rs.Camera(EYE, (0, 0, 0), fov=1e-3)
    corners = np.array([[-9, 0, -9], [9, 0, -9], [9, 0, 9], [-9, 0, 9.0]])
    faces = [[0, 2, 1], [0, 3, 2]]
    below = rs.Mesh(corners - [0, 1, 0], faces, material_ids=1)
    lamp = rs.Material(diffuse=(0, 0, 0), emission=(3, 3, 3))
    scene = rs.Scene([rs.Mesh(corners, faces), below], materials=[pane, lamp], camera=camera)
    options = {"light_samples": False} if mode == "path" else {}
    image = rs.render(scene, mode, (32, 32), 64, lights="file", **options)
    share = coat_share(1.0, VIEW[1])
    around = 3 * 18**2 / (2 * (18**2 + 2 * 18)) if mode == "whitted" else 0.0
    expected = 3 * (1 - share) + share * around
    assert image.pixels.mean() == pytest.approx(expected, rel=2e-3)


def test_a_coat_has_normals_of_its_own():
    bent = rs.Texture(np.array([[(128 + 30, 128 - 20, 128 + 120)]], np.uint8))
    texcoords = np.array([[0, 0], [1, 0], [1, 1], [0, 1]])
    coat = {**DARK, "roughness": 0.5, "metallic": 0.0, "clearcoat": 1.0, "clearcoat_roughness": 0.5}
    plain = seen(rs.Material(**coat), texcoords=texcoords)
    over_bumps = seen(rs.Material(**coat, textures={"normal": bent}), texcoords=texcoords)
    np.testing.assert_allclose(over_bumps, plain, rtol=1e-5)
    # White metal with the same normals reflects as much as the coat, but for Fresnel's share.
    metal = {"diffuse": (1, 1, 1), "roughness": 0.5, "metallic": 1.0}
    for scale in (1.0, 0.5):
        of_metal = rs.Material(**metal, textures={"normal": bent}, normal_scale=scale)
        of_coat = rs.Material(
            **coat, textures={"clearcoat_normal": bent}, clearcoat_normal_scale=scale
        )
        x, y, z = scale * 30, scale * -20, 120
        normal = unit(x, z, y)  # u grows along +x, v along +z: the frame is left-handed
        share = coat_share(1.0, normal @ VIEW)
        expected = share * seen(of_metal, texcoords=texcoords)
        np.testing.assert_allclose(seen(of_coat, texcoords=texcoords), expected, rtol=1e-3)
        assert abs(expected / plain - 1).max() > 0.01


@pytest.mark.ci
def test_textures():
    texels = rs.Texture(np.array([[[51, 153, 7, 102]]], np.uint8))
    looks = {"diffuse": tuple(BASE), "roughness": 0.5, "metallic": 0.4}
    factors = {"clearcoat": 0.9, "clearcoat_roughness": 0.8, "sheen_roughness": 0.9}
    color = np.array([0.9, 0.7, 0.5])
    textures = {
        "clearcoat": texels,
        "clearcoat_roughness": texels,
        "sheen_color": texels,
        "sheen_roughness": texels.alpha(),
    }
    textured = rs.Material(**looks, **factors, sheen_color=tuple(color), textures=textures)
    linear = np.array([((c / 255 + 0.055) / 1.055) ** 2.4 for c in (51, 153)] + [7 / 255 / 12.92])
    plain = rs.Material(
        **looks,
        clearcoat=0.9 * 51 / 255,
        clearcoat_roughness=0.8 * 153 / 255,
        sheen_color=tuple(color * linear),
        sheen_roughness=0.9 * 102 / 255,
    )
    both = [seen(material, SUNS[2], texcoords=np.zeros((4, 2))) for material in (textured, plain)]
    np.testing.assert_allclose(*both, rtol=1e-5)


def test_materials_without_a_roughness_have_no_layers():
    bare = rs.Material(diffuse=tuple(BASE), specular=(0.1, 0.1, 0.1), shininess=9)
    layers = LAYERS["both"]
    layered = rs.Material(diffuse=tuple(BASE), specular=(0.1, 0.1, 0.1), shininess=9, **layers)
    np.testing.assert_array_equal(seen(layered), seen(bare))


@pytest.mark.parametrize(
    ("option", "value"),
    [("clearcoat", np.nan), ("sheen_color", (1, -1, 0)), ("sheen_roughness", np.inf)],
)
def test_damaged_layers(option, value):
    with pytest.raises(ValueError, match=option):
        rs.Material(**{option: value})

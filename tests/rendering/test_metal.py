"""glTF's metallic-roughness materials, against the formulas of its specification."""

import numpy as np
import pytest

import raystream as rs
from z_test import assert_at_most, assert_equal_means, assert_mean

FLOOR = np.array([[-9, 0, -9], [9, 0, -9], [9, 0, 9], [-9, 0, 9.0]])
UPWARD = [[0, 2, 1], [0, 3, 2]]
BASE = np.array([0.9, 0.5, 0.2])
EYE = np.array([-2.0, 1.5, 0.4])


def floor(material, lights, texcoords=None, eye=EYE):
    """The floor of a material, lit, and a camera that sees one point of it."""
    camera = rs.Camera(eye, (0, 0, 0), fov=1e-3)
    mesh = rs.Mesh(FLOOR, UPWARD, texcoords=texcoords)
    return rs.Scene([mesh], materials=[material], lights=lights, camera=camera)


def brdf(toward, view, roughness, metallic, normal=0.04, grazing=1.0, base=BASE, through=0.0):
    """Appendix B of the glTF 2.0 specification, by NumPy; the surface's normal is +y.

    With F0 and F90 of ``KHR_materials_specular``, and less to scatter by
    ``KHR_materials_transmission``.
    """
    half = (toward + view) / np.linalg.norm(toward + view)
    alpha2 = roughness**4
    light, seen, height, angle = toward[1], view[1], half[1], half @ view
    density = alpha2 / (np.pi * (height**2 * (alpha2 - 1) + 1) ** 2)
    visible = 0.5 / (
        light * np.sqrt(seen**2 * (1 - alpha2) + alpha2)
        + seen * np.sqrt(light**2 * (1 - alpha2) + alpha2)
    )
    mirror = np.array(normal) * (1 - metallic) + base * metallic
    highest = grazing * (1 - metallic) + metallic
    share = mirror + (highest - mirror) * (1 - angle) ** 5
    scattered = base * (1 - metallic) * (1 - through) / np.pi
    return (1 - share) * scattered + share * density * visible


@pytest.mark.parametrize("metallic", [0.0, 0.4, 1.0])
@pytest.mark.parametrize("roughness", [0.15, 0.5, 1.0])
def test_light_of_a_sun_is_reflected_as_the_specification_says(roughness, metallic):
    material = rs.Material(diffuse=tuple(BASE), roughness=roughness, metallic=metallic)
    view = EYE / np.linalg.norm(EYE)
    mirrored = np.array([-view[0], view[1], -view[2]])
    for toward in (mirrored, np.array([0.1, 1.0, 0.2]), np.array([2.0, 0.3, -1.0])):
        toward = toward / np.linalg.norm(toward)
        scene = floor(material, [rs.DirectionalLight(-toward, (2, 2, 2))])
        for mode in ("path", "shadow"):
            seen = rs.render(scene, mode, (1, 1), 1, lights="file").pixels[0, 0]
            expected = 2 * brdf(toward, view, roughness, metallic) * toward[1]
            if mode == "shadow":  # what surrounds it is grey, under the same sun
                normal = metallic * BASE + (1.0 - metallic) * 0.04
                expected = expected + normal * (0.5 * 2 / np.pi)
            np.testing.assert_allclose(seen, expected, rtol=2e-4)


@pytest.mark.parametrize("metallic", [0.0, 1.0])
@pytest.mark.parametrize("roughness", [0.2, 0.6])
def test_light_samples_do_not_change_the_mean(roughness, metallic):
    material = rs.Material(diffuse=tuple(BASE), roughness=roughness, metallic=metallic)
    scene = floor(material, [rs.EnvironmentLight((1, 1, 1))])
    options = {"sampler": "random", "seed": 3, "max_bounces": 1}
    one, other = (
        rs.render(scene, "path", (32, 32), 64, light_samples=light_samples, **options)
        for light_samples in (True, False)
    )
    assert_equal_means(one, other)
    assert_at_most(one, 1.0)


def test_smooth_white_metal_loses_nothing():
    scene = floor(
        rs.Material(diffuse=(1, 1, 1), roughness=0.0, metallic=1.0),
        [rs.EnvironmentLight((1, 1, 1))],
        eye=(0.1, 5, 0),
    )
    image = rs.render(scene, "path", (16, 16), 16, max_bounces=1, light_samples=False)
    np.testing.assert_allclose(image.pixels, 1.0, atol=1e-3)


@pytest.mark.parametrize(("through", "eye"), [(0.5, (0.1, 5, 0)), (1.0, (-2, 0.5, 0))])
def test_a_smooth_white_pane_loses_nothing(through, eye):
    """Reflected, transmitted and scattered light add up."""
    material = rs.Material(
        diffuse=(1, 1, 1), transmission=(through,) * 3, roughness=0.0, metallic=0.0, ior=1.0
    )
    scene = floor(material, [rs.EnvironmentLight((1, 1, 1))], eye=eye)
    image = rs.render(scene, "path", (16, 16), 64, max_bounces=1, light_samples=False)
    np.testing.assert_allclose(image.pixels.mean(), 1.0, atol=6e-3)


def test_a_texture_has_roughness_in_green_and_metal_in_blue():
    texels = np.array([[[7, 153, 51]]], np.uint8)
    light = [rs.DirectionalLight((-0.3, -1, 0.2))]
    factors = {"diffuse": tuple(BASE), "roughness": 0.5, "metallic": 0.75}
    textured = rs.Material(**factors, textures={"metallic_roughness": rs.Texture(texels)})
    plain = {**factors, "roughness": 0.5 * 153 / 255, "metallic": 0.75 * 51 / 255}
    seen = [
        rs.render(floor(material, light, np.zeros((4, 2))), "path", (1, 1)).pixels
        for material in (textured, rs.Material(**plain))
    ]
    np.testing.assert_allclose(*seen, rtol=1e-5)


@pytest.mark.ci
@pytest.mark.parametrize("metallic", [0.0, 0.4])
@pytest.mark.parametrize(
    ("normal", "grazing"), [((0.2, 0.1, 0.02), 1.0), ((0.02, 0.02, 0.02), 0.5), ((0, 0, 0), 0)]
)
def test_reflectances_of_what_is_not_metal(metallic, normal, grazing):
    material = rs.Material(
        diffuse=tuple(BASE),
        roughness=0.5,
        metallic=metallic,
        normal_reflectance=normal,
        grazing_reflectance=grazing,
    )
    view = EYE / np.linalg.norm(EYE)
    for toward in ([0.1, 1.0, 0.2], [2.0, 0.3, -1.0]):
        toward = np.array(toward) / np.linalg.norm(toward)
        scene = floor(material, [rs.DirectionalLight(-toward, (2, 2, 2))])
        for mode in ("path", "shadow"):
            seen = rs.render(scene, mode, (1, 1), 1, lights="file").pixels[0, 0]
            expected = 2 * brdf(toward, view, 0.5, metallic, normal, grazing) * toward[1]
            if mode == "shadow":  # what surrounds it is grey, under the same sun
                straight = metallic * BASE + (1 - metallic) * np.array(normal)
                expected = expected + straight * (0.5 * 2 / np.pi)
            np.testing.assert_allclose(seen, expected, rtol=2e-4)


def test_a_specular_texture_tints_the_reflectance_at_normal_incidence():
    texels = np.array([[[255, 128, 0]]], np.uint8)
    light = [rs.DirectionalLight((-0.3, -1, 0.2))]
    looks = {"diffuse": tuple(BASE), "roughness": 0.5, "metallic": 0.25}
    textured = rs.Material(**looks, textures={"specular": rs.Texture(texels)})
    half = 0.04 * ((128 / 255 + 0.055) / 1.055) ** 2.4  # sRGB
    plain = rs.Material(**looks, normal_reflectance=(0.04, half, 0))
    seen = [
        rs.render(floor(material, light, np.zeros((4, 2))), "path", (1, 1)).pixels
        for material in (textured, plain)
    ]
    np.testing.assert_allclose(*seen, rtol=1e-5)


@pytest.mark.parametrize("metallic", [0.0, 0.4, 1.0])
def test_transmission_takes_from_what_is_scattered(metallic):
    through = tuple(0.75 * BASE)
    looks = {"roughness": 0.6, "metallic": metallic, "ior": 1.0}
    material = rs.Material(diffuse=tuple(BASE), transmission=through, **looks)
    view = EYE / np.linalg.norm(EYE)
    toward = np.array([0.1, 1.0, 0.2]) / np.linalg.norm([0.1, 1.0, 0.2])
    scene = floor(material, [rs.DirectionalLight(-toward, (2, 2, 2))])
    seen = rs.render(scene, "path", (1, 1)).pixels[0, 0]
    expected = 2 * brdf(toward, view, 0.6, metallic, through=0.75) * toward[1]
    np.testing.assert_allclose(seen, expected, rtol=2e-4)


@pytest.mark.parametrize("mode", ["path", "whitted", "raycast"])
def test_textures_of_reflectance_and_transmission_are_factors_in_red(mode):
    """Of both reflectances, as ``specularTexture``, and of what passes, without sRGB."""
    texels = {"reflectance": (51, 7, 7), "transmission": (153, 7, 7)}
    textures = {name: rs.Texture(np.array([[texel]], np.uint8)) for name, texel in texels.items()}
    looks = {"diffuse": tuple(BASE), "roughness": 0.5, "metallic": 0.25}
    textured = rs.Material(
        **looks,
        transmission=tuple(0.5 * BASE),
        normal_reflectance=(0.5, 0.3, 0.1),
        grazing_reflectance=0.75,
        textures=textures,
    )
    plain = rs.Material(
        **looks,
        transmission=tuple(0.3 * BASE),
        normal_reflectance=(0.1, 0.06, 0.02),
        grazing_reflectance=0.15,
    )
    lights = [rs.DirectionalLight((-0.3, -1, 0.2)), rs.DirectionalLight((0.2, 1, 0.4))]
    eye = np.array([-2.0, 0.5, 0.4])  # both reflectances count
    seen = [
        rs.render(
            floor(material, lights, np.zeros((4, 2)), eye), mode, (1, 1), lights="file"
        ).pixels
        for material in (textured, plain)
    ]
    np.testing.assert_allclose(*seen, rtol=1e-5)
    assert seen[0].min() > 0.0


@pytest.mark.parametrize("metallic", [0.0, 0.4])
@pytest.mark.parametrize("mode", ["path", "whitted"])
def test_a_pane_shows_what_is_behind(mode, metallic):
    """Tinted by the base colour with its texture, and less by what the surface reflects."""
    texels = np.array([[[255, 128, 0]]], np.uint8)
    tint = np.array([1, ((128 / 255 + 0.055) / 1.055) ** 2.4, 0]) * BASE
    looks = {"roughness": 0.0, "metallic": metallic, "ior": 1.0}
    material = rs.Material(
        diffuse=tuple(BASE),
        transmission=tuple(BASE),
        **looks,
        textures={"diffuse": rs.Texture(texels)},
    )
    pane = rs.Mesh(FLOOR, UPWARD, texcoords=np.zeros((4, 2)))
    below = rs.Mesh(FLOOR - [0, 1, 0], UPWARD, material_ids=1)
    lamp = rs.Material(diffuse=(0, 0, 0), emission=(3, 3, 3))
    camera = rs.Camera(EYE, (0, 0, 0), fov=1e-3)
    scene = rs.Scene([pane, below], materials=[material, lamp], camera=camera)
    options = {"sampler": "random", "light_samples": False} if mode == "path" else {}
    image = rs.render(scene, mode, (32, 32), 64, **options)
    cosine = EYE[1] / np.linalg.norm(EYE)
    mirror = 0.04 * (1 - metallic) + tint * metallic
    share = (mirror + (1 - mirror) * (1 - cosine) ** 5).mean()
    expected = 3 * (1 - metallic) * (1 - share) * tint
    if mode == "path":
        assert_mean(image, expected)
    else:
        around = 3 * 18**2 / (2 * (18**2 + 2 * 18))  # the lamp's light, over the box's area
        np.testing.assert_allclose(image.pixels[0, 0], expected + mirror * around, rtol=1e-3)

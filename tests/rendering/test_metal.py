"""glTF's metallic-roughness materials, against the formulas of its specification."""

import numpy as np
import pytest

import raystream as rs
from z_test import assert_at_most, assert_equal_means

FLOOR = np.array([[-9, 0, -9], [9, 0, -9], [9, 0, 9], [-9, 0, 9.0]])
UPWARD = [[0, 2, 1], [0, 3, 2]]
BASE = np.array([0.9, 0.5, 0.2])
EYE = np.array([-2.0, 1.5, 0.4])


def floor(material, lights, texcoords=None, eye=EYE):
    """The floor of a material, lit, and a camera that sees one point of it."""
    camera = rs.Camera(eye, (0, 0, 0), fov=1e-3)
    mesh = rs.Mesh(FLOOR, UPWARD, texcoords=texcoords)
    return rs.Scene([mesh], materials=[material], lights=lights, camera=camera)


def brdf(toward, view, roughness, metallic):
    """Appendix B of the glTF 2.0 specification, by NumPy; the surface's normal is +y."""
    half = (toward + view) / np.linalg.norm(toward + view)
    alpha2 = roughness**4
    light, seen, height, angle = toward[1], view[1], half[1], half @ view
    density = alpha2 / (np.pi * (height**2 * (alpha2 - 1) + 1) ** 2)
    visible = 0.5 / (
        light * np.sqrt(seen**2 * (1 - alpha2) + alpha2)
        + seen * np.sqrt(light**2 * (1 - alpha2) + alpha2)
    )
    mirror = 0.04 * (1 - metallic) + BASE * metallic
    share = mirror + (1 - mirror) * (1 - angle) ** 5
    return (1 - share) * BASE * (1 - metallic) / np.pi + share * density * visible


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

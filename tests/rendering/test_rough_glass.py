"""Rough panes and rough glass, against integrals of published microfacet models."""

from __future__ import annotations

import numpy as np
import pytest

import raystream as rs
from meshes import icosphere
from z_test import assert_at_most, assert_mean

FLOOR = np.array([[-9, 0, -9], [9, 0, -9], [9, 0, 9], [-9, 0, 9.0]])
UPWARD = [[0, 2, 1], [0, 3, 2]]
EYE = np.array([-2.0, 1.5, 0.4])
VIEW = EYE / np.linalg.norm(EYE)
TINT = np.array([0.9, 0.5, 0.2])
NORMAL = np.array([0.0, 1.0, 0.0])

#: A lamp below the floor, near the straight way through it: x, z of its corners, and its depth.
LAMP, DEPTH = ((0.7, -0.6), (1.7, 0.3)), 1.0


def scene_of(ior, roughness):
    pane = rs.Material(
        diffuse=tuple(TINT),
        transmission=tuple(TINT),
        roughness=roughness,
        metallic=0.0,
        ior=ior,
        normal_reflectance=(0, 0, 0),
        grazing_reflectance=0,
    )
    (left, near), (right, far) = LAMP
    corners = [[left, -DEPTH, near], [right, -DEPTH, near], [right, -DEPTH, far]]
    corners.append([left, -DEPTH, far])
    lamp = rs.Material(diffuse=(0, 0, 0), emission=(3, 3, 3))
    meshes = [rs.Mesh(FLOOR, UPWARD), rs.Mesh(np.array(corners), UPWARD, material_ids=1)]
    camera = rs.Camera(EYE, (0, 0, 0), fov=1e-3)
    return rs.Scene(meshes, materials=[pane, lamp], camera=camera)


def lamp_points(count=700):
    """Directions from the origin to points of the lamp, and their solid angles."""
    (left, near), (right, far) = LAMP
    part = (np.arange(count) + 0.5) / count
    x, z = np.meshgrid(left + (right - left) * part, near + (far - near) * part)
    places = np.stack([x, np.full_like(x, -DEPTH), z], axis=-1).reshape(-1, 3)
    square = (places**2).sum(axis=1)
    directions = places / np.sqrt(square)[:, None]
    area = (right - left) * (far - near) / count**2
    return directions, area * -directions[:, 1] / square


def ggx(height, alpha):
    return alpha**2 / (np.pi * (height**2 * (alpha**2 - 1) + 1) ** 2)


def smith(cosine, alpha):
    return 2 * cosine / (cosine + np.sqrt(alpha**2 + (1 - alpha**2) * cosine**2))


def through_pane(toward, alpha):
    """`specular_btdf` of ``KHR_materials_transmission`` times the cosine."""
    turned = toward * [1, -1, 1]
    half = turned + VIEW
    height = half[:, 1] / np.linalg.norm(half, axis=1)
    masked = smith(turned[:, 1], alpha) * smith(VIEW[1], alpha)
    return masked * ggx(height, alpha) / (4 * VIEW[1])


def through_glass(toward, alpha, ior):
    """Equation 21 of Walter et al. 2007 times the cosine; radiance in glass over ior squared."""
    half = -(VIEW + ior * toward)
    half /= np.linalg.norm(half, axis=1)[:, None]
    half *= np.sign(half[:, 1:2])
    seen, light = half @ VIEW, (half * toward).sum(axis=1)
    g = np.sqrt(ior**2 - 1 + seen**2)
    ratio = (seen * (g + seen) - 1) / (seen * (g - seen) + 1)
    fresnel = 0.5 * ((g - seen) / (g + seen)) ** 2 * (1 + ratio**2)
    masked = smith(-toward[:, 1], alpha) * smith(VIEW[1], alpha)
    masked *= (seen > 0) & (light < 0)
    jacobian = ior**2 / (seen + ior * light) ** 2
    value = abs(seen * light) / VIEW[1] * (1 - fresnel) * masked * ggx(half[:, 1], alpha) * jacobian
    return value / ior**2


@pytest.mark.parametrize("ior", [1.0, 1.5])
@pytest.mark.parametrize("roughness", [0.3, 0.5, 0.9])
def test_a_lamp_behind_rough_glass(roughness, ior):
    options = {"sampler": "random", "lights": "file", "light_samples": False, "max_bounces": 1}
    image = rs.render(scene_of(ior, roughness), "path", (64, 64), 64, **options)
    toward, angles = lamp_points()
    alpha = roughness**2
    value = through_pane(toward, alpha) if ior == 1.0 else through_glass(toward, alpha, ior)
    assert_mean(image, 3 * TINT * (value * angles).sum())


def test_light_samples_do_not_see_through_glass():
    """They must not count the same light twice."""
    options = {"sampler": "random", "lights": "file", "max_bounces": 1}
    image = rs.render(scene_of(1.0, 0.5), "path", (64, 64), 64, **options)
    toward, angles = lamp_points()
    assert_mean(image, 3 * TINT * (through_pane(toward, 0.25) * angles).sum())


@pytest.mark.parametrize("roughness", [0.2, 0.8])
def test_a_rough_ball_of_glass_makes_no_light(roughness):
    glass = rs.Material(
        diffuse=(1, 1, 1),
        transmission=(1, 1, 1),
        roughness=roughness,
        metallic=0.0,
        ior=1.5,
        normal_reflectance=(0, 0, 0),
        grazing_reflectance=0,
    )
    vertices, faces = icosphere(4)
    camera = rs.Camera((0, 0, 5), (0, 0, 0), fov=20)
    scene = rs.Scene(
        [rs.Mesh(vertices, faces, normals=vertices)],
        materials=[glass],
        lights=[rs.EnvironmentLight((1, 1, 1))],
        camera=camera,
    )
    image = rs.render(scene, "path", (32, 32), 64, sampler="random", max_bounces=30)
    assert_at_most(image, 1.0)
    assert image.pixels.mean() > (0.95 if roughness < 0.5 else 0.4)

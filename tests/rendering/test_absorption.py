"""Absorption in glass, against the Beer-Lambert law."""

from __future__ import annotations

import numpy as np
import pytest

import raystream as rs
from meshes import cube
from z_test import assert_at_most, assert_mean

WHITE, BLACK = (1.0, 1.0, 1.0), (0.0, 0.0, 0.0)
ABSORPTION = (0.1, 0.7, 2.0)


def glass(ior, absorption=ABSORPTION, length=1.0):
    """A box viewed head-on, before a white background."""
    vertices, faces = cube()
    material = rs.Material(diffuse=BLACK, transmission=WHITE, ior=ior, absorption=absorption)
    middle = np.array([0.4, 0.6, 0.5]) * length
    camera = rs.Camera(middle + [0, 0, 9 * length], middle, fov=1e-3)
    mesh = rs.Mesh(vertices * length, faces)
    return rs.Scene([mesh], materials=[material], background=WHITE, camera=camera)


def seen_through(ior, length=1.0):
    """Transmission and reflection of a slab with all internal bounces (a geometric series)."""
    left = np.exp(-np.array(ABSORPTION) * length)
    mirrored = ((ior - 1) / (ior + 1)) ** 2
    return mirrored + (1 - mirrored) ** 2 * left / (1 - mirrored * left)


@pytest.mark.parametrize("length", [1.0, 0.01, 3.0])
@pytest.mark.parametrize("ior", [1.0, 1.5])
def test_a_slab_of_glass(ior, length):
    scene = glass(ior, length=length)
    image = rs.render(scene, "whitted", (1, 1), max_bounces=30, min_weight=0.0)
    np.testing.assert_allclose(image.pixels[0, 0], seen_through(ior, length), rtol=1e-5)
    image = rs.render(scene, "path", (32, 32), 16, max_bounces=30, sampler="random")
    assert_mean(image, seen_through(ior, length))


def test_directions_need_not_be_unit_length():
    """The camera's rays are not, at the border of a wide image."""
    vertices, faces = cube()
    material = rs.Material(diffuse=BLACK, transmission=WHITE, absorption=ABSORPTION)
    camera = rs.Camera((0.5, 0.5, 0.999), (0.5, 0.5, 0), fov=60)  # inside
    scene = rs.Scene(
        [rs.Mesh(vertices, faces)], materials=[material], background=WHITE, camera=camera
    )
    _, directions = camera.rays(9, 9)
    inside = -0.999 / directions[:, :, 2] * np.linalg.norm(directions, axis=2)
    is_far = (abs(directions[:, :, :2] / directions[:, :, 2:]) < 0.5).all(axis=2)
    image = rs.render(scene, "whitted", (9, 9), min_weight=0.0)
    expected = np.exp(-np.array(ABSORPTION) * inside[:, :, None])
    assert is_far.sum() > 20
    np.testing.assert_allclose(image.pixels[is_far], expected[is_far], rtol=1e-4)


def test_glass_that_absorbs_makes_no_light():
    scene = glass(1.5, (0.0, 0.5, 1e30))
    image = rs.render(scene, "path", (16, 16), 16, max_bounces=1000, sampler="random")
    assert np.isfinite(image.pixels).all()
    assert_at_most(image, 1.0)
    assert_mean(image, (1.0, *seen_through_half_and_nothing()))


def seen_through_half_and_nothing():
    left, mirrored = np.exp(-0.5), 0.04
    return mirrored + (1 - mirrored) ** 2 * left / (1 - mirrored * left), mirrored


def test_absorption_is_checked():
    with pytest.raises(ValueError, match="absorption: expected three finite numbers >= 0"):
        rs.Material(absorption=(0.0, -1.0, 0.0))
    with pytest.raises(ValueError, match="alpha_cutoff: expected a finite number"):
        rs.Material(alpha_cutoff=float("nan"))

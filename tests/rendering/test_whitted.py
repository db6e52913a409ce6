"""Iterative Whitted rendering against a recursive ray tracer in float64."""

import numpy as np
import pytest

import raystream as rs
from rendering.recursive_reference import MOVED, Reference

SIZE = 24
BOUNCES = 5


@pytest.fixture(scope="module", params=["cornell_mirrors", "spheres", "boxes:1000"])
def view(request):
    """A scene after Christen's, its camera rays, and its images with 0 to 5 bounces."""
    scene = rs.load(request.param)
    camera, tracer = scene.camera_for(1.0), rs.Tracer(scene)
    rays = [array.reshape(-1, 3) for array in camera.rays(SIZE, SIZE)]
    options = {"size": (SIZE, SIZE), "camera": camera, "min_weight": 0.0}
    images = [rs.render(tracer, "whitted", max_bounces=k, **options) for k in range(BOUNCES + 1)]
    return scene, rays, np.stack([image.pixels.reshape(-1, 3) for image in images])


def test_pictures_are_those_of_a_recursive_ray_tracer(view):
    """Christen 2005, equation 5.1, with shadows and glass: along the same rays."""
    scene, rays, pictures = view
    expected = Reference(scene, rs.Tracer(scene, "brute")).render(*rays, BOUNCES)
    np.testing.assert_allclose(pictures, expected, rtol=0, atol=1e-5)
    # Each bounce shows, so that one too many or too few would be found.
    for k in range(1, BOUNCES if scene.name == "cornell_mirrors" else 3):
        assert np.abs(pictures[k] - pictures[k - 1]).max() > 1e-4, k


def test_differences_from_float64_are_those_of_rays_that_float32_moves(view):
    scene, rays, pictures = view
    expected = Reference(scene).render(*rays, BOUNCES)
    differences = np.abs(pictures - expected).max(axis=2)
    doubtful = np.flatnonzero((differences > 1e-5).any(axis=0))
    assert len(doubtful) < 0.02 * SIZE**2
    if not len(doubtful):
        return
    some, allowed = [array[doubtful] for array in rays], 1e-5
    for seed in range(16):
        moved = Reference(scene, moved=MOVED, seed=seed).render(*some, BOUNCES)
        changes = np.abs(moved - expected[:, doubtful]).max(axis=2)
        allowed = np.maximum(allowed, 1e-5 + changes)
    assert (differences[:, doubtful] <= allowed).all()


def test_without_shadows_nothing_blocks_light():
    """A ray caster, where there are no mirrors; brighter than with shadows where they fall."""
    scene = rs.load("cornell")
    bright, dark = (
        rs.render(scene, "whitted", (32, 32), shadows=shadows).pixels for shadows in (False, True)
    )
    raycast = rs.render(scene, "raycast", (32, 32)).pixels
    np.testing.assert_allclose(bright, raycast, rtol=1e-5, atol=1e-6)
    assert (bright >= dark).all()
    assert (bright > dark).any()

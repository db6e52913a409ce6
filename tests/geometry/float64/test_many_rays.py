"""The many-ray kernels of float64: every answer has the bits of single rays."""

from __future__ import annotations

import numpy as np
import pytest

import raystream as rs
from meshes import dented_sphere, soup

COLUMNS = ("t", "u", "v", "prim_id", "ray_splits", "status")


def answers_of(tracer, origins, directions, **limits):
    """Counts and all hits, by both rules at edges; first and any hits."""
    first = tracer.first_hit(origins, directions, **limits)
    found = [getattr(first, name) for name in COLUMNS if name != "ray_splits"]
    found.append(tracer.any_hit(origins, directions, **limits))
    for crossings in ("triangles", "surfaces"):
        found.append(tracer.count_hits(origins, directions, crossings=crossings, **limits))
        many = tracer.multi_hit(origins, directions, crossings=crossings, **limits)
        found += [getattr(many, name) for name in COLUMNS]
    return found


def assert_same_bits(scene, kernels, origins, directions, **limits):
    single = rs.Tracer(scene, rs.Bvh(kernel="single"), precision="float64")
    wanted = answers_of(single, origins, directions, **limits)
    for kernel in kernels:
        tracer = rs.Tracer(scene, rs.Bvh(kernel=kernel), precision="float64")
        for one, other in zip(
            answers_of(tracer, origins, directions, **limits), wanted, strict=True
        ):
            assert one.dtype == other.dtype
            assert one.tobytes() == other.tobytes()
    return wanted


def camera_rays(scene, rng):
    """A picture with parts of tiles at its borders."""
    low, high = scene.bounds
    y, x = np.mgrid[-1:1:50j, -1:1:70j]
    directions = np.stack([x, y, np.full_like(x, -2.0)], axis=-1)
    return (low + high) / 2 + [0.0, 0.0, 2.0 * (high - low).max()], directions


def random_rays(scene, rng):
    low, high = scene.bounds
    return rng.uniform(low, high, (1500, 3)), rng.normal(size=(1500, 3))


def rays_to_edges(scene, rng):
    """Through the middles of edges and through vertices, as far as float64 can."""
    mesh = scene.meshes[0]
    corners = mesh.vertices.astype(np.float64)[mesh.faces[rng.integers(0, len(mesh.faces), 1200)]]
    ends = corners[:, 0] * 0.5 + corners[:, 1] * 0.5
    ends[::2] = corners[::2, 2]
    origins = rng.uniform(*scene.bounds, (1200, 3))
    return origins, ends - origins


def far_rays(scene, rng):
    """From 1,000 sizes to 10,000,000 sizes away, among near ones; some of these are invalid."""
    origins, directions = rays_to_edges(scene, rng)
    ends = origins + directions
    size = np.ptp(scene.bounds, axis=0).max()
    origins[::5] += rng.normal(size=(240, 3)) * size * 10.0 ** rng.integers(3, 8, (240, 1))
    directions = ends - origins
    directions[::7] *= 2.0 ** rng.integers(-1000, 500, (len(directions[::7]), 1)).astype(float)
    directions[3::50] = 0.0
    origins[4::50, 1] = np.nan
    return origins, directions


SCENES = {
    "soup": lambda: soup(400, seed=3),
    "sphere on the ground": lambda: (dented_sphere(3)[0] + 6.4e6, dented_sphere(3)[1]),
    "without areas": lambda: degenerate_soup(),
}


def degenerate_soup():
    """Triangles that are lines and points, and triangles twice, among others."""
    vertices, faces = soup(300, seed=4)
    faces = np.array(faces)
    faces[::5, 2] = faces[::5, 1]
    faces[1::10, 1:] = faces[1::10, :1]
    return vertices, np.vstack([faces, faces[2::3]])


@pytest.mark.parametrize("rays", [camera_rays, random_rays, rays_to_edges, far_rays])
@pytest.mark.parametrize("name", SCENES)
def test_many_rays_are_answered_as_single_ones(name, rays):
    scene, rng = rs.Scene.from_arrays(*SCENES[name]()), np.random.default_rng(11)
    origins, directions = rays(scene, rng)
    directions = np.asarray(directions, np.float64)
    origins = np.broadcast_to(origins, directions.shape)
    wanted = assert_same_bits(scene, ("packet", "groups"), origins, directions)
    assert sum(wanted[6]) > 0 if wanted[6].ndim == 1 else wanted[6].sum() > 0
    limits = {
        "t_min": rng.uniform(-0.5, 0.5, directions.shape[:-1]),
        "t_max": rng.uniform(0.3, 1.5, directions.shape[:-1]),
    }
    assert_same_bits(scene, ("packet", "groups"), origins, directions, **limits)


def test_hits_that_do_not_fit_into_the_first_buffers():
    """Also of rays that are traced by themselves."""
    vertices, faces = soup(1, seed=1)
    scene = rs.Scene.from_arrays(vertices, np.tile(faces, (300, 1)))
    middle = vertices[faces[0]].astype(np.float64).mean(axis=0)
    origins = middle + np.random.default_rng(2).normal(size=(2000, 3))
    origins[7::16] = middle + (origins[7::16] - middle) * 2.0**24
    wanted = assert_same_bits(scene, ("packet",), origins, middle - origins)
    assert (wanted[6] == 300).mean() > 0.9


def test_rays_with_only_a_nan_miss():
    """Their directions and the other coordinates are as those of rays that hit."""
    vertices = np.array([[-1.0, -1.0, 1.0], [3.0, -1.0, 1.0], [-1.0, 3.0, 1.0]])
    scene = rs.Scene.from_arrays(vertices, [[0, 1, 2]])
    origins, directions = np.zeros((512, 3)), np.tile([0.0, 0.0, 1.0], (512, 1))
    origins[5::16, 0] = np.nan
    wanted = assert_same_bits(scene, ("packet", "groups"), origins, directions)
    is_nan = np.isnan(origins[:, 0])
    assert np.array_equal(wanted[5], ~is_nan)
    assert np.array_equal(wanted[4] == rs.RayStatus.INVALID, is_nan)

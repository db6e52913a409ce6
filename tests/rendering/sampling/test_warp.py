"""The maps of the unit square, each against its density."""

from __future__ import annotations

import math

import numpy as np
import pytest

from chi_square import assert_follows
from raystream.jit.cpu import kernel
from raystream.rendering.sampling import ggx, warp
from raystream.rendering.sampling.sampler import Sampler

COUNT = 1 << 18
CELLS = 16  # in z and in the angle around it, or in x and in y
FINE = 32  # points of quadrature in a cell, along each side

#: Kinds for the kernels below: Numba compiles the calls, not names.
COSINE, SPHERE, POWER, GGX = range(4)

VIEWS = {
    "head on": (0.0, 0.0, 1.0),
    "slanting": (0.6, 0.0, 0.8),
    "aside": (-0.48, 0.64, 0.6),
    "grazing": (0.0, -math.sqrt(1 - 0.05**2), 0.05),
}

DIRECTIONS = {
    "cosine": (COSINE, ()),
    "sphere": (SPHERE, ()),
    "power 0": (POWER, (0.0,)),
    "power 1": (POWER, (1.0,)),
    "power 25": (POWER, (25.0,)),
    **{f"ggx, {name}": (GGX, (*view, 0.5, 0.5)) for name, view in VIEWS.items()},
    **{f"ggx, brushed, {name}": (GGX, (*view, 0.7, 0.2)) for name, view in VIEWS.items()},
}


@kernel
def directions_of(kind, p, points, out):
    for i in range(len(points)):
        u, v = points[i, 0], points[i, 1]
        if kind == COSINE:
            d = warp.cosine_hemisphere(u, v)
        elif kind == SPHERE:
            d = warp.sphere(u, v)
        elif kind == POWER:
            d = warp.power_cosine(u, v, p[0])
        else:
            d = ggx.visible_normal(u, v, p[0], p[1], p[2], p[3], p[4])
        out[i, 0], out[i, 1], out[i, 2] = d


def densities(name, directions):
    """Per steradian, in closed form."""
    kind, parameters = DIRECTIONS[name]
    z = directions[:, 2].astype(np.float64)
    if kind == SPHERE:
        return np.full(len(z), 0.25 / np.pi)
    above = np.maximum(z, 0.0)
    if kind == COSINE:
        return above / np.pi
    if kind == POWER:
        return np.where(
            z > 0.0, (parameters[0] + 1.0) / (2.0 * np.pi) * above ** parameters[0], 0.0
        )
    view, stretch = np.array(parameters[:3]), np.array([*parameters[3:], 1.0])
    square = ((directions / stretch) ** 2).sum(axis=1, dtype=np.float64)
    faces = np.where(z > 0.0, 1.0 / (np.pi * stretch.prod() * square**2), 0.0)
    cosine = np.maximum(directions.astype(np.float64) @ view, 0.0)
    return faces * 2.0 * cosine / (view[2] + np.linalg.norm(stretch * view))


@kernel
def turned(points, normals, out):
    for i in range(len(points)):
        d, n = points[i], normals[i]
        out[i, 0], out[i, 1], out[i, 2] = warp.to_world(d[0], d[1], d[2], n[0], n[1], n[2])


@kernel
def frames(normals, out):
    for i in range(len(normals)):
        b = warp.basis(normals[i, 0], normals[i, 1], normals[i, 2])
        for k in range(6):
            out[i, k] = b[k]


@kernel
def flat_points(is_disk, points, out):
    for i in range(len(points)):
        u, v = points[i, 0], points[i, 1]
        out[i, 0], out[i, 1] = warp.disk(u, v) if is_disk else warp.triangle(u, v)


def random_points(count=COUNT):
    return Sampler.of("random", 1234).numbers(np.arange(count), 0, 0, 2)


#: The square's corners and edges, as near to 1 as a number comes.
CORNERS = np.array(
    [(u, v) for u in (0, 2**-24, 0.5, 1 - 2**-24) for v in (0, 2**-24, 0.5, 1 - 2**-24)],
    np.float32,
)


def sample_directions(name, points):
    kind, parameters = DIRECTIONS[name]
    out = np.empty((len(points), 3), np.float32)
    directions_of(kind, np.array(parameters, np.float32), points, out)
    return out


def integrals(name, lowest=-1.0):
    """Of the density over cells of z, from the lowest to 1, and angle, by the midpoint rule."""
    side = CELLS * FINE
    z = lowest + (np.arange(side) + 0.5) / side * (1 - lowest)
    angle = (np.arange(side) + 0.5) / side * 2 * np.pi
    radius = np.sqrt(1 - z * z)[:, None]
    parts = (
        radius * np.cos(angle),
        radius * np.sin(angle),
        np.broadcast_to(z[:, None], (side, side)),
    )
    values = densities(name, np.stack(parts, -1).reshape(-1, 3))
    steradians = (1 - lowest) * 2 * np.pi / side**2
    return values.reshape(CELLS, FINE, CELLS, FINE).sum(axis=(1, 3)) * steradians


@pytest.fixture(params=DIRECTIONS)
def name(request):
    return request.param


def test_a_density_integrates_to_1(name):
    assert integrals(name).sum() == pytest.approx(1, abs=2e-3)


def test_directions_follow_their_density(name):
    lowest = -1.0 if name == "sphere" else 0.0
    directions = sample_directions(name, random_points()).astype(np.float64)
    assert (directions[:, 2] >= lowest).all()
    row = np.minimum((directions[:, 2] - lowest) / (1 - lowest) * CELLS, CELLS - 1).astype(int)
    turn = np.arctan2(directions[:, 1], directions[:, 0]) / (2 * np.pi) % 1.0
    column = np.minimum(turn * CELLS, CELLS - 1).astype(int)
    counts = np.bincount(row * CELLS + column, minlength=CELLS**2)
    assert_follows(counts, integrals(name, lowest).ravel() * COUNT)


def test_directions_are_unit_vectors_with_a_density(name):
    for points in (random_points(1 << 14), CORNERS):
        directions = sample_directions(name, points)
        lengths = np.linalg.norm(directions.astype(np.float64), axis=1)
        np.testing.assert_allclose(lengths, 1, atol=5e-7)
        pdf = densities(name, directions)
        assert np.isfinite(pdf).all()
        # On the rim itself rounding may decide that it is outside.
        assert (pdf[(directions[:, 2] > 1e-3) | (name == "sphere")] > 0).all()


def test_narrow_lobes_keep_their_digits():
    points = random_points(1 << 14)
    out = np.empty((len(points), 3), np.float32)
    directions_of(POWER, np.array([1e6], np.float32), points, out)
    sine2 = (out[:, :2].astype(np.float64) ** 2).sum(axis=1)
    assert sine2.mean() == pytest.approx(2e-6, rel=0.05)  # 2 / (n + 3)


def test_mirrors_stay_mirrors():
    """With hardly any roughness each normal is +z, and finite at every view."""
    points = np.concatenate([random_points(1 << 12), CORNERS])
    for view in (*VIEWS.values(), (1.0, 0.0, 0.0)):
        out = np.empty((len(points), 3), np.float32)
        directions_of(GGX, np.array([*view, 1e-4, 1e-4], np.float32), points, out)
        assert np.isfinite(out).all()
        assert np.median(out[:, 2]) > 1 - 1e-6


def test_points_of_a_disk_are_even():
    points = random_points()
    out = np.empty((COUNT, 2), np.float32)
    flat_points(True, points, out)
    radius2 = (out.astype(np.float64) ** 2).sum(axis=1)
    turn = np.arctan2(out[:, 1], out[:, 0]) / (2 * np.pi) % 1.0
    index = np.minimum(radius2 * CELLS, CELLS - 1).astype(int) * CELLS
    index += np.minimum(turn * CELLS, CELLS - 1).astype(int)
    assert_follows(np.bincount(index, minlength=CELLS**2), np.full(CELLS**2, COUNT / CELLS**2))
    assert radius2.max() <= 1 + 1e-6


def test_squares_become_circles():
    """Shirley and Chiu's map: the square's edge is the rim, its middle the centre."""
    edge = np.array([(0, 0.3), (0.7, 0), (0, 0), (1 - 2**-24, 0.2)], np.float32)
    middle = np.array([(0.5, 0.5)], np.float32)
    out = np.empty((5, 2), np.float32)
    flat_points(True, np.concatenate([edge, middle]), out)
    np.testing.assert_allclose(np.hypot(*out[:4].T), 1, atol=1e-6)
    assert not out[4].any()


def test_points_of_a_triangle_are_even():
    """On a grid over the weights: whole cells below the diagonal, halves along it."""
    points = random_points()
    out = np.empty((COUNT, 2), np.float32)
    flat_points(False, points, out)
    assert (out >= 0).all()
    assert (out.astype(np.float64).sum(axis=1) <= 1).all()
    cells = np.minimum((out * CELLS).astype(int), CELLS - 1)
    counts = np.bincount(cells[:, 0] * CELLS + cells[:, 1], minlength=CELLS**2)
    i, j = np.divmod(np.arange(CELLS**2), CELLS)
    area = np.where(i + j < CELLS - 1, 1.0, np.where(i + j == CELLS - 1, 0.5, 0.0))
    assert_follows(counts, COUNT * area / area.sum())


def test_bases_are_orthonormal_and_right_handed(rng):
    normals = rng.normal(size=(10_000, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    hard = [
        (0, 0, 1),
        (0, 0, -1),
        (1, 0, 0),
        (0, -1, 0),
        (1e-4, 0, -1),
        (0, 1e-20, -1),
        (0, 1, -0.0),
    ]
    normals = np.concatenate([normals, hard]).astype(np.float32)
    out = np.empty((len(normals), 6), np.float32)
    frames(normals, out)
    matrix = np.concatenate([out, normals], axis=1).reshape(-1, 3, 3).astype(np.float64)
    product = matrix @ matrix.transpose(0, 2, 1)
    np.testing.assert_allclose(product, np.broadcast_to(np.eye(3), product.shape), atol=1e-6)
    assert (np.linalg.det(matrix) > 0.999).all()


def test_a_direction_turns_with_its_normal(rng):
    normals = rng.normal(size=(1000, 3))
    normals = (normals / np.linalg.norm(normals, axis=1, keepdims=True)).astype(np.float32)
    directions = sample_directions("sphere", random_points(1000))
    out = np.empty_like(directions)
    turned(directions, normals, out)
    np.testing.assert_allclose((out * normals).sum(axis=1), directions[:, 2], atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(out, axis=1), 1, atol=1e-6)
    turned(np.tile(np.float32([0, 0, 1]), (1000, 1)), normals, out)
    np.testing.assert_array_equal(out, normals)


def test_no_face_is_seen_from_behind():
    for name, view in VIEWS.items():
        normals = sample_directions(f"ggx, {name}", random_points(1 << 14))
        assert (normals[:, 2] > 0).all()
        assert (normals @ np.float32(view) > -1e-6).all()

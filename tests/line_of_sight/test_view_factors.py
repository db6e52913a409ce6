"""View factors against closed forms, and their properties in enclosures."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import raystream as rs
from meshes import cube, icosphere, soup
from raystream.line_of_sight.balance import Shares, balanced
from raystream.line_of_sight.patches import Emitter, make_patches

# Closed forms, from the catalogues of configuration factors (Howell; Siegel and Howell).


def opposed_rectangles(a, b, c):
    """Equal parallel rectangles a x b, directly opposed at distance c."""
    x, y = a / c, b / c
    p, q = 1 + x * x, 1 + y * y
    total = 0.5 * math.log(p * q / (p + y * y))
    total += x * math.sqrt(q) * math.atan(x / math.sqrt(q))
    total += y * math.sqrt(p) * math.atan(y / math.sqrt(p))
    total -= x * math.atan(x) + y * math.atan(y)
    return 2 / (math.pi * x * y) * total


def perpendicular_rectangles(length, width, height):
    """From a rectangle width x length to one of height x length at the common edge `length`."""
    h, w = height / length, width / length
    hh, ww = h * h, w * w
    both = hh + ww
    logs = (1 + ww) * (1 + hh) / (1 + both)
    logs *= (ww * (1 + both) / ((1 + ww) * both)) ** ww
    logs *= (hh * (1 + both) / ((1 + hh) * both)) ** hh
    angles = w * math.atan(1 / w) + h * math.atan(1 / h)
    angles -= math.sqrt(both) * math.atan(1 / math.sqrt(both))
    return (angles + 0.25 * math.log(logs)) / (math.pi * w)


def coaxial_disks(r1, r2, distance):
    """From a disk of radius r1 to one of radius r2, parallel and coaxial."""
    a, b = r1 / distance, r2 / distance
    s = 1 + (1 + b * b) / (a * a)
    return 0.5 * (s - math.sqrt(s * s - 4 * (r2 / r1) ** 2))


def quad(corner, along_u, along_v):
    """A rectangle whose front is where u x v points."""
    corner, u, v = (np.asarray(one, float) for one in (corner, along_u, along_v))
    return rs.Mesh([corner, corner + u, corner + u + v, corner + v], [[0, 1, 2], [0, 2, 3]])


def disk(radius, height, sides, up):
    """A regular polygon with the area of a disk, as a fan."""
    radius = radius * math.sqrt(2 * math.pi / (sides * math.sin(2 * math.pi / sides)))
    turn = 2 * np.pi * np.arange(sides) / sides
    ring = np.stack([radius * np.cos(turn), radius * np.sin(turn), np.full(sides, height)], 1)
    ids = np.arange(sides)
    faces = np.stack([np.full(sides, sides), ids, np.roll(ids, -1)], axis=1)
    return rs.Mesh(np.vstack([ring, [[0, 0, height]]]), faces if up else faces[:, ::-1])


def check(found, expected, errors, slack=0.0):
    """Within four standard errors, of 15 degrees of freedom: a chance of 0.999, and fixed seeds."""
    assert abs(found - expected) <= 4 * errors + slack, (found, expected, errors)


@pytest.mark.parametrize("sides", [(1.0, 1.0, 1.0), (2.0, 0.5, 0.7), (1.0, 1.0, 10.0)])
def test_opposed_rectangles(sides):
    a, b, c = sides
    scene = rs.Scene([quad([0, 0, 0], [a, 0, 0], [0, b, 0]), quad([0, 0, c], [0, b, 0], [a, 0, 0])])
    found = rs.view_factors(scene, target_error=2e-4)
    exact = opposed_rectangles(a, b, c)
    for i, j in ((0, 1), (1, 0)):
        assert found.standard_errors[i, j] <= 2e-4
        check(found.factors[i, j], exact, found.standard_errors[i, j])
        check(found.outside[i], 1 - exact, found.outside_errors[i])
    assert found.factors.diagonal().tolist() == [0, 0]
    assert found.areas == pytest.approx([a * b] * 2)
    assert not found.other.any()


@pytest.mark.parametrize("sizes", [(1.0, 1.0, 1.0), (2.0, 1.0, 0.4)])
def test_perpendicular_rectangles(sizes):
    length, width, height = sizes
    floor = quad([0, 0, 0], [length, 0, 0], [0, width, 0])
    wall = quad([0, 0, 0], [0, 0, height], [length, 0, 0])
    found = rs.view_factors(rs.Scene([floor, wall]), target_error=2e-4, seed=3)
    for (i, j), exact in (
        ((0, 1), perpendicular_rectangles(length, width, height)),
        ((1, 0), perpendicular_rectangles(length, height, width)),
    ):
        check(found.factors[i, j], exact, found.standard_errors[i, j])
    if width == height == length:
        assert perpendicular_rectangles(1, 1, 1) == pytest.approx(0.20004, abs=1e-5)
        assert opposed_rectangles(1, 1, 1) == pytest.approx(0.19982, abs=1e-5)


def test_coaxial_disks():
    """Polygons of 256 sides with the disks' areas: the difference is of the order of 1 / 256**2."""
    scene = rs.Scene([disk(1.0, 0.0, 256, up=True), disk(0.5, 0.8, 256, up=False)])
    found = rs.view_factors(scene, target_error=2e-4, seed=1)
    assert found.areas == pytest.approx([math.pi, math.pi / 4], rel=1e-6)
    for (i, j), radii in (((0, 1), (1.0, 0.5)), ((1, 0), (0.5, 1.0))):
        exact = coaxial_disks(*radii, 0.8)
        check(found.factors[i, j], exact, found.standard_errors[i, j], slack=2e-5)


def test_concentric_spheres():
    """Exact for polyhedra: a convex one sees only what is around it, and reciprocity."""
    vertices, faces = icosphere(2)
    inner, outer = rs.Mesh(0.4 * vertices, faces), rs.Mesh(vertices, faces[:, ::-1])
    found = rs.view_factors(rs.Scene([inner, outer]), target_error=3e-4)
    ratio = found.areas[0] / found.areas[1]
    assert ratio == pytest.approx(0.16, rel=1e-5)
    assert found.factors[0].tolist() == [0, 1]
    check(found.factors[1, 0], ratio, found.standard_errors[1, 0])
    check(found.factors[1, 1], 1 - ratio, found.standard_errors[1, 1])
    assert not found.outside.any()
    assert not found.other.any()
    fixed = rs.view_factors(rs.Scene([inner, outer]), reciprocity=True)
    np.testing.assert_allclose(fixed.factors, [[0, 1], [ratio, 1 - ratio]], atol=1e-9)


def test_errors_are_those_of_repeated_runs():
    """Of 40 seeds: the deviations, in standard errors, have a mean square near 1 (15 / 13)."""
    scene = rs.Scene([quad([0, 0, 0], [1, 0, 0], [0, 1, 0]), quad([0, 0, 1], [0, 1, 0], [1, 0, 0])])
    exact = opposed_rectangles(1, 1, 1)
    runs = [rs.view_factors(scene, rays=1 << 12, seed=seed) for seed in range(40)]
    off = np.array([(run.factors[0, 1] - exact) / run.standard_errors[0, 1] for run in runs])
    assert 0.5 < (off**2).mean() < 2.2
    assert abs(off.mean()) < 4 / math.sqrt(40)


def test_errors_fall_faster_than_the_root():
    scene = rs.Scene([quad([0, 0, 0], [1, 0, 0], [0, 1, 0]), quad([0, 0, 1], [0, 1, 0], [1, 0, 0])])
    errors = [
        np.mean([rs.view_factors(scene, rays=rays, seed=s).standard_errors[0, 1] for s in range(5)])
        for rays in (1 << 10, 1 << 16)
    ]
    binomial = math.sqrt(0.2 * 0.8 / (1 << 16))
    assert errors[1] < errors[0] / 12  # the root would be 8
    assert errors[1] < binomial / 2


def room(rng):
    """A closed room of six walls with a tilted box in it, all faces towards the inside."""
    vertices, faces = cube()
    rotation, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    if np.linalg.det(rotation) < 0:
        rotation[0] *= -1
    box = rs.Mesh((vertices - 0.5) * 0.4 @ rotation.T + [1.0, 0.5, 0.4], faces)
    walls = rs.Mesh(vertices * [2.0, 1.0, 1.2], faces[:, ::-1])
    ids = np.concatenate([np.arange(12) // 2, np.full(12, 6)])
    return rs.Scene([walls, box]), ids


def test_a_closed_room_sums_to_one(rng):
    scene, ids = room(rng)
    found = rs.view_factors(scene, ids, rays=1 << 18)
    assert found.factors.shape == (7, 7)
    assert not found.outside.any()
    assert not found.other.any()
    np.testing.assert_allclose(found.factors.sum(axis=1), 1.0, rtol=1e-12)
    assert not found.factors[np.arange(6), np.arange(6)].any()  # walls are flat
    exchange = found.factors * found.areas[:, None]
    errors = found.standard_errors * found.areas[:, None]
    gap = np.abs(exchange - exchange.T) / np.sqrt(errors**2 + errors.T**2)
    assert gap.max() < 5


def test_reciprocity_keeps_the_sums(rng):
    scene, ids = room(rng)
    best = rs.view_factors(scene, ids, rays=1 << 18)
    plain = rs.view_factors(scene, ids, rays=1 << 12, seed=1)
    fixed = rs.view_factors(scene, ids, rays=1 << 12, seed=1, reciprocity=True)
    exchange = fixed.factors * fixed.areas[:, None]
    np.testing.assert_allclose(exchange, exchange.T, atol=1e-12)
    np.testing.assert_allclose(fixed.factors.sum(axis=1), 1.0, atol=1e-12)
    assert (fixed.factors >= 0).all()
    assert not fixed.factors[plain.factors + plain.factors.T == 0].any()
    # Nearer to a run with 64 times the rays than the plain estimates.
    errors = [np.abs(one.factors - best.factors).mean() for one in (plain, fixed)]
    assert errors[1] < 0.9 * errors[0]
    off = (fixed.factors - best.factors)[best.factors > 0]
    scale = np.hypot(fixed.standard_errors, best.standard_errors)[best.factors > 0]
    assert np.abs(off / scale).max() < 5


@settings(max_examples=60)
@given(st.integers(1, 8), st.integers(0, 2**32 - 1))
def test_balanced_shares_are_reciprocal(count, seed):
    """For any noisy estimate of a reciprocal exchange with a way out."""
    rng = np.random.default_rng(seed)
    exchange = rng.random((count, count)) * (rng.random((count, count)) < 0.7)
    exchange = exchange + exchange.T
    sinks = rng.random((count, 2)) * [1.0, 0.3]
    areas = exchange.sum(axis=1) + sinks.sum(axis=1)
    shares = np.hstack([exchange, sinks]) / areas[:, None]
    n = 1000
    noisy = rng.poisson(shares * n) + 0.0
    noisy[:, count] += 1  # a row is not empty
    noisy /= noisy.sum(axis=1, keepdims=True)
    errors = np.maximum(np.sqrt(noisy * (1 - noisy) / n), 1 / n)
    found = balanced(
        Shares(noisy[:, :count], errors[:, :count], noisy[:, count:], errors[:, count:]), areas
    )
    assert (found.factors >= 0).all()
    assert (found.sinks >= 0).all()
    flow = found.factors * areas[:, None]
    np.testing.assert_allclose(flow, flow.T, atol=1e-9 * areas.max())
    total = found.factors.sum(axis=1) + found.sinks.sum(axis=1)
    np.testing.assert_allclose(total, 1.0, atol=1e-6)
    unseen = (noisy[:, :count] == 0) & (noisy[:, :count].T == 0)
    assert not found.factors[unseen].any()


def test_the_better_estimate_weighs_more():
    """Of two estimates of an exchange; ways out, which are not well known, take up the rest."""
    factors, errors = np.array([[0.0, 0.3], [0.4, 0.0]]), np.array([[1e-6, 1e-3], [0.03, 1e-6]])
    sinks, sink_errors = np.array([[0.7, 0.0], [0.6, 0.0]]), np.array([[9.0, 1e-6], [9.0, 1e-6]])
    found = balanced(Shares(factors, errors, sinks, sink_errors), np.array([2.0, 2.0]))
    expected = (0.3 / 1e-6 + 0.4 / 9e-4) / (1 / 1e-6 + 1 / 9e-4)
    np.testing.assert_allclose(found.factors, [[0, expected], [expected, 0]], atol=1e-6)
    np.testing.assert_allclose(found.sinks, [[1 - expected, 0]] * 2, atol=1e-6)
    assert found.errors[0, 1] == pytest.approx(1e-3, rel=1e-3)


def test_sides():
    """A plate between two others: its back neither radiates nor receives, unless two-sided."""
    low = quad([-5, -5, 0], [10, 0, 0], [0, 10, 0])
    plate = quad([-5, -5, 1], [10, 0, 0], [0, 10, 0])  # faces up, too
    high = quad([-5, -5, 2], [0, 10, 0], [10, 0, 0])
    scene = rs.Scene([low, plate, high])
    found = rs.view_factors(scene, target_error=5e-4)
    exact = opposed_rectangles(10, 10, 1)
    check(found.other[0], exact, found.other_errors[0])  # the plate's back
    check(found.factors[1, 2], exact, found.standard_errors[1, 2])
    assert found.factors[0].tolist() == [0, 0, 0]
    assert found.factors[1, 0] == 0
    both = rs.view_factors(scene, two_sided=True, target_error=5e-4)
    assert not both.other.any()
    for i, j, share in ((0, 1, 0.5), (1, 0, 0.5), (1, 2, 0.5), (2, 1, 0.5), (0, 2, 0.0)):
        check(both.factors[i, j], share * exact, both.standard_errors[i, j])


def test_triangles_of_no_patch_block():
    low = quad([0, 0, 0], [1, 0, 0], [0, 1, 0])
    high = quad([0, 0, 1], [0, 1, 0], [1, 0, 0])
    screen = quad([-9, -9, 0.5], [20, 0, 0], [0, 20, 0])
    scene = rs.Scene([low, high, screen])
    found = rs.view_factors(scene, [0, 0, 1, 1, -1, -1])
    assert not found.factors.any()
    assert found.factors.shape == (2, 2)
    assert (found.other > 0.95).all()
    np.testing.assert_allclose(found.other + found.outside, 1.0)


def test_results_depend_on_the_seed_alone(rng):
    scene, ids = room(rng)
    first = rs.view_factors(scene, ids, rays=5000)
    assert first.ray_counts.tolist() == [8192] * 7
    for tracer in (rs.Tracer(scene, "kdtree"), rs.Tracer(scene, "brute")):
        again = rs.view_factors(tracer, ids, rays=5000)
        for one, other in zip(first, again, strict=True):
            np.testing.assert_array_equal(one, other)
    count = rs.thread_count()
    try:
        for threads in (1, 3):
            rs.set_thread_count(threads)
            again = rs.view_factors(scene, ids, rays=5000)
            np.testing.assert_array_equal(first.factors, again.factors)
    finally:
        rs.set_thread_count(count)
    other = rs.view_factors(scene, ids, rays=5000, seed=1)
    assert (first.factors != other.factors).any()


def test_rays_stop_at_the_target():
    scene = rs.Scene([quad([0, 0, 0], [1, 0, 0], [0, 1, 0]), quad([0, 0, 9], [0, 1, 0], [1, 0, 0])])
    loose = rs.view_factors(scene, rays=1024, target_error=1e-2)
    tight = rs.view_factors(scene, rays=1024, target_error=2e-4)
    assert loose.ray_counts.tolist() == [1024, 1024]
    assert (tight.ray_counts > 1024).all()
    assert (tight.standard_errors <= 2e-4).all()
    assert (tight.outside_errors <= 2e-4).all()
    capped = rs.view_factors(scene, rays=1024, target_error=1e-9, max_rays=4096)
    assert capped.ray_counts.tolist() == [4096, 4096]
    assert capped.standard_errors.max() > 1e-9
    seen = []
    rs.view_factors(scene, rays=1024, progress=lambda *step: seen.append(step))
    assert seen == [(1, 2), (2, 2)]


def test_points_are_uniform_and_directions_by_the_cosine():
    """Chi-square of the patch's triangles, of squares of one, and of the direction's height."""
    vertices, faces = soup(40, seed=5)
    scene = rs.Scene.from_arrays(vertices, faces)
    triangles = scene.triangles
    patches = make_patches(np.zeros(40, int), triangles)
    numbers = np.random.default_rng(8).random((200_000, 4), np.float32)
    origins, directions = Emitter(patches, 0, two_sided=False).rays(numbers)
    corners = vertices[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    areas = np.linalg.norm(normals, axis=1) / 2
    normals /= 2 * areas[:, None]
    assert patches.areas == pytest.approx([areas.sum()], rel=1e-6)
    gap = np.abs(np.einsum("nfk,fk->nf", origins[:20_000, None] - corners[:, 0], normals))
    cosines = directions @ normals.T
    # The triangle on whose plane a ray starts: random ones are nowhere near another's.
    own = gap.argmin(axis=1)
    counts = np.bincount(own, minlength=40)
    expected = areas / areas.sum() * 20_000
    assert ((counts - expected) ** 2 / expected).sum() < 80  # 39 degrees of freedom: 1e-4
    height = cosines[np.arange(20_000), own]
    assert (height[np.sort(gap, axis=1)[:, 1] > 1e-4] > 0).all()  # no other plane is near
    bins = np.bincount((height**2 * 16).astype(int).clip(0, 15), minlength=16)  # uniform
    assert ((bins - 1250.0) ** 2 / 1250.0).sum() < 45
    np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1.0, rtol=1e-12)


@pytest.mark.parametrize(("scale", "offset"), [(1.0, 0.0), (3.0, 20.0), (1e-4, 0.0), (1.0, 1e7)])
def test_no_ray_leaves_through_an_edge(scale, offset, rng):
    """From points at the edges and corners of the triangles of a rotated, closed box."""
    vertices, faces = cube()
    rotation, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    faces = faces[:, ::-1] if np.linalg.det(rotation) > 0 else faces  # inward
    scene = rs.Scene.from_arrays((vertices @ rotation.T) * [1.0, 0.4, 0.7] * scale + offset, faces)
    emitter = Emitter(make_patches(np.zeros(12, int), scene.triangles), 0, two_sided=False)
    numbers = rng.random((200_000, 4), np.float32)
    numbers[:100_000, 1] = np.where(numbers[:100_000, 1] < 0.5, 0.0, 1.0 - 2.0**-24)
    numbers[50_000:150_000, 0] = np.floor(numbers[50_000:150_000, 0] * 12) / 12
    hits = rs.Tracer(scene).first_hit(*emitter.rays(numbers))
    assert hits.is_hit.all()


@pytest.mark.parametrize(
    ("patches", "options", "error", "named"),
    [
        ([0, 0, 0], {}, ValueError, r"patches: expected one for each triangle, shape \(4,\)"),
        ([0.0, 0, 0, 0], {}, TypeError, "patches: expected integers"),
        ([0, 0, 2, 2], {}, ValueError, "patch 1 has no triangle"),
        ([0, 0, -2, 1], {}, ValueError, "patches: expected -1 to 3, got -2"),
        ([0, 0, 9, 1], {}, ValueError, "patches: expected -1 to 3, got 9"),
        (None, {"rays": 3}, ValueError, "rays: expected 16 to"),
        (None, {"rays": 1.5}, TypeError, "integer"),
        (None, {"max_rays": 2**40}, ValueError, "max_rays: expected"),
        (None, {"target_error": 0.0}, ValueError, "target_error"),
        (None, {"target_error": math.nan}, ValueError, "target_error"),
        (None, {"seed": -1}, ValueError, "seed"),
    ],
)
def test_bad_input_is_named(patches, options, error, named):
    scene = rs.Scene([quad([0, 0, 0], [1, 0, 0], [0, 1, 0]), quad([0, 0, 9], [0, 1, 0], [1, 0, 0])])
    with pytest.raises(error, match=named):
        rs.view_factors(scene, patches, **options)


def test_other_bad_input():
    with pytest.raises(TypeError, match="scene: expected a Scene or Tracer"):
        rs.view_factors("cornell")
    flat = rs.Scene.from_arrays([[0, 0, 0], [1, 0, 0], [2, 0, 0]], [[0, 1, 2]])
    with pytest.raises(ValueError, match="patch 0 has no triangle with an area"):
        rs.view_factors(flat)
    nothing = rs.Scene.from_arrays(np.zeros((0, 3)), np.zeros((0, 3), int))
    assert rs.view_factors(nothing, []).factors.shape == (0, 0)


def test_too_many_patches_are_refused_with_numbers():
    count = 300_000
    vertices = np.zeros((3, 3))
    vertices[1, 0] = vertices[2, 1] = 1.0
    scene = rs.Scene.from_arrays(vertices, np.tile([0, 1, 2], (count, 1)))
    tracer = rs.Tracer(scene, "brute")
    with pytest.raises(MemoryError, match=r"300,000 x 300,000 factors would take 1440\.0 GB"):
        rs.view_factors(tracer, np.arange(count))

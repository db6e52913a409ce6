"""View factors of spheres and instances: closed forms, and properties in enclosures."""

from __future__ import annotations

import math

import numpy as np
import pytest

import raystream as rs
from meshes import cube

SQUARE = rs.Mesh([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], [[0, 1, 2], [0, 2, 3]])


def box(size=2.0):
    """A cube around the origin that faces inward, and the wall of each of its triangles."""
    vertices, faces = cube()
    vertices = (vertices - (vertices.max(0) + vertices.min(0)) / 2) / np.ptp(vertices) * size
    corners = vertices[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    if np.einsum("nk,nk->n", normals, corners.mean(axis=1)).sum() > 0:
        faces, normals = faces[:, ::-1], -normals
    axis = np.abs(normals).argmax(axis=1)
    walls = 2 * axis + (normals[np.arange(len(faces)), axis] > 0)
    return rs.Mesh(vertices, faces), walls


def between_spheres(r1, r2, s):
    """From a sphere to one at distance `s` of the centres.

    Lines that meet both, by direction: those through the overlap of two circles, the spheres'
    shadows.
    """
    theta = (np.arange(400_000) + 0.5) * (math.pi / 2 / 400_000)
    d = s * np.sin(theta)
    small, is_within = min(r1, r2), d <= abs(r1 - r2)
    with np.errstate(invalid="ignore", divide="ignore"):
        a = np.arccos((d * d + r1 * r1 - r2 * r2) / (2 * d * r1))
        b = np.arccos((d * d + r2 * r2 - r1 * r1) / (2 * d * r2))
    overlap = r1 * r1 * (a - np.sin(2 * a) / 2) + r2 * r2 * (b - np.sin(2 * b) / 2)
    overlap = np.where(is_within, math.pi * small**2, np.where(d < r1 + r2, overlap, 0.0))
    lines = (overlap * 2 * math.pi * np.sin(theta)).sum() * (math.pi / 2 / 400_000)
    return lines / (math.pi * 4 * math.pi * r1 * r1)


def check(found, row, column, expected):
    error = found.standard_errors[row, column]
    assert abs(found.factors[row, column] - expected) <= 4 * error, (found, expected)


@pytest.mark.parametrize(("r1", "r2", "s"), [(1.0, 1.0, 2.5), (0.3, 2.0, 3.0), (1.0, 1.0, 20.0)])
@pytest.mark.parametrize("shift", [0.0, 1e5])
def test_two_spheres(r1, r2, s, shift):
    way = np.array([2.0, -1.0, 2.0]) / 3.0
    scene = rs.Scene.spheres([shift * way, (shift + s) * way], [r1, r2])
    found = rs.view_factors(scene, [0, 1], rays=1 << 15)
    check(found, 0, 1, between_spheres(r1, r2, s))
    check(found, 1, 0, between_spheres(r2, r1, s))
    assert found.factors[0, 0] == found.factors[1, 1] == 0.0
    np.testing.assert_array_equal(found.other, 0.0)
    assert found.areas == pytest.approx([4 * math.pi * r1**2, 4 * math.pi * r2**2])
    # Together they are one mesh, and so one patch.
    both = rs.view_factors(scene, rays=1 << 15)
    own = (found.areas * (found.factors.sum(axis=1))).sum() / found.areas.sum()
    check(both, 0, 0, own)


def test_the_far_form_is_that_of_a_point():
    assert between_spheres(1e-4, 1.0, 2.0) == pytest.approx(0.5 * (1 - math.sqrt(0.75)), rel=1e-4)


def test_a_sphere_in_a_box():
    walls, ids = box()
    scene = rs.Scene.combine([rs.Scene([walls]), rs.Scene.spheres([[0.3, -0.2, 0.1]], 0.5)])
    found = rs.view_factors(scene, [*ids, 6], rays=1 << 15)
    np.testing.assert_array_equal(found.outside, 0.0)
    np.testing.assert_array_equal(found.other, 0.0)
    np.testing.assert_allclose(found.factors.sum(axis=1), 1.0, rtol=1e-14)
    # A sphere lights walls as a point in its centre: a wall's share is its solid angle's.
    center = np.array([0.3, -0.2, 0.1])
    for wall in range(6):
        axis, distance = wall // 2, 1.0 + center[wall // 2] * (1 if wall % 2 else -1)
        others = [k for k in range(3) if k != axis]
        total = 0.0
        for x in (1 - center[others[0]], 1 + center[others[0]]):
            for y in (1 - center[others[1]], 1 + center[others[1]]):
                total += math.atan(x * y / (distance * math.sqrt(x * x + y * y + distance**2)))
        check(found, 6, wall, total / (4 * math.pi))
        check(found, wall, 6, total / (4 * math.pi) * math.pi / 4.0)
    even = rs.view_factors(scene, [*ids, 6], rays=1 << 12, reciprocity=True)
    exchange = even.areas[:, None] * even.factors
    np.testing.assert_allclose(exchange, exchange.T, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(even.factors.sum(axis=1), 1.0, rtol=1e-9)


def test_both_sides_of_spheres_within_each_other():
    scene = rs.Scene.spheres([[0, 0, 0], [0, 0, 0]], [1.0, 2.0])
    found = rs.view_factors(scene, [0, 1], rays=1 << 15, two_sided=True)
    for row, column, expected in ((0, 0, 0.5), (0, 1, 0.5), (1, 0, 0.125), (1, 1, 0.375)):
        check(found, row, column, expected)
    assert abs(found.outside[1] - 0.5) <= 4 * found.outside_errors[1]
    # On the front alone, the inner one sees the back of the outer one.
    front = rs.view_factors(scene, [0, 1], rays=64)
    assert front.other.tolist() == [1.0, 0.0]
    assert front.outside.tolist() == [0.0, 1.0]


def turned(angle, axis=2):
    """A rotation about an axis."""
    cosine, sine = math.cos(angle), math.sin(angle)
    matrix, (i, j) = np.eye(3), [k for k in range(3) if k != axis]
    matrix[i, i] = matrix[j, j] = cosine
    matrix[i, j], matrix[j, i] = -sine, sine
    return matrix


@pytest.mark.parametrize("shift", [0.0, 1e4])
def test_walls_that_are_instances_close_a_box(shift):
    """No ray leaves, also where walls are stretched, far away or mirrored."""
    turn = turned(0.4) @ turned(1.1, 0)
    transforms = []
    for axis in range(3):
        for side in (0, 1):  # the opposite wall is mirrored: its front stays in front
            linear = np.roll(np.eye(3), -axis - 1, axis=1) * [1.0, 1.0, 1.0 - 2.0 * side]
            transforms.append(np.column_stack([linear, side * np.eye(3)[axis]]))
    transforms = np.array(transforms)
    stretch = turn * np.array([1.0, 2.0, 0.5])
    transforms = np.einsum("ij,kjl->kil", stretch, transforms)
    transforms[:, :, 3] += shift
    scene = rs.Scene.instances([rs.Scene([SQUARE])], transforms)
    found = rs.view_factors(scene, rays=1 << 13)
    np.testing.assert_array_equal(found.outside, 0.0)
    np.testing.assert_array_equal(found.other, 0.0)
    assert found.areas == pytest.approx([1.0, 1.0, 0.5, 0.5, 2.0, 2.0], rel=1e-6)
    exchange = found.areas[:, None] * found.factors
    errors = found.areas[:, None] * found.standard_errors
    assert (np.abs(exchange - exchange.T) <= 4 * (errors + errors.T)).all()
    flat = rs.view_factors(scene.flattened(), np.repeat(np.arange(6), 2), rays=1 << 13)
    both = found.standard_errors + flat.standard_errors
    assert (np.abs(found.factors - flat.factors) <= 4 * both).all()


def test_patches_of_instances_are_of_their_triangles():
    above = np.column_stack([np.diag([1.0, 1.0, -1.0]), [0.0, 0.0, 1.0]])  # mirrored: faces down
    scene = rs.Scene.instances([rs.Scene([SQUARE])], [np.eye(3, 4), above])
    found = rs.view_factors(scene, rays=1 << 15)
    check(found, 0, 1, 0.199824896)
    check(found, 1, 0, 0.199824896)
    halves = rs.view_factors(scene, [0, 1, 2, -1], rays=1 << 14)
    assert halves.areas == pytest.approx([0.5, 0.5, 0.5])
    assert abs(halves.factors[0, 2] + halves.other[0] - 0.2) < 0.01
    with pytest.raises(ValueError, match=r"one for each triangle, shape \(4,\)"):
        rs.view_factors(scene, [0, 1])


def test_cut_outs_of_instances_and_spheres():
    holes = rs.Material(opacity=0.25)
    ghost = rs.Scene.spheres([[0.5, 0.5, 0.5]], 0.2, materials=[holes])
    above = np.column_stack([np.diag([1.0, 1.0, -1.0]), [0.0, 0.0, 1.0]])
    flat = rs.Scene.instances([rs.Scene([SQUARE])], [np.eye(3, 4), above]).flattened()
    found = rs.view_factors(rs.Scene.combine([flat, ghost]), [0, 0, 1, 1, -1], rays=1 << 14)
    check(found, 0, 1, 0.199824896)
    solid = rs.view_factors(
        rs.Scene.combine([flat, ghost]), [0, 0, 1, 1, 2], rays=1 << 14, cutouts=False
    )
    assert solid.factors[0, 2] > 0.05


def at(center, linear):
    """A transform that moves the sphere of `BALL` to a centre."""
    return np.column_stack([linear, np.asarray(center) - linear @ [1.0, 2.0, 3.0]])


BALL = rs.Scene.spheres([[1.0, 2.0, 3.0]], 0.5)


@pytest.mark.parametrize("shift", [0.0, 1e5])
def test_two_instances_of_a_sphere(shift):
    way = np.array([2.0, -1.0, 2.0]) / 3.0
    places = [at(shift * way, 2.0 * turned(0.3)), at((shift + 3.0) * way, -4.0 * turned(1.0, 0))]
    found = rs.view_factors(rs.Scene.instances(BALL, places), rays=1 << 15)
    check(found, 0, 1, between_spheres(1.0, 2.0, 3.0))
    check(found, 1, 0, between_spheres(2.0, 1.0, 3.0))
    assert found.factors[0, 0] == found.factors[1, 1] == 0.0
    np.testing.assert_array_equal(found.other, 0.0)
    assert found.areas == pytest.approx([4 * math.pi, 16 * math.pi], rel=1e-12)


def area_of_ellipsoid(a, b, c):
    """The area, from that of the unit sphere's parts as they are stretched."""
    z = np.polynomial.legendre.leggauss(200)
    turn = 2 * math.pi * (np.arange(400) + 0.5) / 400
    sine = np.sqrt(1.0 - z[0] ** 2)[:, None]
    x, y = sine * np.cos(turn), sine * np.sin(turn)
    stretch = np.sqrt((b * c * x) ** 2 + (a * c * y) ** 2 + (a * b * z[0][:, None]) ** 2)
    return float((stretch.mean(axis=1) * z[1]).sum() * 2 * math.pi)


@pytest.mark.parametrize("axes", [(0.8, 0.4, 0.2), (0.9, 0.9, 0.05), (0.05, 0.1, 0.95)])
def test_ellipsoids_in_a_box(axes):
    walls, ids = box()
    linear = turned(0.4) @ turned(0.9, 0) @ (np.diag(axes) * [2.0, -2.0, 2.0])
    inner = rs.Scene.instances(BALL, [at([0.0, 0.0, 0.0], linear)])
    scene = rs.Scene.combine([rs.Scene([walls]), inner])
    is_first = scene.placements.object_ids[0] == 0
    patches = [*ids, 6] if is_first else [6, *ids]
    found = rs.view_factors(scene, patches, rays=1 << 15)
    np.testing.assert_array_equal(found.outside, 0.0)
    np.testing.assert_array_equal(found.other, 0.0)
    area = area_of_ellipsoid(*axes)
    assert found.areas[6] == pytest.approx(area, rel=0.015)
    assert found.factors[6, 6] == 0.0
    # A convex body's exchange is the same from both sides.
    exchange = np.append(found.areas[:6], area)[:, None] * found.factors
    errors = np.append(found.areas[:6], area)[:, None] * found.standard_errors
    assert (np.abs(exchange - exchange.T) <= 4 * (errors + errors.T)).all()
    # On both sides: what leaves inside arrives there.
    both = rs.view_factors(scene, patches, rays=1 << 12, two_sided=True)
    assert abs(both.factors[6, 6] - 0.5) <= 4 * both.standard_errors[6, 6]


def test_instances_of_fields_have_the_factors_of_their_meshes():
    heights = np.random.default_rng(5).uniform(0.0, 3.0, (4, 5))
    heights[1, 1] = np.nan
    ball = rs.Scene.spheres([[2.0, 1.0, 4.0], [0.0, 1.0, 5.0]], 0.5)
    both = rs.Scene.combine([rs.Scene([SQUARE]), rs.Scene.height_field(heights), ball])
    linear = 2.0 * turned(0.5) @ turned(0.3, 1)
    places = [at([0, 0, 0], linear), at([9, 0, 0], linear * [1.0, -1.0, 1.0])]
    scene = rs.Scene.instances(both, places)
    count = 2 + 24 + 2
    own = np.r_[0, 0, 1 + np.arange(24) // 2, 13, 14]
    own[[2, 3, 4, 5, 10, 11, 12, 13]] = -1  # around the missing sample
    patches = np.concatenate([own, np.where(own < 0, -1, own + 15)])
    known = np.unique(patches[patches >= 0])
    patches = np.where(patches < 0, -1, np.searchsorted(known, patches))
    found = rs.view_factors(scene, patches, rays=1 << 12)
    # The flattened scene has meshes, then spheres.
    flat = np.concatenate([patches[:26], patches[count : count + 26], patches[26:28]])
    flat = np.concatenate([flat, patches[count + 26 :]])
    wanted = rs.view_factors(scene.flattened(), flat, rays=1 << 12)
    np.testing.assert_allclose(found.areas, wanted.areas, rtol=1e-5)
    errors = found.standard_errors + wanted.standard_errors
    assert (np.abs(found.factors - wanted.factors) <= 4 * errors).all()
    assert found.factors.max() > 0.05
    with pytest.raises(ValueError, match=r"shape \(56,\)"):
        rs.view_factors(scene, patches[:-1])


@pytest.mark.parametrize("size", [1e-4, 1.0, 1e5])
def test_instances_in_float64_are_left_as_near_as_float64_rounds(size):
    """Rays start between plates with a gap of a millionth of their size."""
    plate = rs.Scene.from_arrays(size * SQUARE.vertices.astype(float), SQUARE.faces)
    above = np.column_stack([np.diag([1.0, 1.0, -1.0]), [0.0, 0.0, 1e-6 * size]])
    scene = rs.Scene.instances(plate, [np.eye(3, 4), above])
    tracer = rs.Tracer(scene, precision="float64")
    found = rs.view_factors(tracer, rays=1 << 12)
    assert found.factors[0, 1] > 0.999
    assert found.factors[1, 0] > 0.999
    points = rs.surface_points(tracer, [0, 1], instance_ids=[0, 0])
    eyes = [[0.5 * size, 0.5 * size, size * height] for height in (0.5e-6, 1.0, -1.0)]
    seen = rs.visibility(tracer, points, eyes)
    assert seen.tolist() == [[True, False, True]] * 2
    beyond = rs.surface_points(tracer, [0, 1], instance_ids=[1, 1])
    assert rs.visibility(tracer, points, beyond).all()
    again = rs.Tracer(scene.flattened(), precision="float64")
    assert rs.visibility(again, rs.surface_points(again, [0, 1]), eyes).tolist() == seen.tolist()

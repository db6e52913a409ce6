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

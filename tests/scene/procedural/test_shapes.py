"""Shapes: closed, outside out, of the counts and sizes that they state."""

from __future__ import annotations

import numpy as np
import pytest

from raystream.scene.procedural import shapes
from raystream.scene.procedural.parts import instance
from scene.procedural.closed import euler_characteristic, front_agreement, open_edges, volume

CLOSED = {
    "boxes": (shapes.boxes([[-1, -1, -1]], [[1, 1, 1]]), 12, 8.0),
    "box": (shapes.box(), 12, 8.0),
    "divided box": (shapes.box((2, 3, 5)), 4 * (6 + 15 + 10), 8.0),
    "sphere 2": (shapes.sphere(2), 48, None),
    "sphere 40": (shapes.sphere(40), 12 * 1600, 4 / 3 * np.pi),
    "rounded 1": (shapes.rounded_box(1, (1.0, 2.0, 3.0), 0.5), 12, None),
    "rounded 2": (shapes.rounded_box(2, (1.0, 2.0, 3.0), 0.5), 48, None),
    "rounded 7": (shapes.rounded_box(7, (1.0, 2.0, 3.0), 0.5), 12 * 49, None),
    # A box of 1 x 3 x 5, with slabs on its sides, quarter rods on its edges, a ball's eighths.
    "rounded 60": (
        shapes.rounded_box(60, (1.0, 2.0, 3.0), 0.5),
        12 * 3600,
        15 + 23 + np.pi * 0.25 * 9 + np.pi / 6,
    ),
    "spindle": (shapes.lathe([1.0], [0.0, 0.5, 2.0], 3), 6, 3**1.5 / 4 * 2 / 3),
    "vase": (shapes.lathe([0.5, 1.0, 0.3], [0.0, 0.1, 0.6, 1.2, 1.3], 9), 54, None),
    "can": (shapes.lathe([1.0, 1.0], [0.0, 0.0, 1.0, 1.0], 300, smooth=False), 1200, np.pi),
}


@pytest.mark.parametrize("name", CLOSED)
def test_closed_shapes_are_closed_with_fronts_outside(name):
    part, triangles, expected = CLOSED[name]
    assert part.triangle_count == triangles
    assert open_edges(part.faces) == 0
    assert euler_characteristic(part.faces) == 2
    assert volume(part.vertices, part.faces) > 0.0
    if expected is not None:
        assert volume(part.vertices, part.faces) == pytest.approx(expected, rel=5e-3)


def test_closed_is_noticed_when_it_is_not():
    part = shapes.box()
    assert open_edges(part.faces[1:]) == 3
    assert euler_characteristic(part.faces[2:]) == 1
    assert volume(part.vertices, part.flipped().faces) == pytest.approx(-8.0)


def test_boxes_have_their_corners():
    lows, highs = np.array([[0, 1, 2], [-3, -3, -3]]), np.array([[1, 3, 5], [-2, -1, 0]])
    part = shapes.boxes(lows, highs, [4, 7])
    for index in range(2):
        own = part.vertices[8 * index : 8 * index + 8]
        np.testing.assert_array_equal(own.min(axis=0), lows[index])
        np.testing.assert_array_equal(own.max(axis=0), highs[index])
    np.testing.assert_array_equal(part.material_ids, np.repeat([4, 7], 12))


def test_boxes_without_volume_are_refused():
    with pytest.raises(ValueError, match="low must be less than high"):
        shapes.boxes([[0, 0, 0]], [[1, 0, 1]])


def test_sphere_is_round_and_even():
    part = shapes.sphere(12)
    np.testing.assert_allclose(np.linalg.norm(part.vertices, axis=1), 1.0, atol=1e-6)
    assert front_agreement(part.vertices, part.faces, part.normals) > 0.97
    corners = part.vertices[part.faces]
    areas = np.linalg.norm(
        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
    )
    assert areas.max() < 2.0 * areas.min()


def test_rounded_box_fills_its_size_and_has_normals_outward():
    part = shapes.rounded_box(9, (1.0, 2.0, 3.0), 0.25)
    np.testing.assert_allclose(part.vertices.max(axis=0), [1.0, 2.0, 3.0], atol=1e-6)
    np.testing.assert_allclose(part.vertices.min(axis=0), [-1.0, -2.0, -3.0], atol=1e-6)
    assert front_agreement(part.vertices, part.faces, part.normals) > 0.85
    inner = np.clip(part.vertices, [-0.75, -1.75, -2.75], [0.75, 1.75, 2.75])
    np.testing.assert_allclose(np.linalg.norm(part.vertices - inner, axis=1), 0.25, atol=1e-6)


@pytest.mark.parametrize("radius", [0.0, -1.0, 1.0, 2.0])
def test_rounded_box_refuses_radii_that_do_not_fit(radius):
    with pytest.raises(ValueError, match="radius"):
        shapes.rounded_box(4, (1.0, 2.0, 3.0), radius)


def test_lathe_normals_point_outward():
    angle = np.linspace(0.0, np.pi, 22)
    part = shapes.lathe(np.sin(angle[1:-1]), -np.cos(angle), 40)
    np.testing.assert_allclose(part.normals, part.vertices, atol=0.02)
    assert shapes.lathe([1.0, 1.0], [0.0, 0.0, 1.0, 1.0], 8, smooth=False).normals is None


def test_grid_is_a_height_field_with_fronts_up():
    x, z = np.linspace(-1, 1, 21), np.linspace(0, 3, 31)
    part = shapes.grid(x, z, 0.5 * x[None, :] - 0.25 * z[:, None])
    assert part.triangle_count == 2 * 20 * 30
    y = 0.5 * part.vertices[:, 0] - 0.25 * part.vertices[:, 2]
    np.testing.assert_allclose(part.vertices[:, 1], y, atol=1e-6)
    plane = np.array([-0.5, 1.0, 0.25]) / np.linalg.norm([-0.5, 1.0, 0.25])
    np.testing.assert_allclose(part.normals, np.tile(plane, (21 * 31, 1)), atol=1e-5)
    assert front_agreement(part.vertices, part.faces, part.normals) > 0.999


def test_patch_divides_evenly_and_keeps_its_front():
    part = shapes.patch([(0, 0, 0), (4, 0, 0), (4, 2, 0), (0, 2, 0)], (4, 2))
    assert part.triangle_count == 16
    corners = part.vertices[part.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    np.testing.assert_allclose(normals, np.tile([0.0, 0.0, 1.0], (16, 1)), atol=1e-6)


def test_vertex_normals_of_a_sphere_are_its_points():
    part = instance(shapes.sphere(16), [np.eye(3)], [(0.0, 0.0, 0.0)])
    normals = shapes.vertex_normals(part.vertices, part.faces)
    np.testing.assert_allclose(normals, part.vertices, atol=0.03)

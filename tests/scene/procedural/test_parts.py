"""Parts: merging and instancing keep every part whole."""

from __future__ import annotations

import numpy as np
import pytest

from raystream.scene.procedural.layout import floor_cells
from raystream.scene.procedural.parts import Part, instance, merge, to_mesh, yaw
from raystream.scene.procedural.shapes import box, sphere
from scene.procedural.closed import front_agreement, open_edges, volume


def test_instances_are_copies_in_their_places():
    matrices = yaw([0.0, np.pi / 2, 0.3], [1.0, 2.0, 3.0])
    offsets = np.array([[0.0, 0.0, 0.0], [5.0, 1.0, 0.0], [0.0, -9.0, 20.0]])
    part = instance(sphere(3), matrices, offsets, material_ids=[4, 5, 6])
    count, vertex_count = sphere(3).triangle_count, len(sphere(3).vertices)
    assert part.triangle_count == 3 * count
    assert open_edges(part.faces) == 0
    np.testing.assert_array_equal(part.material_ids, np.repeat([4, 5, 6], count))
    for index, radius in enumerate([1.0, 2.0, 3.0]):
        own = slice(vertex_count * index, vertex_count * (index + 1))
        expected = sphere(3).vertices @ matrices[index].T + offsets[index]
        np.testing.assert_allclose(part.vertices[own], expected, atol=1e-5)
        np.testing.assert_allclose(
            part.normals[own], (part.vertices[own] - offsets[index]) / radius, atol=1e-5
        )


def test_normals_of_stretched_instances_stay_perpendicular():
    stretch = np.diag([4.0, 1.0, 0.5])
    part = instance(sphere(24), [stretch], [(0.0, 0.0, 0.0)])
    np.testing.assert_allclose(np.linalg.norm(part.normals, axis=1), 1.0, atol=1e-5)
    assert front_agreement(part.vertices, part.faces, part.normals) > 0.9
    gradient = part.vertices / np.array([16.0, 1.0, 0.25])
    gradient /= np.linalg.norm(gradient, axis=1)[:, None]
    np.testing.assert_allclose(part.normals, gradient, atol=1e-4)


def test_colors_of_instances_multiply():
    red = Part(box().vertices, box().faces, box().material_ids, None, np.full((8, 3), 0.5))
    colors = [[1.0, 0.2, 0.0], [0.4, 0.4, 1.0]]
    part = instance(red, [np.eye(3)] * 2, np.zeros((2, 3)), colors=colors)
    np.testing.assert_allclose(part.colors, np.repeat(colors, 8, axis=0) * 0.5, rtol=1e-6)


def test_yaw_turns_counter_clockwise_seen_from_above():
    matrix = yaw([np.pi / 2])[0]
    np.testing.assert_allclose(matrix @ [1.0, 0.0, 0.0], [0.0, 0.0, -1.0], atol=1e-7)
    np.testing.assert_allclose(yaw([0.0], [[2.0, 3.0, 4.0]])[0], np.diag([2.0, 3.0, 4.0]))


def test_merged_parts_keep_their_triangles_and_whiten_the_uncolored():
    far = instance(box(), [np.eye(3)], [(9.0, 0.0, 0.0)], colors=[(0.1, 0.2, 0.3)])
    part = merge([box().painted(3), far])
    assert part.triangle_count == 24
    assert open_edges(part.faces) == 0
    assert volume(part.vertices, part.faces) == pytest.approx(16.0)
    np.testing.assert_allclose(part.colors[:8], 1.0)
    np.testing.assert_allclose(part.colors[8:], np.tile([0.1, 0.2, 0.3], (8, 1)), rtol=1e-6)
    np.testing.assert_array_equal(part.material_ids, np.repeat([3, 0], 12))


def test_smooth_and_flat_parts_do_not_merge():
    with pytest.raises(ValueError, match="smooth and flat"):
        merge([box(), sphere(2)])


def test_merging_nothing_gives_an_empty_mesh():
    mesh = to_mesh(merge([]), "nothing")
    assert mesh.triangle_count == 0


@pytest.mark.parametrize("count", [1, 2, 7, 50, 1001])
def test_spots_do_not_overlap_and_stay_on_the_floor(count):
    low, high = (-3.0, 1.0), (5.0, 4.0)
    spots, spacing = floor_cells(count, low, high, np.random.default_rng(1), jitter=0.2)
    assert spots.shape == (count, 2)
    radius = 0.3 * spacing
    assert (spots - radius >= np.asarray(low) - 1e-9).all()
    assert (spots + radius <= np.asarray(high) + 1e-9).all()
    if count > 1:
        distance = np.linalg.norm(spots[:, None] - spots[None], axis=2) + 1e9 * np.eye(count)
        assert distance.min() >= 2 * radius - 1e-9
    assert spacing**2 * count > 0.4 * 24.0 or count < 50

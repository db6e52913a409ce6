"""Detection of closed meshes, and of those that face inward."""

from __future__ import annotations

import numpy as np
import pytest

import raystream as rs
from meshes import cube, dented_sphere, grid_floor, icosphere, soup
from raystream.kernels.solids import solids_of
from solid_meshes import box_mesh, joined


def facts(*meshes):
    found = solids_of(rs.Scene(meshes).triangles)
    return list(zip(found.is_closed.tolist(), found.is_flipped.tolist(), strict=True))


@pytest.mark.parametrize("make", [cube, lambda: icosphere(3), lambda: dented_sphere(2)])
def test_closed_meshes(make):
    vertices, faces = make()
    assert facts(rs.Mesh(vertices, faces)) == [(True, False)]
    assert facts(rs.Mesh(vertices, faces[:, ::-1])) == [(True, True)]
    assert facts(rs.Mesh(vertices + 1e6, faces)) == [(True, False)]
    # As in STL files: each triangle has its own vertices.
    loose = rs.Mesh(vertices[faces].reshape(-1, 3), np.arange(faces.size).reshape(-1, 3))
    assert facts(loose) == [(True, False)]


def test_open_meshes():
    vertices, faces = icosphere(2)
    turned = faces.copy()
    turned[7] = turned[7, ::-1]
    meshes = [
        rs.Mesh(vertices, faces[1:]),
        rs.Mesh(vertices, faces[1:, ::-1]),  # its sum of volumes is negative, and says nothing
        rs.Mesh(vertices, turned),
        rs.Mesh(*grid_floor(3)),
        rs.Mesh(*soup(30)),
        rs.Mesh(vertices, np.zeros((0, 3), int)),
    ]
    assert facts(*meshes) == [(False, False)] * 6


def test_meshes_are_looked_at_one_by_one():
    empty = rs.Mesh(np.zeros((0, 3)), np.zeros((0, 3), int))
    box = box_mesh([0, 0, 0], [1, 1, 1])
    lid_less = rs.Mesh(box.vertices, box.faces[1:])
    inward = box_mesh([0, 0, 0], [1, 1, 1], flipped=True)
    assert facts(empty, box, empty, lid_less, inward, empty) == [
        (False, False), (True, False), (False, False), (False, False), (True, True), (False, False),
    ]  # fmt: skip


def test_what_closes_a_mesh_must_be_hit():
    """A sliver without area cannot be hit: the mesh is open along a line there."""
    vertices, faces = cube()
    doubled = np.vstack([faces, [[0, 0, 1]]])  # its edges cancel each other
    assert facts(rs.Mesh(vertices, doubled)) == [(True, False)]
    bad = vertices.copy()
    bad[3] = np.nan
    assert facts(rs.Mesh(bad, faces)) == [(False, False)]


def test_a_cavity_does_not_turn_a_mesh_over():
    shell = joined(box_mesh([0, 0, 0], [3, 3, 3]), box_mesh([1, 1, 1], [2, 2, 2], flipped=True))
    assert facts(shell) == [(True, False)]


def test_negative_zero_is_zero():
    vertices, faces = cube()
    corners = vertices[faces]
    corners[::2][corners[::2] == 0.0] = -0.0
    assert facts(rs.Mesh(corners.reshape(-1, 3), np.arange(36).reshape(-1, 3))) == [(True, False)]

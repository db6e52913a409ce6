"""Detection of closed meshes, and of those that face inward."""

from __future__ import annotations

import numpy as np
import pytest

import raystream as rs
from meshes import cube, dented_sphere, grid_floor, icosphere, soup
from raystream.kernels.solids import open_edges, solids_of
from slivers import FORMS, split_box
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


@pytest.mark.parametrize("form", FORMS)
def test_triangles_without_area_may_close_a_mesh(form):
    vertices, faces = FORMS[form]()
    solids = solids_of(rs.Scene([rs.Mesh(vertices, faces)]).triangles)
    assert solids.is_closed.tolist() == [True]
    assert solids.is_closed_together
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    if form != "sphere":
        assert solids.volumes.tolist() == pytest.approx([np.prod(high - low)], rel=1e-6)
        assert solids.has_slivers.tolist() == [True]
    assert facts(rs.Mesh(vertices, faces[:, ::-1])) == [(True, True)]
    # Without the last of them, or another triangle, the mesh is open.
    assert facts(rs.Mesh(vertices, faces[:-1])) == [(False, False)]
    assert facts(rs.Mesh(vertices, faces[1:])) == [(False, False)]


def test_triangles_without_area_do_not_open_a_mesh():
    vertices, faces = cube()
    middle = np.vstack([vertices, (vertices[0] + vertices[1]) / 2])
    dangling = rs.Mesh(middle, np.vstack([faces, [[0, 8, 1]]]))
    closed = rs.Mesh(*split_box())
    solids = solids_of(rs.Scene([dangling, closed, rs.Mesh(middle, [[0, 8, 1]])]).triangles)
    assert solids.is_closed.tolist() == [True, True, False]
    assert solids.has_slivers.tolist() == [False, True, False]
    assert solids.is_empty.tolist() == [False, False, True]


def test_open_edges():
    vertices, faces = cube()
    box, far = rs.Mesh(vertices, faces), rs.Mesh(vertices + [7, 0, 0], faces[:-2])
    found = open_edges(rs.Scene([box, far, rs.Mesh(*split_box())]).triangles)
    assert found.mesh_ids.tolist() == [1]
    quad = {tuple(point) for point in far.vertices[faces[-2:].ravel()].tolist()}
    assert {tuple(end) for end in found.ends.reshape(-1, 3).tolist()} == quad
    assert len(found.ends) == 4
    whole = open_edges(rs.Scene([box]).triangles)
    assert len(whole.ends) == len(whole.mesh_ids) == 0

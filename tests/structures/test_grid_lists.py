"""The cells that list a triangle, compared with another computation in float64."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import raystream as rs
from meshes import soup
from strategies import meshes

quiet = settings(max_examples=150)


def grid(vertices, faces, **options):
    return rs.Tracer(rs.Scene.from_arrays(vertices, faces), "grid", **options).structure


def listed(lists, counts):
    """Pairs (cell, prim_id) as a set of rows (i, j, k, prim_id)."""
    cells = np.repeat(np.arange(len(lists.splits) - 1), np.diff(lists.splits))
    i, rest = cells % counts[0], cells // counts[0]
    rows = np.column_stack([i, rest % counts[1], rest // counts[1], lists.references])
    return set(map(tuple, rows.tolist()))


def boxes_of(lattice):
    """Low and high corners of all cells, shape (nx, ny, nz, 3); the outer ones are infinite."""
    edges = []
    for low, size, count in zip(lattice.low, lattice.size, lattice.counts, strict=True):
        planes = low + size * np.arange(count + 1.0)
        planes[-1] = max(planes[-1], lattice.high[len(edges)])
        edges.append(planes)
    low = np.stack(np.meshgrid(*[planes[:-1] for planes in edges], indexing="ij"), axis=-1)
    high = np.stack(np.meshgrid(*[planes[1:] for planes in edges], indexing="ij"), axis=-1)
    return low, high


def meets(low, high, corners, growth):
    """The boxes that, grown, overlap the box and the plane of a triangle."""
    low, high = low - growth, high + growth
    in_box = ((low <= corners.max(axis=0)) & (high >= corners.min(axis=0))).all(axis=-1)
    a, b, c = corners
    normal = np.cross(b - a, c - a)
    corner_signs = [
        np.where([x, y, z], high, low) @ normal - a @ normal
        for x in (0, 1)
        for y in (0, 1)
        for z in (0, 1)
    ]
    return in_box & (np.min(corner_signs, axis=0) <= 0) & (np.max(corner_signs, axis=0) >= 0)


def clipped(corners, low, high):
    """The part of a triangle in a closed box: its vertices, or none."""
    polygon = list(corners)
    for axis in range(3):
        for sign, limit in ((1, high[axis]), (-1, -low[axis])):
            result = []
            for p, q in zip(polygon, polygon[1:] + polygon[:1], strict=True):
                inside_p, inside_q = sign * p[axis] <= limit, sign * q[axis] <= limit
                if inside_p:
                    result.append(p)
                if inside_p != inside_q:
                    share = (limit - sign * p[axis]) / (sign * (q[axis] - p[axis]))
                    result.append(p + share * (q - p))
            polygon = result
    return polygon


@quiet
@given(meshes(), st.sampled_from([(1, 1, 1), (2, 3, 4), (5, 1, 2), (8, 8, 8)]))
def test_cells_meet_the_plane_and_the_box(mesh, resolution):
    structure = grid(*mesh[0], resolution=resolution)
    lattice = structure.lattice
    found = listed(structure.lists, lattice.counts)
    low, high = boxes_of(lattice)
    least, most = set(), set()
    for prim_id in structure.triangles.prim_ids.tolist():
        corners = structure.triangles.corners[prim_id].astype(float)
        for growth, cells in ((0.98, least), (1.02, most)):
            rows = np.argwhere(meets(low, high, corners, growth * lattice.growth))
            cells.update((*row, prim_id) for row in rows.tolist())
    assert least <= found <= most


@pytest.mark.parametrize("levels", [1, 2])
def test_every_cell_that_a_triangle_enters_lists_it(levels):
    structure = grid(*soup(150, 3, 0.3), resolution=(4, 3, 5), levels=levels)
    lattice, fine = structure.lattice, structure.fine
    found = listed(structure.lists, lattice.counts)
    low, high = boxes_of(lattice)
    entered = 0
    for prim_id, corners in enumerate(structure.triangles.corners.astype(float)):
        for cell in np.ndindex(lattice.counts):
            if clipped(corners, low[cell], high[cell]):
                entered += 1
                assert (*cell, prim_id) in found
    # Not many more: with corners cut off, these cells would list about a tenth less.
    assert entered > 0.75 * len(found)
    for row, cell in enumerate(fine.cells.tolist()):
        i, j, k = cell % 4, cell // 4 % 3, cell // 12
        first, last = fine.first_cells[row : row + 2]
        size = (high[i, j, k] - low[i, j, k]) / fine.counts[row]
        whole = range(structure.lists.splits[cell], structure.lists.splits[cell + 1])
        for inner in range(first, last):
            x, rest = (inner - first) % fine.counts[row, 0], (inner - first) // fine.counts[row, 0]
            place = np.array([x, rest % fine.counts[row, 1], rest // fine.counts[row, 1]])
            inner_low = low[i, j, k] + size * place
            rows = range(fine.lists.splits[inner], fine.lists.splits[inner + 1])
            held = set(fine.lists.references[rows.start : rows.stop].tolist())
            for prim_id in structure.lists.references[whole.start : whole.stop].tolist():
                corners = structure.triangles.corners[prim_id].astype(float)
                if prim_id not in held:
                    shrunk = size * 1e-6
                    assert not clipped(corners, inner_low + shrunk, inner_low + size - shrunk)


def test_a_slanted_triangle_is_not_in_all_cells_of_its_box():
    """Its plane culls most of them."""
    structure = grid([[0, 0, 0], [1, 0, 1], [0, 1, 1]], [[0, 1, 2]], resolution=20)
    assert len(structure.lists.references) < 0.15 * 20**3


def test_lists_are_in_order():
    for levels in (1, 2):
        structure = grid(*soup(500, 3), resolution=3, levels=levels)
        for lists in (structure.lists, structure.fine.lists):
            for begin, end in zip(lists.splits[:-1], lists.splits[1:], strict=True):
                assert (np.diff(lists.references[begin:end]) > 0).all()

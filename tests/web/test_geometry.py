"""What pages leave out of a BVH, and when they do not."""

from __future__ import annotations

import numpy as np

import raystream as rs
from meshes import icosphere
from raystream.graphics.structures import shader_structure_of
from raystream.web.geometry import structure_arrays


def test_a_bvh_with_triangles_that_an_update_took_away_is_whole():
    """The page would give them boxes and hits again."""
    vertices, faces = icosphere(2)
    tracer = rs.Tracer(rs.Scene([rs.Mesh(vertices, faces)]))
    how, kept = structure_arrays(tracer.structure, shader_structure_of(tracer.structure))
    assert how == "bvh"
    moved = np.array(vertices, float)
    moved[faces[0][0]] = np.nan
    assert not tracer.update(moved, max_cost_growth=100.0).rebuilt
    how, whole = structure_arrays(tracer.structure, shader_structure_of(tracer.structure))
    assert how == "arrays"
    assert sum(one.nbytes for one in whole.values()) > 4 * sum(one.nbytes for one in kept.values())

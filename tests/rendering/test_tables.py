"""Tables for shading kernels: scenes that exceed their limits are refused."""

from __future__ import annotations

import numpy as np
import pytest

import raystream as rs
from raystream.rendering import vertex_attributes
from raystream.rendering.shading.light_tables import lights_of
from raystream.rendering.shading.tables import tables_of

SQUARE = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0.0]]
HALVES = [[0, 1, 2], [0, 2, 3]]

BUMPY = rs.Material(textures={"bump": rs.Texture(np.zeros((1, 1, 3), np.uint8))})
BRIGHT = rs.Material(emission=(1, 1, 1))


def square(faces=HALVES, materials=(), **of_vertices):
    return rs.Scene([rs.Mesh(SQUARE, faces, **of_vertices)], materials=materials)


def texcoords():
    return np.array(SQUARE)[:, :2]


@pytest.mark.parametrize(
    ("make", "scene", "width", "rows"),
    [
        (tables_of, square(), 9, "2 triangles"),
        (tables_of, square(HALVES[:1], normals=np.ones((4, 3))), 3, "4 vertices"),
        (tables_of, square(HALVES[:1], [BUMPY], texcoords=texcoords()), 6, "4 vertices"),
        (lights_of, square(materials=[BRIGHT]), 17, "2 triangles"),
    ],
    ids=["corners", "attributes", "tangents", "lights"],
)
def test_tables_that_int32_cannot_count_are_refused(make, scene, width, rows, monkeypatch):
    count = int(rows.split()[0])
    monkeypatch.setattr(vertex_attributes, "MAX_NUMBERS", count * width)
    make(scene)
    monkeypatch.setattr(vertex_attributes, "MAX_NUMBERS", count * width - 1)
    with pytest.raises(ValueError, match=f"^scene: {rows}.* more than the {count - 1} that can"):
        make(scene)


def test_positions_of_the_most_triangles_fit_in_int32():
    most = vertex_attributes.MAX_NUMBERS // 9
    vertex_attributes.check_rows(most, 9, "triangles")
    assert 9 * most - 1 <= np.iinfo(np.int32).max
    with pytest.raises(ValueError, match="238,609,295 triangles"):
        vertex_attributes.check_rows(most + 1, 9, "triangles")

"""Hypothesis strategies: meshes and rays on coarse lattices, where ties and grazes abound."""

from __future__ import annotations

import numpy as np
from hypothesis import strategies as st

#: Few values, so that coordinates coincide; and some that are awkward in float32.
COORDINATES = st.one_of(
    st.integers(-3, 3).map(float),
    st.sampled_from([0.5, -0.5, 0.1, 1 / 3, 1e-7, -1e-7, 1e-3, 2.5]),
    st.floats(-4, 4, width=32),
)


@st.composite
def meshes(draw, max_triangles: int = 12):
    """Vertices of shape (V, 3) and faces of shape (F, 3); degenerate triangles among them."""
    count = draw(st.integers(1, 12))
    rows = st.lists(COORDINATES, min_size=3, max_size=3)
    vertices = draw(st.lists(rows, min_size=count, max_size=count))
    index = st.integers(0, count - 1)
    faces = draw(st.lists(st.tuples(index, index, index), max_size=max_triangles))
    scale = draw(st.sampled_from([1.0, 1.0, 1e-6, 1e6]))
    offset = draw(st.sampled_from([0.0, 0.0, 1e7, -3e4])) * scale
    return (np.array(vertices) * scale + offset, np.array(faces, int).reshape(-1, 3)), scale, offset


@st.composite
def scenes_and_rays(draw, max_rays: int = 8):
    """A mesh, and rays to and from its neighbourhood, some exactly through its vertices."""
    (vertices, faces), scale, offset = draw(meshes())
    rows = st.lists(COORDINATES, min_size=3, max_size=3)
    count = draw(st.integers(1, max_rays))
    origins = np.array(draw(st.lists(rows, min_size=count, max_size=count))) * scale + offset
    directions = np.array(draw(st.lists(rows, min_size=count, max_size=count)))
    if draw(st.booleans()):
        directions = vertices[np.arange(count) % len(vertices)] - origins
    return vertices, faces, origins, directions

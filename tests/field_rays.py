"""Height fields with holes, the meshes that they stand for, and rays at them."""

from __future__ import annotations

import numpy as np

import raystream as rs


def mesh_of(heights, origin=(0.0, 0.0, 0.0), spacing=1.0) -> rs.Scene:
    """The triangles that a height field stands for, those without data with vertices of NaN."""
    heights = np.asarray(heights, float)
    rows, columns = heights.shape
    dx, dy = np.broadcast_to(spacing, 2)
    x, y = origin[0] + dx * np.arange(columns), origin[1] + dy * np.arange(rows)
    vertices = np.stack([*np.meshgrid(x, y), heights + origin[2]], axis=-1).reshape(-1, 3)
    faces = []
    for j in range(rows - 1):
        for i in range(columns - 1):
            a, b = j * columns + i, j * columns + i + 1
            d, c = a + columns, b + columns
            faces += [(a, b, c), (a, c, d)] if dx * dy > 0 else [(a, c, b), (a, d, c)]
    return rs.Scene.from_arrays(vertices, faces)


def random_heights(rng, rows: int, columns: int, missing: float = 0.0) -> np.ndarray:
    heights = rng.uniform(-1.0, 1.0, (rows, columns)) + 3.0 * np.sin(np.arange(columns) / 5.0)
    heights[rng.random((rows, columns)) < missing] = np.nan
    return heights


def rays_at(rng, scene: rs.Scene, count: int) -> dict:
    """Rays anywhere, at vertices and edges, along axes and grid lines, from far away, limited."""
    low, high = scene.bounds
    size = np.maximum(high - low, 1e-3 * (high - low).max())
    origins = rng.uniform(low - size, high + size, (count, 3))
    directions = rng.uniform(low, high, (count, 3)) - origins
    kind = rng.integers(0, 8, count)
    vertices = scene.meshes[0].vertices
    vertices = vertices[np.isfinite(vertices).all(axis=1)]
    at = vertices[rng.integers(0, len(vertices), count)]
    other = vertices[rng.integers(0, len(vertices), count)]
    directions[kind == 1] = (at - origins)[kind == 1]
    middle = (at + other) / 2
    directions[kind == 2] = (middle - origins)[kind == 2]
    down = np.array([0.0, 0.0, -1.0])
    origins[kind == 3] = (at + [0.0, 0.0, 2.0] * size)[kind == 3]
    directions[kind == 3] = down
    axis = np.eye(3)[rng.integers(0, 3, count)] * rng.choice([-1.0, 1.0], count)[:, None]
    origins[kind == 4] = (at - axis * size)[kind == 4]
    directions[kind == 4] = axis[kind == 4]
    far = kind == 5
    origins[far] = (at - 1e4 * directions)[far]
    directions[kind == 6] *= 1e-9
    t_min, t_max = np.zeros(count), np.full(count, np.inf)
    t_min[kind == 7], t_max[kind == 7] = rng.uniform(-0.5, 0.5), rng.uniform(0.5, 1.5)
    limits = {"t_min": t_min.astype(np.float32), "t_max": t_max.astype(np.float32)}
    return {"origins": origins, "directions": directions, **limits}


#: Name: shape, share of samples without data, and where the samples are.
PLACES = {
    "plain": ((23, 18), 0.0, {}),
    "holes": ((21, 26), 0.2, {}),
    "mostly holes": ((19, 19), 0.7, {}),
    "one cell": ((2, 2), 0.0, {}),
    "one row": ((2, 70), 0.1, {}),
    "one column": ((70, 2), 0.1, {}),
    "a block": ((5, 5), 0.0, {}),
    "rows from north to south": ((14, 17), 0.1, {"spacing": (2.0, -3.0)}),
    "both ways down": ((14, 17), 0.1, {"spacing": (-0.5, -0.25)}),
    "columns from east to west": ((14, 17), 0.0, {"spacing": (-0.5, 0.25)}),
    "far from the origin": ((16, 16), 0.1, {"origin": (5e6, -3e6, 1e5), "spacing": 30.0}),
    "tiny": ((16, 16), 0.1, {"spacing": 1e-9}),
    "wide": ((16, 16), 0.0, {"spacing": 1e9}),
}

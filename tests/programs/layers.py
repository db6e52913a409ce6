"""A scene in which every ray has many hits, many of them at the same t; and its rays."""

import numpy as np

import raystream as rs

LAYERS = 30
COPIES = 3


def layers_scene():
    """Squares of two triangles one behind the other, each there three times; two meshes."""
    square = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], float)
    vertices = np.concatenate([square + [0, 0, z] for z in range(LAYERS)])
    pair = np.array([[0, 1, 2], [0, 3, 2]])  # they face opposite ways
    faces = np.concatenate([pair + 4 * (k % LAYERS) for k in range(LAYERS * COPIES)])
    rng = np.random.default_rng(5)
    faces = faces[rng.permutation(len(faces))]
    half = len(faces) // 2
    return rs.Scene(
        [rs.Mesh(vertices, faces[:half]), rs.Mesh(vertices, np.empty((0, 3), int))]
        + [rs.Mesh(vertices, faces[half:])]
    )


def layers_rays(width=20, height=18):
    """An image of rays through the layers; some beside them, and one that is invalid."""
    x, y = np.meshgrid(np.linspace(-0.1, 1.0, width), np.linspace(0.0, 1.05, height))
    origins = np.stack([x, y, np.full_like(x, -1.0)], axis=-1)
    directions = np.broadcast_to([0.0, 0.0, 0.5], origins.shape).copy()
    directions[3, 4] = 0.0
    origins[::2, ::3, 2] = LAYERS + 1.0  # from the other side
    directions[::2, ::3, 2] *= -1.0
    return origins, directions


def ranks(many):
    """Position of each row within its ray."""
    return np.arange(len(many.t)) - many.ray_splits[:-1][many.ray_id]


def enters(tracer, many, directions):
    """Whether each row's ray enters, by NumPy."""
    d = np.broadcast_to(directions, (*many.status.shape, 3)).reshape(-1, 3)[many.ray_id]
    return np.einsum("ij,ij->i", many.normals.astype(np.float64), d) < 0


def sums(many, values, rows=slice(None)):
    """Sums over each ray's rows, in the rays' shape."""
    rays = many.ray_id[rows]
    total = np.bincount(rays, weights=values[rows], minlength=many.status.size)
    return total.reshape(many.status.shape)

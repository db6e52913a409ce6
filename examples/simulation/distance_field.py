"""
Signed distances on a grid
==========================

The distance from a closed mesh, negative inside, sampled on a grid. Marching cubes, collision tests
and offset surfaces start from such a grid.
"""

import numpy as np

import raystream as rs

# A ball of 5,120 triangles: the sides of an icosahedron, divided.
golden = (1 + 5**0.5) / 2
ring = [(0, s, t * golden) for s in (-1, 1) for t in (-1, 1)]
vertices = np.array([np.roll(p, k) for k in range(3) for p in ring], float)
near = np.linalg.norm(vertices[:, None] - vertices, axis=2) < 2.1
faces = np.array(
    [
        (a, b, c)
        for a in range(12)
        for b in range(a)
        for c in range(b)
        if near[a, b] and near[b, c] and near[a, c]
    ]
)
corners = vertices[faces]
outward = np.einsum("fk,fk->f", np.cross(corners[:, 0], corners[:, 1]), corners[:, 2]) > 0
faces = np.where(outward[:, None], faces, faces[:, ::-1])
corners = vertices[faces]
for _ in range(4):  # each triangle becomes four
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    ab, bc, ca = a + b, b + c, c + a  # their length follows below
    corners = np.concatenate(
        [np.stack(t, 1) for t in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))]
    )
    corners /= np.linalg.norm(corners, axis=-1, keepdims=True)
ball = rs.Scene.from_arrays(corners.reshape(-1, 3), np.arange(corners.shape[0] * 3).reshape(-1, 3))

line = np.linspace(-1.5, 1.5, 61)
grid = np.stack(np.meshgrid(line, line, line, indexing="ij"), axis=-1)
tracer = rs.Tracer(ball)
field = tracer.signed_distance(grid)

exact = np.linalg.norm(grid, axis=-1) - 1.0
print(f"{ball.triangle_count:,} triangles, {field.size:,} points")
print(f"largest difference from a sphere's: {np.abs(field - exact).max():.4f}")
volume = (field < 0).sum() * (line[1] - line[0]) ** 3
print(f"volume inside: {volume:.3f}, of a sphere: {4 / 3 * np.pi:.3f}")
assert np.abs(field - exact).max() < 0.003

# A slice through the middle: blue inside, red outside, a line at every 0.1.
x, y = np.meshgrid(np.linspace(-1.5, 1.5, 400), np.linspace(-1.5, 1.5, 400))
middle = tracer.signed_distance(np.stack([x, y, np.zeros_like(x)], axis=-1))[..., None]
shade = np.where(np.abs(middle * 10 - np.round(middle * 10)) < 0.08, 0.3, 1 - np.abs(middle) / 2)
rs.Image(np.where(middle < 0, [0.2, 0.4, 1.0], [1.0, 0.5, 0.3]) * shade).save("distance_field.png")
print("wrote distance_field.png")

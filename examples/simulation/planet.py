"""
Millimetres on a planet
=======================

A pyramid 10 mm high on a sphere of the Earth's size: float32 misses it, float64 measures it.
"""

import numpy as np

import raystream as rs

RADIUS = 6.371e6  # metres

# A sphere of triangles, and a pyramid 10 mm high somewhere on it.
turns = np.linspace(0.0, 2.0 * np.pi, 49)[:-1]
heights = np.linspace(-np.pi / 2, np.pi / 2, 25)
along, up = np.meshgrid(turns, heights)
sphere = RADIUS * np.stack([np.cos(up) * np.cos(along), np.cos(up) * np.sin(along), np.sin(up)], -1)
rows, columns = np.meshgrid(np.arange(24), np.arange(48), indexing="ij")
a, b = rows * 48 + columns, rows * 48 + (columns + 1) % 48
quads = np.stack([a, b, b + 48, a, b + 48, a + 48], -1).reshape(-1, 3)

spot = sphere.reshape(-1, 3)[quads[700]].mean(axis=0)
away = spot / np.linalg.norm(spot)
side = np.cross(away, [0.0, 0.0, 1.0])
other = np.cross(away, side)
pyramid = spot + 0.005 * np.array([2.0 * away, side, other, -side, -other])
sides = np.array([[0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 4, 1]])

scene = rs.Scene([rs.Mesh(sphere.reshape(-1, 3), quads), rs.Mesh(pyramid, sides)])

# From orbit, rays down to a square of 2 cm around the pyramid.
x, y = np.meshgrid(np.linspace(-0.01, 0.01, 41), np.linspace(-0.01, 0.01, 41))
targets = spot + x[..., None] * side + y[..., None] * other
origins = targets + 400e3 * away

for precision in ("float32", "float64"):
    hits = rs.Tracer(scene, precision=precision).first_hit(origins, -away)
    on_pyramid = np.count_nonzero(hits.mesh_id == 1)
    print(f"{precision}: {on_pyramid} of {hits.t.size:,} rays hit the pyramid")
    if on_pyramid:
        rise = hits.t[hits.mesh_id == 0].mean() - hits.t.min()
        print(f"its tip is {rise * 1000:.2f} mm above the ground")

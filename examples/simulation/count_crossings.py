"""
Inside or outside
=================

A ray from a point inside a closed mesh crosses the surface an odd number of times. The rays here
pass exactly through vertices and along edges, where counting triangles fails.
"""

import numpy as np

import raystream as rs

# A closed cube whose faces are cut by diagonals, and points on a lattice around it.
corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
faces = [t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))]
tracer = rs.Tracer(rs.Scene.from_arrays(corners, faces))

line = np.arange(-0.5, 1.75, 0.25)
points = np.stack(np.meshgrid(line, line, line), axis=-1)  # any shape (..., 3) will do
strictly_inside = ((points > 0) & (points < 1)).all(axis=-1)
off_the_surface = ((points < 0) | (points > 1)).any(axis=-1) | strictly_inside

direction = [1.0, 1.0, 1.0]  # along the space diagonal: through corners and edges
surfaces = tracer.count_hits(points, direction, crossings="surfaces")
triangles = tracer.count_hits(points, direction, crossings="triangles")

right = ((surfaces % 2 == 1) == strictly_inside)[off_the_surface]
naive = ((triangles % 2 == 1) == strictly_inside)[off_the_surface]
print(f"points off the surface: {right.size}")
print(f"right by surfaces:  {np.count_nonzero(right)}")
print(f"right by triangles: {np.count_nonzero(naive)}")
assert right.all()

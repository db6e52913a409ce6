"""
Points among hills
==================

A scan's points as spheres, on terrain without triangles.

.. code-block:: console

    $ python examples/simulation/point_cloud.py
    $ python examples/simulation/point_cloud.py 2000 1000000

Which of the points does a camera on a mast see, and how much of the ground? The arguments are the
number of samples along each side of the terrain, and the number of points.
"""

import sys

import numpy as np

import raystream as rs

side, count = (int(sys.argv[k]) if len(sys.argv) > k else (300, 20_000)[k - 1] for k in (1, 2))
rng = np.random.default_rng(1)

# Hills of 100 x 100 m, as a raster.
x, y = np.meshgrid(np.linspace(0.0, 100.0, side), np.linspace(0.0, 100.0, side))
heights = 8.0 * np.sin(x / 17.0) * np.cos(y / 13.0) + 0.15 * np.sin(x) * np.sin(1.3 * y)
ground = rs.Scene.height_field(heights.astype(np.float32), spacing=100.0 / (side - 1))

# A scan of shrubs: points up to two metres above the ground, some on each of 300 shrubs.
shrubs = rng.uniform(2.0, 98.0, (300, 2))
points = np.column_stack([shrubs[rng.integers(0, 300, count)], np.zeros(count)])
points += rng.normal(size=(count, 3)) * [0.6, 0.6, 0.0]
below = rs.Tracer(ground).first_hit(points + [0.0, 0.0, 50.0], [0.0, 0.0, -1.0])
points, floor = points[below.is_hit], below.positions[below.is_hit, 2]
points[:, 2] = floor + rng.uniform(0.05, 2.0, len(points))
cloud = rs.Scene.spheres(points, radii=0.03)

tracer = rs.Tracer(rs.Scene.combine([ground, cloud]))
memory = tracer.structure.report.byte_count / 2**20
print(f"{tracer.scene}: {memory:.1f} MB")

# Rays from the mast to each point end where they enter its sphere.
mast = tracer.first_hit([50.0, 50.0, 99.0], [0.0, 0.0, -1.0]).positions + [0.0, 0.0, 6.0]
hits = tracer.first_hit(mast, points - mast)
seen = hits.prim_id - 2 * (side - 1) ** 2 == np.arange(len(points))
print(f"points in sight: {seen.sum():,} of {len(points):,}")

# Rays to the ground must hit nothing before they reach it.
targets = np.stack([x, y, heights], axis=-1).reshape(-1, 3)
clear = ~tracer.any_hit(mast, targets - mast, t_max=0.999)
print(f"ground in sight: {clear.mean():.1%}, without shrubs ", end="")
print(f"{(~rs.Tracer(ground).any_hit(mast, targets - mast, t_max=0.999)).mean():.1%}")

# From above: the ground in sight is bright, points in sight are green, hidden points dark.
image = np.where(clear.reshape(heights.shape)[..., None], [0.8, 0.7, 0.5], [0.3, 0.25, 0.2])
places = np.clip((points[:, :2] / 100.0 * (side - 1)).astype(int), 0, side - 1)
image[places[:, 1], places[:, 0]] = np.where(seen[:, None], [0.1, 0.8, 0.1], [0.0, 0.15, 0.0])
rs.Image(image[::-1].repeat(2, axis=0).repeat(2, axis=1)).save("point_cloud.png")
print("wrote point_cloud.png")

"""
Thickness by a program
======================

How much of each ray lies inside a closed mesh? A program runs at every hit: it adds the hit's
distance where the ray leaves the mesh and subtracts it where the ray enters. The sum is the length
inside, and no list of all hits is stored.
"""

import numpy as np

import raystream as rs

RECORD = np.dtype([("crossings", "i4"), ("inside", "f8")])


def add_up(hit, payload):
    """Run at every crossing of a ray with the surface."""
    payload.crossings += 1
    payload.inside += -hit.t if hit.is_entering else hit.t


# A sphere of radius 1 from a lattice of longitudes and latitudes.
RINGS, SECTORS = 64, 128
polar, around = np.meshgrid(
    np.linspace(0, np.pi, RINGS + 1), np.arange(SECTORS) * 2 * np.pi / SECTORS, indexing="ij"
)
sphere = np.stack(
    [np.sin(polar) * np.cos(around), np.sin(polar) * np.sin(around), np.cos(polar)], axis=-1
)
sphere[0], sphere[-1] = [0, 0, 1], [0, 0, -1]  # poles are one point each
ids = np.arange((RINGS + 1) * SECTORS).reshape(RINGS + 1, SECTORS)
below, right = ids[1:], np.roll(ids, -1, axis=1)
quads = np.stack([ids[:-1], below, right[1:], right[:-1]], axis=-1).reshape(-1, 4)
faces = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
first, second, third = sphere.reshape(-1, 3)[faces].transpose(1, 0, 2)
has_area = (np.linalg.norm(np.cross(second - first, third - first), axis=1)) > 1e-12
tracer = rs.Tracer(rs.Scene.from_arrays(sphere.reshape(-1, 3), faces[has_area]))

x, y = np.meshgrid(np.linspace(-1.2, 1.2, 200), np.linspace(-1.2, 1.2, 200))
origins = np.stack([x, y, np.full_like(x, -3.0)], axis=-1)
seen = tracer.trace(origins, [0.0, 0.0, 1.0], on_hit=add_up, payload=RECORD, crossings="surfaces")

exact = 2 * np.sqrt(np.maximum(1 - x**2 - y**2, 0))
error = np.abs(seen["inside"] - exact)
print(f"rays that cross the sphere: {np.count_nonzero(seen['crossings']):,} of {x.size:,}")
print(f"mean of all rays: {seen['inside'].mean():.4f}; of an exact sphere: {exact.mean():.4f}")
assert (seen["crossings"] % 2 == 0).all()
assert np.median(error) < 0.01

image = (seen["inside"] / 2)[..., None] * [1.0, 0.6, 0.2]
rs.Image(image.repeat(2, axis=0).repeat(2, axis=1)).save("thickness.png")
print("wrote thickness.png")

"""
A glass model
=============

A closed mesh in glass, on a tiled floor, under the sky and two large lamps.

.. code-block:: console

    $ python examples/images/glass_model.py bunny 1920x1080 512

renders a model file, a sample or a ``ring`` in this size, with this number of samples per pixel;
without arguments, a small image of the ring. The documentation shows ``ring 480x360 64``.
"""

import sys

import numpy as np

import raystream as rs

GLASS = rs.Material("glass", diffuse=(0, 0, 0), transmission=(0.97, 1.0, 0.98), ior=1.5)


def ring(turns=96, sides=48):
    """A torus that lies flat."""
    u, v = np.meshgrid(*(np.arange(n) * 2 * np.pi / n for n in (turns, sides)), indexing="ij")
    reach = 1.0 + 0.4 * np.cos(v)
    corners = np.stack([reach * np.cos(u), 0.4 * np.sin(v), reach * np.sin(u)], axis=-1)
    place = np.arange(turns * sides).reshape(turns, sides)
    right, above = np.roll(place, -1, axis=0), np.roll(place, -1, axis=1)
    both = np.roll(right, -1, axis=1)
    halves = np.stack([place, above, right, right, above, both], axis=-1)
    return rs.Mesh(corners.reshape(-1, 3), halves.reshape(-1, 3))


def smooth(vertices, faces):
    """A mesh whose normals at vertices are means of those of the faces around, by their area."""
    a, b, c = (vertices[faces[:, k]].astype(float) for k in range(3))
    normals = np.zeros((len(vertices), 3))
    np.add.at(normals, faces, np.cross(b - a, c - a)[:, None])
    return rs.Mesh(vertices, faces, normals=normals)


def rectangle(center, across, along, material):
    """A rectangle from its centre and half of each side; their cross product is its front."""
    center, across, along = (np.array(vector, float) for vector in (center, across, along))
    corners = [center - across - along, center + across - along]
    corners += [center + across + along, center - across + along]
    texcoords = [[0, 0], [1, 0], [1, 1], [0, 1]]
    return rs.Mesh(corners, [[0, 1, 2], [0, 2, 3]], texcoords=texcoords, material_ids=material)


model = [ring()] if sys.argv[1:2] in ([], ["ring"]) else rs.load(sys.argv[1]).meshes
width, height = map(int, (sys.argv[2] if len(sys.argv) > 2 else "64x48").split("x"))
samples = int(sys.argv[3]) if len(sys.argv) > 3 else 16

# Of size 1, in the middle of the floor.
corners = np.concatenate([mesh.vertices for mesh in model])
low, high = corners.min(axis=0), corners.max(axis=0)
foot = np.array([(low[0] + high[0]) / 2, low[1], (low[2] + high[2]) / 2])
size = (high - low).max()
glass = [smooth((mesh.vertices - foot) / size, mesh.faces) for mesh in model]

tiles = (np.indices((1024, 1024)) // 64).sum(axis=0) % 2
colors = np.where(tiles[..., None], (215, 205, 190), (120, 110, 100)).astype(np.uint8)
scene = rs.Scene(
    [
        *glass,
        rectangle((0, -1e-3, 0), (0, 0, 5), (5, 0, 0), 1),
        rectangle((-2.5, 2.0, 0.5), (0, 0, 1), (0.6, 0.8, 0), 2),
        rectangle((2.4, 1.4, 1.8), (0.8, 0, -1), (0, 0.8, 0), 2),
    ],
    materials=[
        GLASS,
        rs.Material("floor", diffuse=(1, 1, 1), textures={"diffuse": rs.Texture(colors)}),
        rs.Material("lamp", diffuse=(0, 0, 0), emission=(6.0, 5.6, 5.0)),
    ],
    lights=rs.daylight(250, 30)[1:],  # the sky alone
    camera=rs.Camera((0.6, 0.85, 2.3), (0, 0.42, 0), fov=32),
)
image = rs.render(scene, size=(width, height), samples=samples, clamp=8.0, layers="all")
image.denoise().save("glass.png", exposure=1.8, tone="aces")
print(f"glass.png: {scene.triangle_count:,} triangles, {width} x {height}, {samples} samples")

"""
Six materials
=============

Plastic, metal, car paint, varnish, velvet and frosted glass.

.. code-block:: console

    $ python examples/images/materials.py 1280x480 256

renders an image of this size, with this number of samples per pixel; without arguments, a small
one. The documentation shows ``640x240 32``.
"""

import sys

import numpy as np

import raystream as rs

DENTS = rs.textures.noise(frequency=24, size=512, octaves=3, encoding="plain")
GLASS = {"transmission": (0.95, 1.0, 0.97), "normal_reflectance": (0, 0, 0)}

MATERIALS = [
    rs.Material("plastic", diffuse=(0.05, 0.2, 0.5), roughness=0.35, metallic=0.0),
    rs.Material("metal", diffuse=(0.95, 0.64, 0.35), roughness=0.3, metallic=1.0),
    rs.Material("car paint", diffuse=(0.5, 0.02, 0.03), roughness=0.5, metallic=0.7, clearcoat=1.0),
    rs.Material(
        "varnish",  # the coat is smooth, the wood below it is not
        diffuse=(0.3, 0.12, 0.04),
        roughness=0.6,
        metallic=0.0,
        textures={"bump": DENTS},
        bump_scale=5.0,
        clearcoat=1.0,
        clearcoat_roughness=0.05,
    ),
    rs.Material(
        "velvet",
        diffuse=(0.12, 0.01, 0.06),
        roughness=1.0,
        metallic=0.0,
        sheen_color=(0.9, 0.35, 0.6),
        sheen_roughness=0.4,
    ),
    rs.Material(
        "frosted glass",
        diffuse=(1, 1, 1),
        **GLASS,
        ior=1.5,
        roughness=0.4,
        metallic=0.0,
        grazing_reflectance=0.0,
    ),
]


def ball(center, material, turns=128, rings=64):
    """A ball of radius 0.5 with texture coordinates."""
    s, t = np.meshgrid(np.linspace(0, 1, turns + 1), np.linspace(0, 1, rings + 1), indexing="ij")
    around, down = 2 * np.pi * s, np.pi * t
    normals = np.stack(
        [np.sin(down) * np.cos(around), np.cos(down), -np.sin(down) * np.sin(around)], axis=-1
    ).reshape(-1, 3)
    place = np.arange((turns + 1) * (rings + 1)).reshape(turns + 1, rings + 1)
    a, b, c, d = place[:-1, :-1], place[:-1, 1:], place[1:, 1:], place[1:, :-1]
    faces = np.concatenate([np.stack([a, b, c], -1)[:, 1:], np.stack([a, c, d], -1)[:, :-1]], 1)
    return rs.Mesh(
        np.array(center) + 0.5 * normals,
        faces.reshape(-1, 3),
        normals=normals,
        texcoords=np.stack([2 * s, 1 - t], axis=-1).reshape(-1, 2),
        material_ids=material,
    )


width, height = map(int, (sys.argv[1] if len(sys.argv) > 1 else "96x36").split("x"))
samples = int(sys.argv[2]) if len(sys.argv) > 2 else 16

floor = rs.Mesh(
    [[-50, 0, 50], [50, 0, 50], [50, 0, -50], [-50, 0, -50]],
    [[0, 1, 2], [0, 2, 3]],
    texcoords=[[0, 0], [100, 0], [100, 100], [0, 100]],
    material_ids=len(MATERIALS),
)
tiles = rs.textures.checker((0.45, 0.43, 0.4), (0.2, 0.2, 0.2), (2, 2))
scene = rs.Scene(
    [floor, *(ball((1.1 * (k - 2.5), 0.5, 0), k) for k in range(len(MATERIALS)))],
    materials=[*MATERIALS, rs.Material("floor", textures={"diffuse": tiles})],
    lights=rs.daylight(215, 35),
    camera=rs.Camera((0, 1.6, 6), (0, 0.42, 0), fov=24),
)
image = rs.render(scene, size=(width, height), samples=samples, clamp=8.0, layers="all")
image.denoise().save("materials.png", exposure=0.7, tone="aces")
print(f"materials.png: {width} x {height}, {samples} samples")

"""
A billion triangles
===================

One patch of forest, placed thousands of times as instances: more than a billion triangles.

.. code-block:: console

    $ python examples/images/instances.py 1920x1080 16

renders an image of this size, with this number of samples per pixel; without arguments, a small
one. The documentation shows ``480x270 8``.
"""

import sys

import numpy as np

import raystream as rs

width, height = map(int, (sys.argv[1] if len(sys.argv) > 1 else "96x54").split("x"))
samples = int(sys.argv[2]) if len(sys.argv) > 2 else 4
SIDE = 64

# Trees without their ground, as one object.
patch = rs.load("forest", triangles=280_000)
trees = patch.replace(meshes=patch.meshes[1:])
(left, _, back), (right, _, front) = trees.bounds
pitch = 0.86 * np.array([right - left, front - back])  # crowns overlap

# Each patch is turned by a quarter or not, and mirrored or not.
rng = np.random.default_rng(7)
quarter, mirror = rng.integers(0, 2, (2, SIDE * SIDE))
cosines, signs = 1.0 - quarter, 1.0 - 2.0 * mirror
places = np.zeros((SIDE * SIDE, 3, 4))
places[:, 0, 0], places[:, 0, 2] = signs * cosines, quarter
places[:, 2, 0], places[:, 2, 2] = -signs * quarter, cosines
places[:, 1, 1] = 1.0
center = np.array([(left + right) / 2, 0.0, (back + front) / 2])
rows, columns = np.divmod(np.arange(SIDE * SIDE), SIDE)
# Long hills, so that what is far can be seen over what is near.
x, z = rows * pitch[0], columns * pitch[1]
hills = 25.0 * np.sin(x / 190.0) * np.cos(z / 260.0) + 15.0 * np.sin((x + z) / 330.0)
places[:, :, 3] = np.stack([x, hills, z], axis=1) - places[:, :, :3] @ center

# The ground below them.
lines = np.arange(-2, SIDE + 2)
i, k = np.meshgrid(lines, lines, indexing="ij")
x, z = i * pitch[0], k * pitch[1]
hills = 25.0 * np.sin(x / 190.0) * np.cos(z / 260.0) + 15.0 * np.sin((x + z) / 330.0)
corners = np.stack([x, hills - 1.5, z], axis=-1).reshape(-1, 3)
at = (np.arange(len(lines) - 1)[:, None] * len(lines) + np.arange(len(lines) - 1)).reshape(-1, 1)
faces = np.concatenate([at + [0, 1, len(lines)], at + [1, len(lines) + 1, len(lines)]])
ground = rs.Scene([rs.Mesh(corners, faces)], materials=patch.materials[:1])

scene = rs.Scene.instances(
    [trees, ground],
    np.concatenate([places, np.eye(3, 4)[None]]),
    np.append(np.zeros(SIDE * SIDE, int), 1),
    lights=rs.daylight(235, 30),
    camera=rs.Camera((330.0, 55.0, 250.0), (1000.0, -60.0, 1150.0), fov=48),
)
tracer = rs.Tracer(scene)
megabytes = tracer.structure.report.byte_count / 2**20
image = rs.render(tracer, size=(width, height), samples=samples, layers="all")
image.denoise().save("instances.png", exposure=1.6, tone="aces")
total = len(places) * trees.triangle_count + ground.triangle_count
print(f"instances.png: {total:,} triangles in {megabytes:.0f} MB, {samples} samples")

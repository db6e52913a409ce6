"""
Trees of an orchard
===================

A LiDAR scan of instances from above: which tree does each return come from, how tall is it, and
how much shade is left if every second row is felled?
"""

import numpy as np

import raystream as rs

# A ball of diameter 1, from longitudes and latitudes.
u, v = np.meshgrid(np.linspace(0, 2 * np.pi, 25), np.linspace(0, np.pi, 13))
unit = 0.5 * np.stack([np.cos(u) * np.sin(v), np.sin(u) * np.sin(v), np.cos(v)], axis=-1)
unit = unit.reshape(-1, 3)
corner = (25 * np.arange(12)[:, None] + np.arange(24)).reshape(-1, 1)
faces = (corner + [0, 25, 26, 0, 26, 1]).reshape(-1, 3)

# A tree: a trunk that stops light, and a crown that lets some of it through.
crown = rs.Mesh(4.0 * unit + [0.0, 0.0, 4.0], faces, name="crown", material_ids=0)
trunk = rs.Mesh(unit * [0.6, 0.6, 3.0] + [0.0, 0.0, 1.5], faces, material_ids=1)
materials = [rs.Material("leaves"), rs.Material("wood")]
tree = rs.Scene([crown, trunk], materials=materials)
square = np.array([[-200, -200, 0], [200, -200, 0], [200, 200, 0], [-200, 200, 0]], float)
ground = rs.Scene([rs.Mesh(square, [[0, 1, 2], [0, 2, 3]])], materials=[rs.Material("ground")])

# Rows of trees of different heights, on the ground.
rng = np.random.default_rng(5)
x, y = np.meshgrid(np.arange(40) * 6.0, np.arange(40) * 5.0)
places = np.zeros((1601, 3, 4))
places[:, :, :3] = np.eye(3)
places[:1600, :, :3] *= rng.uniform(0.7, 1.3, 1600)[:, None, None]
places[:1600, 0, 3], places[:1600, 1, 3] = x.ravel(), y.ravel()
scene = rs.Scene.instances([tree, ground], places, [0] * 1600 + [1])
tracer = rs.Tracer(scene)

# Pulses straight down, 4 a square metre; leaves let 40 % of each through.
px, py = np.meshgrid(np.arange(0.0, 234.0, 0.5), np.arange(0.0, 195.0, 0.5))
above = np.stack([px, py, np.full(px.shape, 100.0)], axis=-1)
cloud = rs.lidar_returns(tracer, above, [0.0, 0.0, -1.0], transmission={"leaves": 0.4})
per_tree = np.bincount(cloud.instance_id, minlength=1601)[:1600]
print(f"{len(cloud.ranges):,} returns of {px.size:,} pulses; {np.median(per_tree):.0f} per tree")

# Heights of the trees by their first returns, against what they are.
first = (cloud.return_number == 1) & (cloud.instance_id < 1600)
tops = np.zeros(1601)
np.maximum.at(tops, cloud.instance_id[first], cloud.positions[first, 2])
heights = 6.0 * places[:1600, 2, 2]
print(f"heights are right to within {np.abs(tops[:1600] - heights).max():.2f} m")

# A filter: the shade on the ground if every second row of trees were felled.
on_ground, to_sun = above * [1.0, 1.0, 0.0] + [0.0, 0.0, 0.01], [0.3, 0.2, 1.0]
shade = tracer.any_hit(on_ground, to_sun)
thinned = tracer.any_hit(on_ground, to_sun, on_hit=lambda hit: hit.instance_id // 40 % 2 == 0)
print(
    f"{shade.mean():.0%} of the ground is in shade, {thinned.mean():.0%} without every second row"
)

# The first return of each pulse from above, 100 x 80 m: a colour for each tree, tops brightest.
first = cloud.return_number == 1
colors = np.append(rng.uniform(0.3, 1.0, (1600, 3)), [[0.5, 0.4, 0.3]], axis=0)
image = np.zeros((*px.shape, 3))
columns, rows = (2 * cloud.positions[first, :2]).astype(int).T
shade = 0.2 + cloud.positions[first, 2] / 8
image[rows, columns] = colors[cloud.instance_id[first]] * shade[:, None]
rs.Image(image[:160, :200][::-1].repeat(4, axis=0).repeat(4, axis=1)).save("orchard.png")
print("wrote orchard.png")

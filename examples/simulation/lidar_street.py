"""
LiDAR along a street
====================

A car with a spinning LiDAR drives along a street; its sweeps are joined into a map from above, as
the sensor reports them (top) and with compensation of the motion (bottom).

The check is a façade, which is flat: how thick is it on the map?
"""

import numpy as np

import raystream as rs

# A street along z, 100 m long, with houses on both sides, poles and parked cars; in metres.
corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
faces = np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))])


def box(name, low, size):
    """A box by its lowest corner and its size."""
    return rs.Mesh(corners * size + low, faces, name=name)


rng = np.random.default_rng(3)
meshes = [box("ground", (-20, -0.1, -80), (40, 0.1, 100)), box("right", (6, 0, -80), (8, 9, 100))]
meshes += [  # the houses on the left stand at different distances
    box("house", (-16 + rng.uniform(0, 4), 0, z), (8, rng.uniform(6, 14), 8.5))
    for z in range(-80, 20, 10)
]
meshes += [box("pole", (x, 0, z), (0.2, 6, 0.2)) for x in (-3.6, 3.4) for z in range(-75, 15, 15)]
meshes += [
    box("car", (rng.choice([-3.2, 1.4]), 0.3, z), (1.8, 1.2, 4.2))
    for z in (-58, -46, -33, -21, -12, 3)
]
tracer = rs.Tracer(rs.Scene(meshes))

# The car drives at 8 m/s and swings by 5 degrees to each side.
times = np.linspace(0.0, 5.0, 101)
yaw = np.radians(5.0) * np.sin(2.0 * times)
position = np.stack([0 * times, np.full_like(times, 1.8), -5.0 - 8.0 * times], axis=1)
zero, one = 0 * yaw, 1 + 0 * yaw
rotation = np.array(
    [[np.cos(yaw), zero, np.sin(yaw)], [zero, one, zero], [-np.sin(yaw), zero, np.cos(yaw)]]
).transpose(2, 0, 1)
motion = rs.SensorTrack(times, position, rotation)

# Ten sweeps per second. Each is put on the map by the pose at its end, as a whole.
pattern = rs.sweep_patterns.vlp16(rate=10.0)
raw, compensated, on_facade = [], [], []
for sweep in range(0, 50, 5):
    start = 0.1 * sweep
    cloud = rs.lidar_sweep(tracer, pattern, motion, start=start, t_max=60.0)
    end = start + pattern.times.max()
    pose = motion.at(end)
    on_facade.append((cloud.mesh_id == 1) & (np.abs(cloud.positions[:, 0] - 6.0) < 1e-4))
    raw.append(pose.to_world(cloud.sensor_positions))
    compensated.append(pose.to_world(cloud.deskewed(end)))
    print(f"{start:.1f} s: {len(cloud.ranges):,} returns, {on_facade[-1].sum():,} of the façade")

images, thickness = [], []
on_facade = np.concatenate(on_facade)
for name, clouds in (("as reported", raw), ("compensated", compensated)):
    points = np.concatenate(clouds)
    thickness.append(np.ptp(points[on_facade, 0]))
    print(f"{name}: the façade is {thickness[-1]:.4f} m thick on the map")
    # From above, 10 cm per pixel; higher points are brighter.
    points = points[(np.abs(points[:, 0]) < 15) & (points[:, 2] > -70) & (points[:, 2] < 10)]
    image = np.zeros((800, 300))
    cells = (10 * (points[:, [2, 0]] + [70, 15])).astype(int)
    np.maximum.at(image, tuple(cells.T), np.clip(0.4 + points[:, 1] / 8, 0, 1))
    images.append(image)
assert thickness[1] < 1e-4 < 0.1 < thickness[0]

upper, lower = (np.stack([one.T, one.T**1.5, 0.4 * one.T], axis=-1) for one in images)
rs.Image(np.concatenate([upper, np.full((10, 800, 3), 0.5), lower])).save("lidar_street.png")
print("wrote lidar_street.png")

"""Sweeps of a moving LiDAR, joined into a map: with and without compensation of the motion."""

import numpy as np

import raystream as rs

# A hall, 60 m long, 12 m wide and 5 m high, with four pillars.
corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
faces = np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))])
hall = rs.Mesh(corners * [12, 5, 60] - [6, 0, 60], faces, name="hall")
pillars = [
    rs.Mesh(corners * [0.6, 5, 0.6] + [x, 0, z], faces, name="pillar")
    for x in (-3.3, 2.7)
    for z in (-20, -40)
]
tracer = rs.Tracer(rs.Scene([hall, *pillars]))

# A robot drives along the hall at 8 m/s and looks around at 45 degrees per second.
times = np.linspace(0.0, 5.0, 51)
yaw = np.radians(45.0) * times
position = np.stack([0 * times, np.full_like(times, 1.2), -5.0 - 8.0 * times], axis=1)
zero, one = 0 * yaw, 1 + 0 * yaw
rotation = np.array(
    [[np.cos(yaw), zero, np.sin(yaw)], [zero, one, zero], [-np.sin(yaw), zero, np.cos(yaw)]]
).transpose(2, 0, 1)
motion = rs.SensorTrack(times, position, rotation)

# Ten sweeps per second. Each is put on the map by the pose at its end, as a whole.
pattern = rs.sweep_patterns.vlp16(rate=10.0)
raw, compensated = [], []
for sweep in range(0, 50, 5):
    start = 0.1 * sweep
    cloud = rs.lidar_sweep(tracer, pattern, motion, start=start, t_max=100.0)
    end = start + pattern.times.max()
    pose = motion.at(end)
    on_wall = (cloud.mesh_id == 0) & (np.abs(cloud.positions[:, 0] - 6.0) < 1e-4)
    raw.append(pose.to_world(cloud.sensor_positions[on_wall]))
    compensated.append(pose.to_world(cloud.deskewed(end)[on_wall]))
    print(f"{start:.1f} s: {len(cloud.ranges):,} returns, {on_wall.sum():,} of the right wall")

for name, clouds in (("as reported", raw), ("compensated", compensated)):
    x = np.concatenate(clouds)[:, 0]
    print(f"{name}: the wall at x = 6 m is {np.ptp(x):.4f} m thick on the map")
assert np.ptp(np.concatenate(compensated)[:, 0]) < 1e-4 < 1.0 < np.ptp(np.concatenate(raw)[:, 0])

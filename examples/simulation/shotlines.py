"""
Shotlines through a vehicle
===========================

Which part of a vehicle is vulnerable from which side? A grid of shotlines from each azimuth; a
program at every hit subtracts the steel that a line has penetrated, and stops it at the first
critical component or when its 100 mm are used up.

The check is the presented area: half the sum of the projected faces, since the hull is convex. The
image shows the vehicle at azimuths of 30, 60, 90 and 150 degrees from the front: where lines reach
the engine (red) or the fuel (yellow), are stopped by the hull (grey), or pass through (light grey).
"""

import numpy as np

import raystream as rs

CAPACITY, CELL = 100.0, 20.0  # steel that a line penetrates, and distance of lines; millimetres

corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
faces = np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))])


def block(low, high, slope=0.0):
    """A box; its front, at the large x, leans back by the slope for each unit of height."""
    points = np.array(low) + corners * np.subtract(high, low)
    points[corners[:, 0] == 1, 0] -= slope * (points[corners[:, 0] == 1, 1] - low[1])
    return points


# A hull with 60 mm of steel all around, its front at 60 degrees; two components inside.
SLOPE, WALL = np.tan(np.radians(60.0)), 60.0
outside = block([0, 0, 0], [6000, 1400, 2600], SLOPE)
front = 6000 - WALL / np.cos(np.radians(60.0)) - SLOPE * WALL
inside = block([WALL, WALL, WALL], [front, 1400 - WALL, 2600 - WALL], SLOPE)
hull = rs.Mesh(np.vstack([outside, inside]), np.vstack([faces, 8 + faces[:, ::-1]]), name="hull")
engine = rs.Mesh(block([300, 200, 700], [1500, 900, 1900]), faces, name="engine")
fuel = rs.Mesh(block([1800, 150, 150], [3200, 700, 700]), faces, name="fuel")
tracer = rs.Tracer(rs.Scene([hull, engine, fuel]))

STATE = np.dtype([("left", "f8"), ("entered", "f8"), ("stopped_in", "i4")])


def penetrate(hit, state):
    """Stop in a critical component, or in the hull."""
    if hit.mesh_id > 0:
        state.stopped_in = hit.mesh_id
        return rs.Decision.STOP
    if hit.is_entering:
        state.entered = hit.t
        return rs.Decision.CONTINUE
    state.left -= hit.t - state.entered
    if state.left < 0.0:
        state.stopped_in = 0
        return rs.Decision.STOP
    return rs.Decision.CONTINUE


# Lines on a grid of 7 x 2 m, perpendicular to the line of sight from each azimuth.
across, up = np.meshgrid(np.arange(-3500, 3500, CELL), np.arange(1700, -300, -CELL))
first, second, third = outside[faces].transpose(1, 0, 2)
areas = np.cross(second - first, third - first) / 2
views = []
print("azimuth  presented  engine   fuel (m²)")
for azimuth in range(0, 181, 15):
    turn = np.radians(azimuth)
    way, side = (
        -np.array([np.cos(turn), 0, np.sin(turn)]),
        np.array([np.sin(turn), 0, -np.cos(turn)]),
    )
    grid = [3000, 0, 1300] + across[..., None] * side + up[..., None] * [0, 1, 0] - 9000 * way
    state = np.zeros(across.shape, STATE)
    state["left"], state["stopped_in"] = CAPACITY, -1
    tracer.trace(grid, way, on_hit=penetrate, payload=state, crossings="surfaces")
    is_hit = state["entered"] > 0
    found = (
        1e-6
        * CELL**2
        * np.array([is_hit.sum(), *(np.sum(state["stopped_in"] == k) for k in (1, 2))])
    )
    print(f"{azimuth:6}°  {found[0]:9.2f}  {found[1]:6.2f}  {found[2]:5.2f}")
    assert abs(found[0] / (np.abs(areas @ way).sum() / 2e6) - 1) < 0.02
    if azimuth in (30, 60, 90, 150):
        colors = np.array([[0.4, 0.4, 0.4], [0.8, 0.1, 0.1], [0.9, 0.7, 0.1], [1.0, 1.0, 1.0]])
        view = colors[state["stopped_in"]]  # -1 is the last: nothing
        view[is_hit & (state["stopped_in"] < 0)] = 0.75  # through the hull
        views.append(view)

rows = [np.concatenate(views[k : k + 2], axis=1) for k in (0, 2)]
rs.Image(np.concatenate(rows)).save("shotlines.png")
print("wrote shotlines.png")

"""Scenes whose own lights do not reach what the camera sees."""

from __future__ import annotations

import numpy as np

import raystream as rs


def box(side, center=(0.0, 0.0, 0.0)):
    """A closed box of twelve triangles."""
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = [face for a, b, c, d in quads for face in ((a, b, c), (a, c, d))]
    return rs.Mesh(corners * (side / 2) + center, faces)


def closed_room(**attributes):
    """A room with a block, seen from inside; the sun shines outside."""
    return rs.Scene(
        [box(8.0), box(2.0, (1.0, -3.0, 0.0))],
        lights=[rs.DirectionalLight((0.2, -1.0, 0.1), (3.0, 3.0, 3.0))],
        camera=rs.Camera((-3.5, 0.0, 3.5), (1.0, -2.0, 0.0), fov=70),
        **attributes,
    )


def far_lamp():
    """A long wall, and a lamp that lights its other end only."""
    wall = rs.Mesh([[0, 0, 0], [1000, 0, 0], [1000, 4, 0], [0, 4, 0]], [[0, 1, 2], [0, 2, 3]])
    lamp = rs.PointLight((998.0, 2.0, 0.5), (4000.0, 4000.0, 4000.0))
    return rs.Scene([wall], lights=[lamp], camera=rs.Camera((3, 2, 5), (3, 2, 0)))


def unlit_room():
    """A room without lights: a sun and a sky would stay outside."""
    return closed_room().replace(lights=())


def behind_a_wall():
    """A lamp, which glows, behind a wall between it and what the camera sees."""
    floor = rs.Mesh([[-9, 0, -9], [9, 0, -9], [9, 0, 9], [-9, 0, 9]], [[0, 2, 1], [0, 3, 2]])
    wall = rs.Mesh([[-9, 0, 0], [9, 0, 0], [9, 30, 0], [-9, 30, 0]], [[0, 1, 2], [0, 2, 3]])
    lamp = rs.Mesh([[-1, 2, -3], [1, 2, -3], [0, 2, -5]], [[0, 1, 2]], material_ids=1)
    return rs.Scene(
        [floor, wall, lamp],
        materials=[rs.Material(), rs.Material(emission=(60.0, 60.0, 60.0))],
        camera=rs.Camera((0.0, 3.0, 8.0), (0.0, 0.0, 2.0)),
    )


#: All of them, by name.
DARK_VIEWS = {one.__name__: one for one in (closed_room, far_lamp, unlit_room, behind_a_wall)}

"""Orbits and turns of cameras."""

from __future__ import annotations

import numpy as np

from extras import need

need("raystream_lab")

import raystream as rs
from raystream_lab.cameras import orbit, turn


def test_orbit_keeps_its_distance_and_its_target() -> None:
    camera = rs.Camera((3.0, 2.0, 5.0), (1.0, 0.5, 0.0), fov=30.0)
    away = np.linalg.norm(np.subtract(camera.eye, camera.look_at))
    found = dict(orbit(camera, (0, 1, 0), (0.0, 90.0), (30.0, 60.0), (0.5, 2.0)))
    assert len(found) == 8
    for name, one in found.items():
        offset = np.subtract(one.eye, one.look_at)
        factor = 0.5 if name.endswith("0.5 as far") else 2.0
        rise = np.radians(30.0 if "30° up" in name else 60.0)
        assert one.look_at == camera.look_at
        assert np.isclose(np.linalg.norm(offset), factor * away)
        assert np.isclose(offset[1], factor * away * np.sin(rise))


def test_orbit_begins_above_where_the_camera_stands() -> None:
    camera = rs.Camera((0.0, 0.0, 4.0), (0.0, 0.0, 0.0))
    ((_, one),) = orbit(camera, (0, 1, 0), (0.0,), (0.0,), (1.0,))
    assert np.allclose(one.eye, camera.eye)
    ((_, one),) = orbit(camera, (0, 1, 0), (90.0,), (0.0,), (1.0,))
    assert np.allclose(one.eye, (4.0, 0.0, 0.0))


def test_orbit_from_straight_above() -> None:
    camera = rs.Camera((0.0, 9.0, 0.0), (0.0, 0.0, 0.0), up=(0.0, 0.0, -1.0))
    ((_, one),) = orbit(camera, (0, 1, 0), (0.0,), (45.0,), (1.0,))
    assert np.isclose(one.eye[1], 9.0 * np.sin(np.pi / 4))


def test_turn_looks_around() -> None:
    camera = rs.Camera((1.0, 1.0, 0.0), (1.0, 1.0, -8.0))
    found = list(turn(camera, (0.0, 90.0), (0.0, 0.5)))
    eyes = [one.eye for _, one in found]
    assert np.allclose(eyes, [(1, 1, 0), (1, 1, 0), (1, 1, -4), (1, 1, -4)])
    looking = [np.subtract(one.look_at, one.eye) for _, one in found]
    assert np.allclose(looking, [(0, 0, -8), (-8, 0, 0), (0, 0, -8), (-8, 0, 0)], atol=1e-12)

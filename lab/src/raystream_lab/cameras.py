"""Alternative cameras of a scene, to test how much a result depends on the view."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from raystream.scene.camera import Camera, Vector


def orbit(
    camera: Camera,
    axis: object,
    turns: Sequence[float],
    heights: Sequence[float],
    distances: Sequence[float],
) -> Iterator[tuple[str, Camera]]:
    """Orbit a camera around its target.

    Parameters
    ----------
    camera : Camera
    axis : array_like of shape (3,)
        The world's up direction.
    turns : sequence of float
        Degrees around the axis, relative to the camera.
    heights : sequence of float
        Degrees above the plane perpendicular to the axis.
    distances : sequence of float
        Multiples of the camera's distance.

    Yields
    ------
    str, Camera
        A description of the change, and the camera.
    """
    target, up = np.asarray(camera.look_at, np.float64), _unit(axis)
    away = np.asarray(camera.eye, np.float64) - target
    distance = float(np.linalg.norm(away))
    flat = away - up * float(away @ up)
    if np.linalg.norm(flat) < 1e-6 * distance:  # seen from straight above
        flat = np.cross(up, [1.0, 0.0, 0.0] if abs(up[0]) < 0.9 else [0.0, 0.0, 1.0])
    forward = _unit(flat)
    side = np.cross(up, forward)
    for turn_by in turns:
        angle = math.radians(turn_by)
        across = math.cos(angle) * forward + math.sin(angle) * side
        for height in heights:
            rise = math.radians(height)
            direction = math.cos(rise) * across + math.sin(rise) * up
            for factor in distances:
                eye = target + factor * distance * direction
                name = f"turned {turn_by:g}°, {height:g}° up, {factor:g} as far"
                yield name, dataclasses.replace(camera, eye=_vector(eye))


def turn(
    camera: Camera, turns: Sequence[float], steps: Sequence[float]
) -> Iterator[tuple[str, Camera]]:
    """Turn a camera at its position, and at positions along its view direction.

    Parameters
    ----------
    camera : Camera
    turns : sequence of float
        Degrees around its up direction.
    steps : sequence of float
        How far to move ahead first, as a share of the distance to the target.

    Yields
    ------
    str, Camera
    """
    eye, up = np.asarray(camera.eye, np.float64), _unit(camera.up)
    ahead = np.asarray(camera.look_at, np.float64) - eye
    for step in steps:
        place = eye + step * ahead
        for turn_by in turns:
            angle = math.radians(turn_by)
            looking = (
                ahead * math.cos(angle)
                + np.cross(up, ahead) * math.sin(angle)
                + up * float(up @ ahead) * (1.0 - math.cos(angle))
            )
            target = place + looking
            name = f"{step:g} of the way ahead, turned {turn_by:g}°"
            yield (
                name,
                dataclasses.replace(camera, eye=_vector(place), look_at=_vector(target)),
            )


def _vector(array: NDArray[np.float64]) -> Vector:
    x, y, z = array.tolist()
    return x, y, z


def _unit(vector: object) -> NDArray[np.float64]:
    array = np.asarray(vector, np.float64)
    return array / float(np.linalg.norm(array))

"""Views of a model from outside: which direction shows most of it."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.scene.camera import front_of, three_quarter_view
from raystream.scene.default_view.surface_samples import SurfaceSamples, components, visible

#: Degrees around up, from the front to the right: three-quarter views and straight ones.
_AZIMUTHS = (28.8, 61.2, 90.0, 118.8, 151.2, 180.0, 208.8, 241.2, 270.0, 298.8, 331.2, 0.0)

#: Degrees above the horizon, and the factor by which a view from there is liked. The first view of
#: all is `three_quarter_view`, the preferred one.
_ELEVATIONS = {21.5: 1.0, 50.0: 0.9}

#: Views that are not chosen, but tell whether the model can be seen from below.
_BELOW = -50.0

#: The factor by which a view straight at a side is liked.
_STRAIGHT = 0.95

#: Another direction replaces the preferred one only if it shows more by this factor.
_BETTER = 1.1

#: A sample is outside if this number of views show it; single views err.
_SEEN = 4

#: Cells of the depth image, across and down: some samples for each.
_CELLS = 32, 24

#: A surface whose back is seen counts less: many models have only one side.
_BACK = 0.85

#: Surfaces seen at a smaller cosine than this count less, the smaller the less.
_SLANT = 0.5

#: From the middle of the box to the eye, in halves of its diagonal.
_DISTANCE = 3.5

#: A flat box seen edge-on is drawn as if it had this width.
_THINNEST = 1e-6


class OutsideViews(NamedTuple):
    """What can be seen of a model from around it.

    Attributes
    ----------
    toward_eye : ndarray of shape (3,), float64
        From the model to the camera of the best view, a unit vector.
    worth : float
        Of what that view shows, in [0, 1].
    back : float
        Share of what is seen that is seen from the back, in the view where it is least.
    is_seen : ndarray of shape (S,), bool
        Whether samples are seen in several views.
    """

    toward_eye: NDArray[np.float64]
    worth: float
    back: float
    is_seen: NDArray[np.bool_]


def look_from_outside(
    samples: SurfaceSamples, half: NDArray[np.float64], up: NDArray[np.float64]
) -> OutsideViews:
    """Look at a model from all sides.

    Parameters
    ----------
    samples : SurfaceSamples
    half : ndarray of shape (3,), float64
        The upper corner of their box.
    up : ndarray of shape (3,), float64
        The world's up, a unit vector.
    """
    directions, likings = [], []
    for elevation, liking in _ELEVATIONS.items():
        for azimuth in _AZIMUTHS:
            directions.append(_direction(up, azimuth, elevation))
            likings.append(liking * (_STRAIGHT if azimuth % 90.0 == 0.0 else 1.0))
    directions[0], likings[0] = three_quarter_view(up), _BETTER
    below = [_direction(up, azimuth, _BELOW) for azimuth in _AZIMUTHS[::2]]
    counts = np.zeros(samples.target_count, np.int8)
    scores, backs = [], []
    for direction in directions + below:
        is_seen, worth, back = _look(samples, half, direction, up)
        counts += is_seen
        scores.append(worth)
        backs.append(back)
    # Rounded: the order of samples does not decide between equals.
    best = int(np.argmax(np.round(np.multiply(scores[: len(likings)], likings), 5)))
    return OutsideViews(directions[best], scores[best], min(backs[: len(likings)]), counts >= _SEEN)


def level_front(up: NDArray[np.float64]) -> NDArray[np.float64]:
    """The direction from which models are seen from the front, perpendicular to up."""
    front = front_of(up)
    front = front - (front @ up) * up
    front /= np.linalg.norm(front)
    return front


def _direction(up: NDArray[np.float64], azimuth: float, elevation: float) -> NDArray[np.float64]:
    """Unit vector toward a point on the sky."""
    front = level_front(up)
    right = np.cross(up, front)
    around, above = math.radians(azimuth), math.radians(elevation)
    level = math.cos(around) * front + math.sin(around) * right
    return math.cos(above) * level + math.sin(above) * up


def _look(
    samples: SurfaceSamples,
    half: NDArray[np.float64],
    direction: NDArray[np.float64],
    up: NDArray[np.float64],
) -> tuple[NDArray[np.bool_], float, float]:
    """Which samples are seen from a direction, their worth, and the share seen from the back."""
    across, down = _CELLS
    right = np.cross(up, direction)
    right /= np.linalg.norm(right)
    axes = np.stack([right, np.cross(direction, right), -direction])
    distance = _DISTANCE * float(np.linalg.norm(half))
    offsets = samples.offsets(distance * direction)
    x, y, depth = components(axes, offsets)
    # The box fills the image.
    extents = np.abs(axes) @ half / (distance - np.abs(direction) @ half)
    width, height, _ = np.maximum(extents, _THINNEST)
    column = x / depth * np.float32(0.5 * across / width) + np.float32(0.5 * across)
    row = y / depth * np.float32(0.5 * down / height) + np.float32(0.5 * down)
    cells = row.clip(0, down - 1).astype(np.int32) * across
    cells += column.clip(0, across - 1).astype(np.int32)
    size = 2.0 * float(max(width / across, height / down))
    is_seen, _ = visible(samples, cells, depth, (down, across), size)
    cosines = samples.cosines(offsets)
    is_back = cosines < 0.0
    worths = np.minimum(np.abs(cosines) / _SLANT, 1.0) * np.where(is_back, _BACK, 1.0)
    worth = float(worths[is_seen].sum(dtype=np.float64)) / len(worths)
    return is_seen, worth, float(is_back[is_seen].mean()) if is_seen.any() else 0.0

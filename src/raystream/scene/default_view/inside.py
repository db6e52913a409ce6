"""Views from inside a room: whether there is one, where to stand in it, and where to look."""

from __future__ import annotations

import itertools
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.scene.camera import Camera
from raystream.scene.default_view.outside import OutsideViews, level_front
from raystream.scene.default_view.surface_samples import SurfaceSamples, components, visible

#: Vertical field of view, in degrees.
_FOV = 65.0

#: Where eyes stand, as shares of the box's sides, and the height of the eye as a share of the
#: room's height or of its smaller side, whichever is less.
_PLACES = (0.15, 0.325, 0.5, 0.675, 0.85)
_EYE_HEIGHT, _EYE_WIDTH = 0.5, 0.35

#: Cells of the panorama around an eye: on each side of a square, and the size of one, in radians.
_CELLS = 24
_CELL_SIZE = math.sqrt(4 * math.pi) / _CELLS

#: Views to choose from at an eye: between all sectors around it, a little downward, in degrees.
_SECTORS, _PITCH = 72, -6.0

#: In a room, most directions end at a surface.
_ENCLOSED = 0.75

#: In a room, an eye sees at least this share of the scene that is hidden from outside.
_HIDDEN = 0.05

#: It is a room if that is 0.1, and 0.7 times as much as the best view from outside shows; or if all
#: views from outside show mostly the backs of surfaces, and the eye does not.
_MUCH_HIDDEN, _RATHER_INSIDE = 0.1, 0.7
_MOST_BACKS, _FEW_BACKS = 0.6, 0.3

#: An eye that sees more backs than this is inside something solid.
_SOLID = 0.9

#: An eye keeps this distance from all surfaces, as a share of the room's longest side.
_CLEARANCE = 0.06

#: The order of samples does not decide between equals.
_MORE = 1.0 + 1e-9


class _Panorama(NamedTuple):
    """What an eye sees all around.

    Attributes
    ----------
    is_seen : ndarray of shape (T,), bool
    back : float
        Share of what is seen that is seen from the back.
    distances, azimuths, heights : ndarray of shape (T,), float32
        Distances; radians from the front to the right; sines of the elevation.
    worths : ndarray of shape (T,), float32
        Of the samples in an image: those of slanted surfaces are worth less.
    """

    is_seen: NDArray[np.bool_]
    back: float
    distances: NDArray[np.float32]
    azimuths: NDArray[np.float32]
    heights: NDArray[np.float32]
    worths: NDArray[np.float32]


def look_from_inside(
    samples: SurfaceSamples,
    half: NDArray[np.float64],
    up: NDArray[np.float64],
    outside: OutsideViews,
) -> Camera | None:
    """Find a view from inside, if the scene is a room.

    Parameters
    ----------
    samples : SurfaceSamples
    half : ndarray of shape (3,), float64
        The upper corner of their box.
    up : ndarray of shape (3,), float64
        The world's up, a unit vector.
    outside : OutsideViews

    Returns
    -------
    Camera or None
        In the space of the samples; None if the scene should be seen from outside.
    """
    front = level_front(up)
    axes = np.stack([np.cross(up, front), up, front])
    needed = max(_MUCH_HIDDEN, _RATHER_INSIDE * outside.worth)
    best, best_worth = None, 0.0
    for eye in _eyes(half, axes):
        panorama = _look_around(samples, eye, axes)
        if panorama is None or panorama.back > _SOLID:
            continue
        hidden = np.count_nonzero(panorama.is_seen & ~outside.is_seen) / len(outside.is_seen)
        has_fronts = outside.back >= _MOST_BACKS and panorama.back <= _FEW_BACKS
        if hidden < _HIDDEN or (hidden < needed and not has_fronts):
            continue
        azimuth, worth, distance = _best_view(panorama)
        if worth > best_worth * _MORE:
            best_worth = worth
            pitch = math.radians(_PITCH)
            level = math.sin(azimuth) * axes[0] + math.cos(azimuth) * axes[2]
            ahead = math.cos(pitch) * level + math.sin(pitch) * up
            best = Camera(tuple(eye), tuple(eye + distance * ahead), tuple(up), _FOV)
    return best


def _eyes(half: NDArray[np.float64], axes: NDArray[np.float64]) -> list[NDArray[np.float64]]:
    """Points at eye height, spread over the floor of a box."""
    width, height, depth = np.abs(axes) @ half
    level = min(2 * _EYE_HEIGHT * height, 2 * _EYE_WIDTH * min(width, depth)) - height
    return [
        axes.T @ (width * (2 * a - 1), level, depth * (2 * b - 1))
        for a, b in itertools.product(_PLACES, _PLACES)
    ]


def _look_around(
    samples: SurfaceSamples, eye: NDArray[np.float64], axes: NDArray[np.float64]
) -> _Panorama | None:
    """The panorama of an eye; None if it is not in a room, or close to something."""
    offsets = samples.offsets(eye)
    distances = np.sqrt(np.einsum("ij,ij->j", offsets, offsets))
    if distances.min() < _CLEARANCE:
        return None
    cells, shape = _octahedron_cells(offsets), (_CELLS, _CELLS)
    is_seen, nearest = visible(samples, cells, distances, shape, _CELL_SIZE)
    if np.count_nonzero(np.isfinite(nearest)) < _ENCLOSED * _CELLS**2:
        return None
    right, above, front = components(axes, offsets[:, : samples.target_count])
    distances = distances[: samples.target_count]
    cosines = samples.cosines(offsets)
    return _Panorama(
        is_seen,
        float((is_seen & (cosines < 0)).sum() / max(is_seen.sum(), 1)),
        distances,
        np.arctan2(right, front),
        above / distances,
        np.minimum(2 * np.abs(cosines), 1),
    )


def _octahedron_cells(vectors: NDArray[np.float32]) -> NDArray[np.int32]:
    """Cells of a panorama unfolded from an octahedron: of similar size everywhere.

    References
    ----------
    Cigolle et al., "A Survey of Efficient Representations for Independent Unit Vectors", JCGT
    3(2), 2014.
    """
    x, y, z = vectors
    scale = 1 / (np.abs(x) + np.abs(y) + np.abs(z))
    x, y = x * scale, y * scale
    is_below = z < 0
    across = np.where(is_below, np.copysign(1 - np.abs(y), x), x)
    along = np.where(is_below, np.copysign(1 - np.abs(x), y), y)
    half = np.float32(0.5 * _CELLS)
    column = ((across + 1) * half).clip(0, _CELLS - 1).astype(np.int32)
    row = ((along + 1) * half).clip(0, _CELLS - 1).astype(np.int32)
    return row * _CELLS + column


def _best_view(panorama: _Panorama) -> tuple[float, float, float]:
    """Azimuth of the view that shows most, how much that is, and the distance to look at."""
    half_width = math.atan(4 / 3 * math.tan(math.radians(_FOV) / 2))
    lowest, highest = (math.sin(math.radians(_PITCH + sign * _FOV / 2)) for sign in (-1.0, 1.0))
    is_level = (panorama.heights > lowest) & (panorama.heights < highest)
    worths = np.where(panorama.is_seen & is_level, panorama.worths, 0)
    turns = panorama.azimuths * np.float32(0.5 / math.pi) + np.float32(0.5)
    sectors = (turns * _SECTORS).astype(np.int64) % _SECTORS
    # Sums over the width of the image, around the beginning of each sector.
    reach = round(half_width / (2 * math.pi) * _SECTORS)
    shown, lengths = (
        np.sum([np.roll(total, shift) for shift in range(1 - reach, reach + 1)], axis=0)
        for total in (
            np.bincount(sectors, weights, _SECTORS)
            for weights in (worths, worths * panorama.distances)
        )
    )
    best = int(np.argmax(np.round(shown, 6)))
    worth = float(shown[best])
    distance = float(lengths[best]) / worth if worth > 0.0 else 1.0
    return 2 * math.pi * (best / _SECTORS - 0.5), worth, distance

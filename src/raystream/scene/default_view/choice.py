"""choose_view: the view of a scene that has no camera."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from raystream.core.triangles import Triangles
from raystream.scene.camera import FOV, Camera, frame_points, three_quarter_view
from raystream.scene.default_view.bulk import find_bulk
from raystream.scene.default_view.inside import look_from_inside
from raystream.scene.default_view.outline import outline_points
from raystream.scene.default_view.outside import look_from_outside
from raystream.scene.default_view.sizes import measure
from raystream.scene.default_view.surface_samples import sample_surfaces


@dataclass(frozen=True)
class DefaultView:
    """A view that does not depend on the shape of the image.

    Attributes
    ----------
    points : ndarray of shape (K, 3), float64
        To be framed, world space.
    center : ndarray of shape (3,), float64
        To look at.
    toward_eye : ndarray of shape (3,), float64
        From there to the camera, a unit vector.
    up : ndarray of shape (3,), float64
    inside : Camera or None
        Replaces the others in a room.
    """

    points: NDArray[np.float64]
    center: NDArray[np.float64]
    toward_eye: NDArray[np.float64]
    up: NDArray[np.float64]
    inside: Camera | None = None

    def camera(self, aspect: float) -> Camera:
        """The camera for an image, given its width divided by its height."""
        if self.inside is not None:
            return self.inside
        return frame_points(self.points, self.center, self.toward_eye, self.up, aspect=aspect)


def choose_view(triangles: Triangles, up: NDArray[np.float64]) -> DefaultView:
    """Choose a view that shows a scene's bulk, from its best side, or a room from inside.

    Parameters
    ----------
    triangles : Triangles
    up : ndarray of shape (3,), float64
        The world's up, a unit vector.

    Returns
    -------
    DefaultView
        The same for all orders of the triangles, unless two views are equally good.
    """
    if not len(triangles.prim_ids):
        low, high = triangles.world_bounds
        return DefaultView(np.stack([low, high]), (low + high) / 2, three_quarter_view(up), up)
    was_released = not triangles.has_corners
    sizes = measure(triangles)
    bulk, box = find_bulk(sizes, up)
    samples = sample_surfaces(triangles, sizes, bulk, box)
    if was_released:
        triangles.release()
    low, high = triangles.to_world(box)
    size = (high - low).max()
    half = (high - low) / (2 * size)
    seen = look_from_outside(samples, half, up)
    inside = look_from_inside(samples, half, up, seen)
    if inside is not None:
        middle = (low + high) / 2
        eye, look_at = (middle + size * np.asarray(at) for at in (inside.eye, inside.look_at))
        inside = replace(inside, eye=tuple(eye), look_at=tuple(look_at))
    points = np.stack([low, high])
    if inside is None:
        found = outline_points(sizes, bulk, box, seen.toward_eye, up, FOV)
        points = triangles.to_world(found) if len(found) else points
    return DefaultView(points, low + (high - low) / 2, seen.toward_eye, up, inside)

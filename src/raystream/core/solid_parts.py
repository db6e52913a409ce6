"""SolidPart: triangles of a scene in one frame, as inside tests and winding numbers take them."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray


class SolidPart(NamedTuple):
    """Triangles that a scene has at one place.

    Attributes
    ----------
    triangles : Triangles
        With corners in float32, or in float64.
    first_mesh : int
        The scene's mesh that their first one is.
    inverse : ndarray of shape (3, 4), or None
        World space to the space of the triangles, if that is another one.
    box : ndarray of shape (2, 3), or None
        Holds all that a closed surface surrounds, world space.
    open_kind : str, or None
        What it is, if that is open by its nature.
    """

    triangles: Any
    first_mesh: int = 0
    inverse: NDArray[np.float64] | None = None
    box: NDArray[np.float64] | None = None
    open_kind: str | None = None

    def moved(self, points: NDArray[np.generic]) -> NDArray[np.generic]:
        """World points of shape (N, 3) in the space of the triangles."""
        if self.inverse is None:
            return points
        linear, shift = self.inverse[:, :3], self.inverse[:, 3]
        moved: NDArray[np.float64] = points.astype(np.float64) @ linear.T + shift
        return moved

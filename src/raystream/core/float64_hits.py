"""Float64Hits and Float64MultiHits: what the queries return with ``precision="float64"``."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raystream.core.hits import HitColumns, Hits, MultiHits

_UNIT = 2.0**-53

#: Rounding of positions, in units of `_UNIT`: three products and sums of numbers of the triangle's
#: size, and twice the position's own; doubled as a margin, and for the normal's rounding.
_SIZE_UNITS, _REACH_UNITS = 24.0, 8.0


class _Float64Columns(HitColumns):
    """Columns of hits in float64: ``t``, ``u`` and ``v`` are float64, and so are the normals."""

    @cached_property
    def normals(self) -> NDArray[np.float64]:  # type: ignore[override]
        """Unit normals of the triangles' planes, shape (..., 3), float64; a miss has NaN.

        See `Hits.normals`.
        """
        return self._local_normals()

    def spawn(self, directions: Any) -> tuple[NDArray[np.float64], NDArray[Any]]:
        """Make rays that leave the surfaces hit; see `Hits.spawn`.

        The origins lie off the triangles' planes by a bound of the rounding of float64: about
        2**-49 of the triangle's size and of the distance from the world's origin.
        """
        array = self._directions(directions)
        corners, positions = self._corners(), self.positions
        size = (corners.max(axis=-2) - corners.min(axis=-2)).max(axis=-1)
        reach = np.abs(corners).max(axis=(-2, -1))
        offset = _UNIT * (_SIZE_UNITS * size + _REACH_UNITS * reach)
        away = np.sign(np.einsum("...k,...k->...", self.normals, array))
        away = np.where(away == 0.0, 1.0, away)
        return positions + (away * offset)[..., None] * self.normals, array


class Float64Hits(_Float64Columns, Hits):
    """`Hits` whose ``t``, ``u``, ``v`` and ``normals`` are float64."""


class Float64MultiHits(_Float64Columns, MultiHits):
    """`MultiHits` whose ``t``, ``u``, ``v`` and ``normals`` are float64."""

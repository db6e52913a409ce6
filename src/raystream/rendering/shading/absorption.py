"""What is left of light inside of a material that absorbs: the law of Beer and Lambert."""

from __future__ import annotations

import numpy as np

from raystream.jit.cpu import device
from raystream.jit.simd import exponential, select
from raystream.rendering.shading.points import material_color
from raystream.rendering.shading.tables import COLUMNS

__all__ = ["transmittance"]

_ABSORPTION = np.int32(COLUMNS.absorption)
_NULL = np.float32(0.0)


@device
def transmittance(tables, point, distance):
    """The share of light, by colour, that is left of a ray where it meets a surface.

    Parameters
    ----------
    tables : SceneTables
    point : Point
        Where it meets it, or 16 of them: inside is where it comes to the surface from behind.
    distance : float64, or f32x16
        What the ray has gone, in world lengths.
    """
    red, green, blue = material_color(tables, point.material, _ABSORPTION)
    inside = select(point.is_front, _NULL, distance)
    return exponential(-red * inside), exponential(-green * inside), exponential(-blue * inside)

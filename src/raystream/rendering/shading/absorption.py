"""Absorption inside materials: the Beer-Lambert law."""

from __future__ import annotations

import numpy as np

from raystream.jit.cpu import device
from raystream.jit.simd import exponential, select
from raystream.rendering.shading.material_values import material_color
from raystream.rendering.shading.tables import COLUMNS

_ABSORPTION = np.int32(COLUMNS.absorption)
_NULL = np.float32(0.0)


@device
def transmittance(tables, point, distance):
    """Transmittance, by channel, of the medium that a ray crossed before its hit.

    Parameters
    ----------
    tables : SceneTables
    point : Point
        The hit, or 16 of them: the ray was inside if it hits the back.
    distance : float64, or f32x16
        Length of the ray, world units.
    """
    red, green, blue = material_color(tables, point.material, _ABSORPTION)
    inside = select(point.is_front, _NULL, distance)
    return exponential(-red * inside), exponential(-green * inside), exponential(-blue * inside)

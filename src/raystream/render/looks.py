"""Looks: the materials of a scene as arrays, for shading many points at once."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from raystream.render.texturing import MaterialColors
from raystream.scene.material import Material

__all__ = ["Looks"]


class Looks:
    """What shading wants to know of materials, by material id.

    Parameters
    ----------
    materials : sequence of Material

    Attributes
    ----------
    diffuse, specular, emission : MaterialColors
    shininess : ndarray of shape (M, 1), float32
        Phong exponents, at least 1.
    """

    def __init__(self, materials: Sequence[Material]) -> None:
        self.diffuse = MaterialColors(materials, "diffuse")
        self.specular = MaterialColors(materials, "specular")
        self.emission = MaterialColors(materials, "emission")
        shininess = [[max(material.shininess, 1.0)] for material in materials]
        self.shininess: NDArray[np.float32] = np.array(shininess, np.float32)

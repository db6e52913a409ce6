"""Lights: point, directional, environment, and area lights made of emissive triangles."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from raystream.scene.material import Color

__all__ = ["AreaLight", "DirectionalLight", "EnvironmentLight", "Light", "PointLight"]

Vector = tuple[float, float, float]


def _vector(name: str, value: object) -> Vector:
    vector = tuple(float(c) for c in np.asarray(value, np.float64).ravel())
    if len(vector) != 3 or not all(map(math.isfinite, vector)):
        raise ValueError(f"{name}: expected three finite numbers, got {value}")
    return vector


@dataclass(frozen=True)
class PointLight:
    """Light from a point, equal in all directions.

    Parameters
    ----------
    position : Vector
        World space.
    intensity : Color
        Radiant intensity, linear RGB: at distance r a facing surface receives
        ``intensity / r**2``. With ``falloff="none"`` it receives ``pi * intensity`` at any
        distance: a white matte surface then shows just `intensity`, as the Neutral File
        Format and the classic graphics pipelines have it.
    falloff : {"inverse_square", "none"}
    """

    position: Vector
    intensity: Color = (1.0, 1.0, 1.0)
    falloff: Literal["inverse_square", "none"] = "inverse_square"

    def __post_init__(self) -> None:
        object.__setattr__(self, "position", _vector("position", self.position))
        object.__setattr__(self, "intensity", _vector("intensity", self.intensity))
        if self.falloff not in ("inverse_square", "none"):
            raise ValueError(f"falloff: expected 'inverse_square' or 'none', got {self.falloff!r}")


@dataclass(frozen=True)
class DirectionalLight:
    """Parallel light, as from the sun.

    Parameters
    ----------
    direction : Vector
        Where the light travels to; need not be unit length.
    irradiance : Color
        What a facing surface receives, linear RGB.
    """

    direction: Vector
    irradiance: Color = (1.0, 1.0, 1.0)

    def __post_init__(self) -> None:
        object.__setattr__(self, "direction", _vector("direction", self.direction))
        object.__setattr__(self, "irradiance", _vector("irradiance", self.irradiance))
        if not any(self.direction):
            raise ValueError("direction: must not be zero")


@dataclass(frozen=True)
class EnvironmentLight:
    """Light of one radiance from every direction that no surface blocks.

    Parameters
    ----------
    radiance : Color
        Linear RGB.
    """

    radiance: Color = (1.0, 1.0, 1.0)

    def __post_init__(self) -> None:
        object.__setattr__(self, "radiance", _vector("radiance", self.radiance))


@dataclass(frozen=True, eq=False)
class AreaLight:
    """Emissive triangles of one mesh and one material; :attr:`Scene.area_lights` makes them.

    Parameters
    ----------
    mesh_id : int
        The mesh that holds the triangles.
    prim_ids : ndarray of shape (K,), int32
        The triangles, counted over the whole scene.
    radiance : Color
        What each front side emits, linear RGB.
    """

    mesh_id: int
    prim_ids: NDArray[np.int32]
    radiance: Color


Light = PointLight | DirectionalLight | EnvironmentLight

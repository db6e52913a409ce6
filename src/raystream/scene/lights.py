"""Lights: points, spots, directions, environments, and area lights of emissive triangles."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from os import PathLike
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from raystream.core.checks import check_finite
from raystream.scene.material import Color

Vector = tuple[float, float, float]


def _vector(name: str, value: object) -> Vector:
    vector = tuple(float(c) for c in np.asarray(value, np.float64).ravel())
    if len(vector) != 3 or not all(map(math.isfinite, vector)):
        raise ValueError(f"{name}: expected three finite numbers, got {value}")
    return vector


@dataclass(frozen=True)
class PointLight:
    """Isotropic light from a point.

    Parameters
    ----------
    position : Vector
        World space.
    intensity : Color
        Radiant intensity, linear RGB: at distance r the irradiance of a facing surface is
        ``intensity / r**2``. With ``falloff="none"`` it is ``pi * intensity`` at any distance:
        a white matte surface then has the radiance `intensity`, as in the Neutral File Format
        and the classic graphics pipelines.
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
class SpotLight:
    """Light from a point into a cone, with inverse-square falloff.

    Between the two angles it fades as ``KHR_lights_punctual`` of glTF suggests: with the square
    of a linear function of the cosine, from 1 to 0.

    Parameters
    ----------
    position : Vector
        World space.
    direction : Vector
        The cone's axis, away from the light; need not be unit length.
    intensity : Color
        Radiant intensity inside `inner_angle`, linear RGB.
    inner_angle, outer_angle : float
        Angles between the axis and the directions at which the light begins to fade and at which
        it ends, in degrees; 0 <= inner < outer <= 90.
    """

    position: Vector
    direction: Vector
    intensity: Color = (1.0, 1.0, 1.0)
    inner_angle: float = 0.0
    outer_angle: float = 45.0

    def __post_init__(self) -> None:
        for name in ("position", "direction", "intensity"):
            object.__setattr__(self, name, _vector(name, getattr(self, name)))
        if not any(self.direction):
            raise ValueError("direction: must not be zero")
        if not 0.0 <= self.inner_angle < self.outer_angle <= 90.0:
            raise ValueError(
                "inner_angle, outer_angle: expected 0 <= inner < outer <= 90 degrees, got "
                f"{self.inner_angle} and {self.outer_angle}"
            )

    @property
    def fading(self) -> tuple[float, float]:
        """Scale and offset of the cosine: the intensity's factor is their clamped sum, squared."""
        inner, outer = (math.cos(math.radians(a)) for a in (self.inner_angle, self.outer_angle))
        scale = 1.0 / max(0.001, inner - outer)
        return scale, -outer * scale


@dataclass(frozen=True)
class DirectionalLight:
    """Parallel light, as from the sun.

    Parameters
    ----------
    direction : Vector
        Direction in which the light travels; need not be unit length.
    irradiance : Color
        Irradiance of a facing surface, linear RGB.
    """

    direction: Vector
    irradiance: Color = (1.0, 1.0, 1.0)

    def __post_init__(self) -> None:
        object.__setattr__(self, "direction", _vector("direction", self.direction))
        object.__setattr__(self, "irradiance", _vector("irradiance", self.irradiance))
        if not any(self.direction):
            raise ValueError("direction: must not be zero")


@dataclass(frozen=True, eq=False)
class EnvironmentLight:
    """Light from every direction: of constant radiance, or an environment map.

    The map is equirectangular: its top row is around `up`, its bottom row around the opposite
    direction, and its columns span 360 degrees. Without rotation, the column a quarter of the
    width to the right of the centre is at the world's +x (projected perpendicular to `up`; +z if
    `up` is along x), and the centre is at the cross product of `up` and that axis: at -z if y is
    up, at +y if z is up. An equirectangular camera that looks there renders the same image. Texels
    are interpolated bilinearly. A scene may have one such light.

    Parameters
    ----------
    radiance : Color
        Linear RGB; multiplied by the image, if there is one.
    image : path, or array_like of shape (H, W, 3), float, optional
        Linear radiance, or a file, read on first use: ``.hdr`` (Radiance) and ``.exr``
        hold radiance, ``.png``, ``.jpg`` and ``.jpeg`` are decoded from sRGB.
    up : Vector
        World direction at the top of the image; need not be unit length.
    rotation : float
        Rotation of the image about `up` in degrees, counterclockwise as seen from above.

    Raises
    ------
    ValueError
        If a number is not finite, `up` is zero, or texels are negative or of the wrong shape.
    """

    radiance: Color = (1.0, 1.0, 1.0)
    image: Path | NDArray[np.float32] | None = field(default=None, repr=False)
    up: Vector = (0.0, 1.0, 0.0)
    rotation: float = 0.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "radiance", _vector("radiance", self.radiance))
        object.__setattr__(self, "up", _vector("up", self.up))
        object.__setattr__(self, "rotation", float(self.rotation))
        if not any(self.up):
            raise ValueError("up: must not be zero")
        check_finite("rotation", self.rotation)
        if isinstance(self.image, str | PathLike):
            object.__setattr__(self, "image", Path(self.image))
        elif self.image is not None:
            with np.errstate(over="ignore"):
                texels = np.array(self.image, np.float32)
            fault = texel_fault(texels)
            if fault:
                raise ValueError(f"image: {fault}")
            texels.setflags(write=False)
            object.__setattr__(self, "image", texels)


def texel_fault(texels: NDArray[np.float32]) -> str:
    """Say why an array is not a map of radiance; empty if it is one."""
    if texels.ndim != 3 or texels.shape[2] != 3 or 0 in texels.shape:
        return f"expected shape (H, W, 3), got {texels.shape}"
    lowest, highest = float(texels.min()), float(texels.max())
    if not (lowest >= 0.0 and highest < math.inf):  # NaN is neither
        return f"expected finite radiance of at least 0, got {lowest:g} to {highest:g}"
    return ""


@dataclass(frozen=True, eq=False)
class AreaLight:
    """Emissive triangles of one mesh and one material; see :attr:`Scene.area_lights`.

    Parameters
    ----------
    mesh_id : int
        The mesh that holds the triangles.
    prim_ids : ndarray of shape (K,), int32
        The triangles, counted over the whole scene.
    radiance : Color
        Radiance emitted by the front sides, linear RGB.
    """

    mesh_id: int
    prim_ids: NDArray[np.int32]
    radiance: Color


Light = PointLight | SpotLight | DirectionalLight | EnvironmentLight

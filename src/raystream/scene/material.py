"""Material and Texture: how a surface looks, kept as read for the renderers."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from raystream.scene.texture import Texture

__all__ = ["Color", "Material"]

Color = tuple[float, float, float]

_COLORS = ("diffuse", "specular", "reflection", "transmission", "emission")


@dataclass(frozen=True)
class Material:
    """The looks of a surface, in the terms that MTL, glTF and BART share.

    Colours are linear RGB. Renderers use what they know and leave the rest.

    Parameters
    ----------
    name : str
        For people; need not be unique.
    diffuse : Color
        Diffuse reflectance (MTL ``Kd``, glTF base colour).
    specular : Color
        Reflectance of the glossy highlight (MTL ``Ks``).
    shininess : float
        Phong exponent of the highlight (MTL ``Ns``).
    reflection : Color
        Mirror reflectance, for reflected rays.
    transmission : Color
        Transmittance, for refracted rays (MTL ``Tf``, BART ``T``).
    ior : float
        Index of refraction (MTL ``Ni``).
    emission : Color
        Radiance that the front side emits (MTL ``Ke``); non-zero makes area lights.
    opacity : float
        1 is solid, 0 is invisible (MTL ``d``, glTF alpha); times the texture ``"opacity"``. It
        is the share of rays for which there is a surface at all.
    roughness, metallic : float or None
        glTF's parameters; None where the file gave none.
    double_sided : bool
        False when only the front is to be seen (glTF); tracing hits both sides.
    textures : mapping of str to Texture
        By role: ``"diffuse"``, ``"specular"``, ``"emission"``, ``"opacity"``, ``"bump"``,
        ``"normal"``, ``"metallic_roughness"``, ``"occlusion"``. Of one for opacity the alpha
        channel counts, or how light it is if it has none, or one that is 1 everywhere.
        Occlusion is not used: what is in the way of light, rays find out.
    normal_scale : float
        Factor of a normal map's x and y: 0 is flat, negative ones swap bumps and dents.
    bump_scale : float
        Height of white over black in a bump map, in texels: 1 is as steep as 45 degrees where
        white is beside black. Negative ones swap bumps and dents.
    alpha_cutoff : float, optional
        Where the opacity is at least this, the surface is solid, and elsewhere there is none
        (glTF's ``MASK``); without, it may be partly clear.
    absorption : Color
        What rays lose behind the surface: of a world length d, exp(-absorption d) is left
        (law of Beer and Lambert). It counts where a ray meets the surface from its back, so
        meshes should be closed.
    """

    name: str = ""
    diffuse: Color = (0.8, 0.8, 0.8)
    specular: Color = (0.0, 0.0, 0.0)
    shininess: float = 0.0
    reflection: Color = (0.0, 0.0, 0.0)
    transmission: Color = (0.0, 0.0, 0.0)
    ior: float = 1.0
    emission: Color = (0.0, 0.0, 0.0)
    opacity: float = 1.0
    roughness: float | None = None
    metallic: float | None = None
    double_sided: bool = True
    textures: Mapping[str, Texture] = field(default_factory=dict)
    normal_scale: float = 1.0
    bump_scale: float = 1.0
    alpha_cutoff: float | None = None
    absorption: Color = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        for name in (*_COLORS, "absorption"):
            color = tuple(float(c) for c in getattr(self, name))
            if len(color) != 3 or not all(math.isfinite(c) and c >= 0.0 for c in color):
                raise ValueError(f"{name}: expected three finite numbers >= 0, got {color}")
            object.__setattr__(self, name, color)
        for name in ("shininess", "ior", "opacity", "normal_scale", "bump_scale", "alpha_cutoff"):
            value = getattr(self, name)
            if not (math.isfinite(value) if value is not None else name == "alpha_cutoff"):
                raise ValueError(f"{name}: expected a finite number, got {value}")

    @property
    def emits(self) -> bool:
        """Whether triangles of this material are lights."""
        return any(c > 0.0 for c in self.emission)

    @property
    def is_opaque(self) -> bool:
        """Whether every ray that meets the surface finds it there."""
        least = 1.0 if self.alpha_cutoff is None else self.alpha_cutoff
        return "opacity" not in self.textures and self.opacity >= least

"""Material: the appearance of a surface."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from raystream.scene.texture import Texture

Color = tuple[float, float, float]

_COLORS = ("diffuse", "specular", "reflection", "transmission", "emission")
_NUMBERS = (
    "shininess",
    "ior",
    "opacity",
    "grazing_reflectance",
    "normal_scale",
    "bump_scale",
    "clearcoat",
    "clearcoat_roughness",
    "clearcoat_normal_scale",
    "sheen_roughness",
    "alpha_cutoff",
)


@dataclass(frozen=True)
class Material:
    """The appearance of a surface, in the terms that MTL, glTF and BART share.

    Colours are linear RGB. Renderers ignore parameters that they do not support.

    Parameters
    ----------
    name : str
        Label; need not be unique.
    diffuse : Color
        Diffuse reflectance (MTL ``Kd``, glTF base colour).
    specular : Color
        Reflectance of the glossy highlight (MTL ``Ks``).
    shininess : float
        Phong exponent of the highlight (MTL ``Ns``).
    reflection : Color
        Mirror reflectance, for reflected rays.
    transmission : Color
        Transmittance, for refracted rays (MTL ``Tf``, BART ``T``). With `roughness` it is a part
        of `diffuse`, as in glTF: only the rest is scattered, and metal transmits nothing. It is
        multiplied by the red channel of the texture ``"transmission"``.
    ior : float
        Index of refraction (MTL ``Ni``).
    emission : Color
        Radiance that the front side emits (MTL ``Ke``); if it is not zero, the triangles are area
        lights.
    opacity : float
        1 is solid, 0 is invisible (MTL ``d``, glTF alpha); multiplied by the texture
        ``"opacity"``. It is the fraction of an image's rays that see the surface. Analyses such as
        `lidar_returns` see it where this is at least a half; queries of a `Tracer` always do.
    roughness, metallic : float or None
        glTF's parameters; None if the file has none.
    normal_reflectance : Color
        With `roughness`, reflectance of non-metals at normal incidence; multiplied by the texture
        ``"specular"`` and by the red channel of ``"reflectance"`` [default: that of an index of
        refraction of 1.5].
    grazing_reflectance : float
        With `roughness`, the same at grazing incidence; multiplied by the red channel of
        ``"reflectance"``.
    double_sided : bool
        False if only the front is visible (glTF); tracing hits both sides.
    textures : mapping of str to Texture
        By role: ``"diffuse"``, ``"specular"``, ``"emission"``, ``"opacity"``, ``"bump"``,
        ``"normal"``, ``"metallic_roughness"``, ``"reflectance"``, ``"transmission"``,
        ``"occlusion"``, and those of the coat and the sheen. Opacity is read from the alpha
        channel, or from the luminance if alpha is missing or 1 everywhere. Occlusion is not used:
        rays compute it.
    normal_scale : float
        Factor of a normal map's x and y: 0 is flat, negative swaps bumps and dents.
    bump_scale : float
        Height of white over black in a bump map, in texels: 1 is a slope of 45 degrees where
        white is next to black. Negative swaps bumps and dents.
    alpha_cutoff : float, optional
        The surface is solid where the opacity is at least this, and absent elsewhere (glTF's
        ``MASK``) [default: partial opacity].
    absorption : Color
        Absorption coefficient of the volume behind the surface: exp(-absorption d) is transmitted
        over a length d in world units (Beer-Lambert law). It applies where a ray hits the surface
        from behind, so meshes should be closed.
    clearcoat, clearcoat_roughness : float
        With `roughness`, the strength from 0 to 1 of a clear coat on both sides of the surface,
        with an index of refraction of 1.5, and its roughness; multiplied by the red channel of the
        texture ``"clearcoat"`` and the green channel of ``"clearcoat_roughness"``. The coat does
        not dim the light that the surface emits.
    clearcoat_normal_scale : float
        As `normal_scale`, for ``"clearcoat_normal"``: the coat does not use ``"normal"``.
    sheen_color : Color
        With `roughness`, colour of a layer of fibres, as on velvet, above the surface and below
        the coat; at most 1, and multiplied by the texture ``"sheen_color"``.
    sheen_roughness : float
        From 0, where only the silhouette shines, to 1; multiplied by the texture
        ``"sheen_roughness"``, which has one channel.
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
    normal_reflectance: Color = (0.04, 0.04, 0.04)
    grazing_reflectance: float = 1.0
    double_sided: bool = True
    textures: Mapping[str, Texture] = field(default_factory=dict)
    normal_scale: float = 1.0
    bump_scale: float = 1.0
    alpha_cutoff: float | None = None
    absorption: Color = (0.0, 0.0, 0.0)
    clearcoat: float = 0.0
    clearcoat_roughness: float = 0.0
    clearcoat_normal_scale: float = 1.0
    sheen_color: Color = (0.0, 0.0, 0.0)
    sheen_roughness: float = 0.0

    def __post_init__(self) -> None:
        for name in (*_COLORS, "normal_reflectance", "sheen_color", "absorption"):
            color = tuple(map(float, getattr(self, name)))
            if len(color) != 3 or not (min(color) >= 0.0 and all(map(math.isfinite, color))):
                raise ValueError(f"{name}: expected three finite numbers >= 0, got {color}")
            object.__setattr__(self, name, color)
        for name in _NUMBERS:
            value = getattr(self, name)
            if not (math.isfinite(value) if value is not None else name == "alpha_cutoff"):
                raise ValueError(f"{name}: expected a finite number, got {value}")

    @property
    def emits(self) -> bool:
        """Whether triangles of this material are lights."""
        return any(c > 0.0 for c in self.emission)

    @property
    def is_coated(self) -> bool:
        """Whether there is a clear coat."""
        return self.roughness is not None and self.clearcoat > 0.0

    @property
    def has_sheen(self) -> bool:
        """Whether the surface has a sheen."""
        return self.roughness is not None and any(self.sheen_color)

    @property
    def is_opaque(self) -> bool:
        """Whether every ray that reaches the surface hits it."""
        least = 1.0 if self.alpha_cutoff is None else self.alpha_cutoff
        return "opacity" not in self.textures and self.opacity >= least

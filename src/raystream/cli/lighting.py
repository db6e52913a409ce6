"""Lighting on the command line: a sun, environment maps, and an extra light for dim scenes."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from raystream.cli import options
from raystream.cli.console import BadInputError

if TYPE_CHECKING:
    from raystream.scene.lights import Light
    from raystream.scene.scene import Scene

#: The library's extensions, for help; a test compares them.
SUFFIXES = (".hdr", ".exr", ".png", ".jpg", ".jpeg")


def _sun(value: tuple[float, float] | None) -> tuple[float, float] | None:
    """Accept the place of a sun above the horizon, or an omitted option."""
    if value is None:
        return None
    azimuth, elevation = value
    if not math.isfinite(azimuth):
        raise typer.BadParameter(f"expected a finite azimuth, got {azimuth}")
    if not 0.0 < elevation <= 90.0:
        raise typer.BadParameter(
            f"expected an elevation above 0 and at most 90 degrees, got {elevation:g}"
        )
    return value


@dataclass(frozen=True)
class LightingOptions:
    """Options of a scene's lighting."""

    sun: Annotated[
        tuple[float, float] | None,
        typer.Option(
            metavar="AZIMUTH ELEVATION",
            callback=_sun,
            help="A sun and a clear sky instead of the scene's: degrees from north (-z, or +y if z "
            "is up) towards east (+x), and above the horizon.",
        ),
    ] = None
    environment: Annotated[
        Path | None,
        options.value(
            "FILE",
            "An equirectangular map (.hdr, .exr, .png or .jpg) instead of the scene's sky; "
            "its top is up.",
        ),
    ] = None
    environment_rotation: Annotated[
        float | None,
        options.number("DEGREES", "Rotation of the map, counterclockwise as seen from above."),
    ] = None
    lights: Annotated[
        str | None,
        options.choice(
            options.LIGHTS,
            "file: the scene's own lights only; added: also a sun and a sky, or a light at the "
            "eye; auto: these only if the scene's own lights show nothing [default: auto]",
        ),
    ] = None

    @property
    def has_sky(self) -> bool:
        """Whether `apply` changes scenes."""
        return self.environment is not None or self.sun is not None

    def check(self) -> None:
        """Check the map's extension, and reject two skies and a rotation without a map."""
        if self.sun is not None and self.environment is not None:
            raise BadInputError("--sun: cannot be combined with --environment")
        if self.environment is not None:
            options.check_suffix(self.environment, SUFFIXES, "reading")
        elif self.environment_rotation is not None:
            raise BadInputError("--environment-rotation: only with --environment")

    def apply(self, scene: Scene) -> Scene:
        """Replace a scene's sky and background, with a sun its suns, too, if one is given.

        Applies to every frame of an animated scene.

        Raises
        ------
        FileFormatError
            If the map cannot be read.
        MemoryError
            If the map does not fit in memory.
        """
        if not self.has_sky:
            return scene
        from raystream.scene.lights import DirectionalLight, EnvironmentLight

        added = self._daylight(scene) if self.sun else (self._map(scene),)
        replaced = (EnvironmentLight, DirectionalLight) if self.sun else (EnvironmentLight,)

        def light_up(scene: Scene) -> Scene:
            others = [other for other in scene.lights if not isinstance(other, replaced)]
            return scene.replace(lights=(*others, *added), background=(0.0, 0.0, 0.0))

        lit = light_up(scene)
        if scene.animation is None:
            return lit
        pose = scene.animation.at
        return lit.replace(animation=replace(scene.animation, at=lambda time: light_up(pose(time))))

    def _daylight(self, scene: Scene) -> tuple[Light, ...]:
        from raystream.scene.daylight import daylight

        assert self.sun is not None
        return daylight(*self.sun, up=scene.up)

    def _map(self, scene: Scene) -> Light:
        from raystream.rendering.environment import texels_of
        from raystream.scene.lights import EnvironmentLight

        light = EnvironmentLight(
            image=self.environment,
            up=tuple(scene.up),
            rotation=self.environment_rotation or 0.0,
        )
        texels_of(light)  # now, if it cannot be read
        return light

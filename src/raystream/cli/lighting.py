"""Lighting on the command line: environment maps, and an extra light for dim scenes."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from raystream.cli import options
from raystream.cli.console import BadInputError

if TYPE_CHECKING:
    from raystream.scene.scene import Scene

__all__ = ["LightingOptions"]

#: The library's extensions, for help; a test compares them.
SUFFIXES = (".hdr", ".exr", ".png", ".jpg", ".jpeg")


@dataclass(frozen=True)
class LightingOptions:
    """Options of a scene's lighting."""

    environment: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="A map (equirectangular: .hdr, .exr, .png or .jpg) instead of the scene's sky; "
            "its top is the scene's up direction.",
        ),
    ] = None
    environment_rotation: Annotated[
        float | None,
        typer.Option(
            metavar="DEGREES",
            callback=options.finite,
            help="With --environment: rotation of the map, counterclockwise as seen from above.",
        ),
    ] = None
    lights: Annotated[
        str | None,
        options.choice(
            options.LIGHTS,
            "file: the scene's own lights only; added: a white sky or a light at the eye beside "
            "them; auto: those where its own show nothing [default: auto]",
        ),
    ] = None

    def check(self) -> None:
        """Check the map's extension, and reject a rotation without a map."""
        if self.environment is not None:
            options.check_suffix(self.environment, SUFFIXES, "reading")
        elif self.environment_rotation is not None:
            raise BadInputError("--environment-rotation: only with --environment")

    def apply(self, scene: Scene) -> Scene:
        """Replace a scene's environment lights and background with the map, if one is given.

        Applies to every frame of an animated scene.

        Raises
        ------
        FileFormatError
            If the map cannot be read.
        MemoryError
            If the map does not fit in memory.
        """
        if self.environment is None:
            return scene
        from raystream.rendering.environment import texels_of
        from raystream.scene.lights import EnvironmentLight

        light = EnvironmentLight(
            image=self.environment,
            up=tuple(scene.up),
            rotation=self.environment_rotation or 0.0,
        )
        texels_of(light)

        def light_up(scene: Scene) -> Scene:
            others = [other for other in scene.lights if not isinstance(other, EnvironmentLight)]
            return scene.replace(lights=(*others, light), background=(0.0, 0.0, 0.0))

        lit = light_up(scene)
        if scene.animation is None:
            return lit
        pose = scene.animation.at
        return lit.replace(animation=replace(scene.animation, at=lambda time: light_up(pose(time))))

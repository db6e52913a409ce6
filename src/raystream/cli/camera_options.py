"""Options of the view: one of the scene's cameras, and changes of it."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any

import typer

from raystream.cli import options
from raystream.cli.console import BadInputError

if TYPE_CHECKING:
    from raystream.scene.camera import Camera
    from raystream.scene.scene import Scene

Vector = tuple[float, float, float]

#: The library's projections, for help; a test compares them.
PROJECTIONS = ("perspective", "orthographic", "equirectangular")

#: Parameters of `Camera` whose option has another name.
_NAMES = {"height": "view_height"}


def _vector(text: str) -> Any:
    """Make an option for three finite numbers, with a help text."""

    def check(value: Vector | None) -> Vector | None:
        if value is not None and not all(map(math.isfinite, value)):
            raise typer.BadParameter(f"expected three finite numbers, got {value}")
        return value

    return typer.Option(metavar="X Y Z", help=text, callback=check)


@dataclass(frozen=True)
class CameraOptions:
    """Options of the view."""

    camera: Annotated[
        str | None,
        options.value(
            "NAME",
            "One of the scene's cameras, by name or by number from 0; the options below change it.",
        ),
    ] = None
    eye: Annotated[Vector | None, _vector("Position of the camera.")] = None
    look_at: Annotated[Vector | None, _vector("The point in the centre of the image.")] = None
    up: Annotated[Vector | None, _vector("The direction that is up in the image.")] = None
    fov: Annotated[float | None, options.number("DEGREES", "Vertical field of view.")] = None
    projection: Annotated[
        str | None, options.choice(PROJECTIONS, f"Projection: {' or '.join(PROJECTIONS)}.")
    ] = None
    view_height: Annotated[
        float | None,
        options.number("LENGTH", "Height of an orthographic view, in the scene's units."),
    ] = None
    aperture: Annotated[
        float | None, options.number("LENGTH", "Lens diameter, for depth of field.")
    ] = None
    focus: Annotated[
        float | None,
        options.number("LENGTH", "Distance to the plane in focus [default: to --look-at]"),
    ] = None

    @property
    def changes(self) -> dict[str, Any]:
        """The parameters of `Camera` that are given."""
        parts = [field.name for field in dataclasses.fields(self) if field.name != "camera"]
        given = {name: getattr(self, name) for name in parts if getattr(self, name) is not None}
        if "view_height" in given:
            given["height"] = given.pop("view_height")
        return given

    def of(self, scene: Scene, aspect: float) -> tuple[Scene, Camera]:
        """A scene with the chosen one of its cameras, and that camera as changed.

        Parameters
        ----------
        scene : Scene
        aspect : float
            Width of the image over its height.

        Raises
        ------
        BadInputError
            If there is no such camera, or a parameter is out of range.
        """
        if self.camera is not None:
            text = self.camera
            which = int(text) if text.isascii() and text.isdigit() else text
            try:
                scene = scene.replace(camera=which)
            except ValueError as error:
                raise BadInputError(f"--camera: {error}") from error
        try:
            return scene, dataclasses.replace(scene.camera_for(aspect), **self.changes)
        except ValueError as error:
            name, _, reason = str(error).partition(": ")
            option = _NAMES.get(name, name).replace("_", "-")
            raise BadInputError(f"--{option}: {reason}") from error

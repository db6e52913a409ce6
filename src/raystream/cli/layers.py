"""Layers of a picture on the command line, and the filter that they guide."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from raystream.cli.messages import BadInputError

if TYPE_CHECKING:
    from raystream.rendering.image import Image

__all__ = ["Denoise", "Kept", "Layers"]

NAMES = ("depth", "normal", "albedo", "prim_id", "emission")

#: What `Image.denoise` uses.
GUIDES = ("depth", "normal", "albedo", "emission")

Layers = Annotated[
    str | None,
    typer.Option(
        "--layers",
        metavar="NAMES",
        show_default=False,
        help="What an EXR also says of the first surface in each pixel: some of "
        f"{','.join(NAMES)}, with commas, or none; all without it.",
    ),
]
Denoise = Annotated[
    bool,
    typer.Option(
        "--denoise",
        help="Smooth the noise of the finished picture, and keep edges of surfaces and textures.",
    ),
]


@dataclass(frozen=True)
class Kept:
    """The layers that a picture is rendered with, and those that its file has.

    Attributes
    ----------
    rendered, saved : tuple of str
    """

    rendered: tuple[str, ...]
    saved: tuple[str, ...]

    @classmethod
    def of(cls, output: Path, layers: str | None, is_denoised: bool) -> Kept:
        """The layers for an output, as ``--layers`` and ``--denoise`` ask for them.

        Raises
        ------
        BadInputError
            If the output cannot have layers, or there is none of a name.
        """
        has_room = output.suffix.lower() == ".exr"
        if layers is not None and not has_room:
            raise BadInputError("--layers: only with an --output of .exr, which has room for them")
        saved: tuple[str, ...] = NAMES if has_room else ()
        if layers is not None:
            given = [] if layers.strip() == "none" else [n.strip() for n in layers.split(",")]
            for name in given:
                if name not in NAMES:
                    known = " or ".join((*NAMES, "none"))
                    raise BadInputError(f"--layers: expected {known}, got {name!r}")
            saved = tuple(name for name in NAMES if name in given)
        guides = GUIDES if is_denoised else ()
        rendered = tuple(name for name in NAMES if name in saved or name in guides)
        return cls(rendered, saved)

    def denoised(self, image: Image) -> Image:
        """The picture without noise, and without layers that were only to guide the filter."""
        from raystream.rendering.image import Image

        smooth = image.denoise()
        layers = {
            name: layer
            for name, layer in smooth.layers.items()
            if name in self.saved or name not in NAMES
        }
        return Image(smooth.pixels, layers, smooth.figures)

"""Image layers on the command line, and the denoiser that uses them as guides."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from raystream.cli.console import BadInputError

if TYPE_CHECKING:
    from raystream.rendering.image import Image

__all__ = ["Denoise", "LayerSelection", "Layers"]

NAMES = ("depth", "normal", "albedo", "prim_id", "emission")

#: Layers that `Image.denoise` uses.
GUIDES = ("depth", "normal", "albedo", "emission")

Layers = Annotated[
    str | None,
    typer.Option(
        "--layers",
        metavar="NAMES",
        show_default=False,
        help="Extra layers (AOVs) of the first hit to write to an EXR: comma-separated from "
        f"{','.join(NAMES)}, or none [default: all]",
    ),
]
Denoise = Annotated[
    bool,
    typer.Option(
        "--denoise",
        help="Denoise the finished image, preserving edges of surfaces and textures.",
    ),
]


@dataclass(frozen=True)
class LayerSelection:
    """The layers to render, and the layers to save.

    Attributes
    ----------
    rendered, saved : tuple of str
    """

    rendered: tuple[str, ...]
    saved: tuple[str, ...]

    @classmethod
    def of(cls, output: Path, layers: str | None, is_denoised: bool) -> LayerSelection:
        """Choose the layers for an output from ``--layers`` and ``--denoise``.

        Raises
        ------
        BadInputError
            If the output format does not support layers, or a name is unknown.
        """
        has_room = output.suffix.lower() == ".exr"
        if layers is not None and not has_room:
            raise BadInputError("--layers: only with an .exr --output")
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
        """Denoise an image, and drop the layers that only guided the filter."""
        from raystream.rendering.image import Image

        smooth = image.denoise()
        layers = {
            name: layer
            for name, layer in smooth.layers.items()
            if name in self.saved or name not in NAMES
        }
        return Image(smooth.pixels, layers, smooth.figures)

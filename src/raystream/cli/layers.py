"""Image layers on the command line, and the denoiser that uses them as guides."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NamedTuple

from raystream.cli import options
from raystream.cli.console import BadInputError, write_note

if TYPE_CHECKING:
    from raystream.rendering.image import Image

NAMES = ("depth", "normal", "albedo", "prim_id", "emission")

#: Layers that `Image.denoise` uses.
GUIDES = ("depth", "normal", "albedo", "emission")


class LayerSelection(NamedTuple):
    """The layers to render, and the layers to save; whether to denoise, and whether fast."""

    rendered: tuple[str, ...]
    saved: tuple[str, ...]
    is_denoised: bool
    is_fast: bool

    def report_denoiser(self) -> None:
        """Say on stderr that the better denoiser is not there, if it is wanted."""
        from raystream.rendering.oidn import OIDN_REMEDY, has_oidn

        if self.is_denoised and not has_oidn():
            write_note(f"Open Image Denoise would remove more noise: {OIDN_REMEDY}")

    def denoise(self, image: Image) -> Image:
        """Denoise an image, and drop the layers that only guided the filter."""
        from raystream.rendering.image import Image
        from raystream.rendering.oidn import has_oidn

        smooth = image.denoise("oidn-fast" if self.is_fast and has_oidn() else None)
        layers = {
            name: layer
            for name, layer in smooth.layers.items()
            if name in self.saved or name not in NAMES
        }
        return Image(smooth.pixels, layers, smooth.figures)


@dataclass(frozen=True)
class LayerOptions:
    """Options of the layers beside the image."""

    layers: Annotated[
        str | None,
        options.value(
            "NAMES",
            "Extra layers (AOVs) of the first hit to write to an EXR: comma-separated from "
            f"{','.join(NAMES)}, or none [default: all]",
        ),
    ] = None
    denoise: Annotated[
        bool | None,
        options.flag(
            "--denoise/--no-denoise",
            "Denoise the image; best with raystream[denoise], Open Image Denoise [default: "
            "as --quality says]",
        ),
    ] = None

    def select(self, output: Path, is_denoised: bool, is_fast: bool = False) -> LayerSelection:
        """Choose the layers for an output file; `is_denoised` unless an option decides.

        Raises
        ------
        BadInputError
            If the output format does not support layers, or a name is unknown.
        """
        has_room = output.suffix.lower() == ".exr"
        if self.layers is not None and not has_room:
            raise BadInputError("--layers: only with an .exr --output")
        saved: tuple[str, ...] = NAMES if has_room else ()
        if self.layers is not None:
            text = self.layers
            given = [] if text.strip() == "none" else [name.strip() for name in text.split(",")]
            for name in given:
                if name not in NAMES:
                    known = " or ".join((*NAMES, "none"))
                    raise BadInputError(f"--layers: expected {known}, got {name!r}")
            saved = tuple(name for name in NAMES if name in given)
        denoises = is_denoised if self.denoise is None else self.denoise
        guides = GUIDES if denoises else ()
        rendered = tuple(name for name in NAMES if name in saved or name in guides)
        return LayerSelection(rendered, saved, denoises, is_fast)

"""``raystream compare``: error metrics of an image against a reference."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from raystream.cli import options
from raystream.cli.bars import Bars
from raystream.cli.console import BadInputError, mute, refuse, write_json, write_line
from raystream.cli.frame_files import IMAGES
from raystream.cli.tables import format_table

if TYPE_CHECKING:
    from raystream.rendering.compare import Comparison


def compare(
    image: Annotated[
        Path,
        typer.Argument(metavar="IMAGE", help="An image: .png, .exr or .hdr."),
    ],
    reference: Annotated[
        Path,
        typer.Argument(metavar="REFERENCE", help="The reference image, of the same size."),
    ],
    output: Annotated[
        Path | None,
        options.output(
            "Write the difference in false colours, with a scale below: .png, .exr or .hdr."
        ),
    ] = None,
    maximum: Annotated[
        float | None,
        options.positive_number(
            "DIFFERENCE", "With --output: the top of the scale [default: the largest difference]"
        ),
    ] = None,
    json: options.Json = False,
) -> None:
    """Compare two images. Shows the errors of linear colours, and where the largest is."""
    if output is not None:
        options.check_output(output, IMAGES, inputs=[str(image), str(reference)])
    elif maximum is not None:
        raise BadInputError("--maximum: only with --output")
    for path in (image, reference):
        options.check_suffix(path, IMAGES, "reading")
    from raystream.rendering.image import Image

    with Bars() as bars, bars.step("comparing"):
        with mute():  # OpenEXR prints a line for each damaged block
            found, wanted = Image.load(image), Image.load(reference)
        with refuse(ValueError, where=f"{image}, {reference}"):
            comparison = found.compare(wanted)
        if output is not None:
            drawn = found.draw_difference(wanted, maximum)
            with refuse(OSError, where=str(output)):
                drawn.save(output)
    width, height = found.size
    if json:
        figures = dataclasses.asdict(comparison)
        if math.isinf(comparison.psnr):
            figures["psnr"] = None
        files = {"image": str(image), "reference": str(reference)}
        drawn_to = None if output is None else str(output)
        write_json({**files, "output": drawn_to, "width": width, "height": height, **figures})
    else:
        write_line(format_table(["", ""], _rows(comparison, (width, height)), right=()))


def _rows(found: Comparison, size: tuple[int, int]) -> list[tuple[str, str]]:
    column, row = found.max_error_at
    rows = [
        ("size", "{}x{}".format(*size)),
        ("RMSE", f"{found.rmse:.6g}"),
        ("mean relative error", f"{found.mean_relative_error:.6g}"),
        ("relative MSE", f"{found.relative_mse:.6g}"),
        ("PSNR", "no difference in bytes" if math.isinf(found.psnr) else f"{found.psnr:.2f} dB"),
        ("largest error", f"{found.max_error:.6g} in column {column}, row {row}"),
        ("means", f"{found.mean:.6g} and {found.reference_mean:.6g}"),
        ("bias", f"{found.bias:+.6g}"),
    ]
    if found.invalid_count:
        rows.append(("not finite", f"{found.invalid_count:,} pixels, excluded"))
    return rows

"""First images: what a user sees after naming only a model and a mode.

Renders every built-in scene, every available sample and the given models in all modes, with the
command line and a size, and reports how much of each image is dark, bright, and covered by the
model. Also writes a sheet of all images for inspection.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import sys
import tempfile
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

import raystream as rs
from raystream.cli import main as command_line
from raystream.core.errors import RaystreamError
from raystream.scene.procedural import BUILTIN
from raystream.scene.samples import SAMPLES, fetch

#: Largest share of pixels in the lowest or highest tenth of the range, and smallest on the model.
MOST_EXTREME, LEAST_SHOWN = 0.95, 0.20

LABEL = 14


def known_scenes() -> list[str]:
    """The built-in scenes, and the samples that can be fetched."""
    names = list(BUILTIN)
    for name in SAMPLES:
        with contextlib.suppress(RaystreamError, OSError):
            fetch(name)
            names.append(name)
    return names


def render(name: str, mode: str, size: str, folder: Path) -> tuple[Image.Image, str]:
    """The image of a scene, and what the command line printed to stderr."""
    path = folder / "image.png"
    notes = io.StringIO()
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(notes):
        try:
            command_line(["render", name, "--mode", mode, "--size", size, "-o", str(path)])
        except SystemExit as end:
            if end.code:
                raise RuntimeError(f"{name}, {mode}: {notes.getvalue()}") from end
    with Image.open(path) as image:
        return image.convert("RGB"), notes.getvalue()


def shares(image: Image.Image) -> tuple[float, float]:
    """Shares of the pixels in the lowest and in the highest tenth of the range."""
    values = np.asarray(image).max(axis=2), np.asarray(image).min(axis=2)
    return float((values[0] < 25.5).mean()), float((values[1] > 229.5).mean())


def share_shown(scene: rs.Scene, width: int, height: int) -> float:
    """Share of the pixels on the model."""
    tracer = rs.Tracer(scene)
    hits = tracer.first_hit(*scene.camera_for(width / height).rays(width, height))
    return float((hits.prim_id >= 0).mean())


def main() -> int:
    """Render all images, print a table, and write the sheet; returns the number of faults."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scenes", nargs="*", help="models, with the built-in scenes and samples")
    parser.add_argument("--only", action="store_true", help="only the scenes given")
    parser.add_argument("--modes", default=",".join(rs.MODES))
    parser.add_argument("--size", default="320x240")
    parser.add_argument("-o", "--output", type=Path, default=Path("first_images.png"))
    asked = parser.parse_args()
    modes = asked.modes.split(",")
    width, height = map(int, asked.size.split("x"))
    names = [*([] if asked.only else known_scenes()), *asked.scenes]
    sheet = Image.new("RGB", (len(modes) * width, len(names) * (height + LABEL)), "white")
    draw = ImageDraw.Draw(sheet)
    fault_count = 0
    print(f"{'scene':24} {'mode':8} {'dark':>6} {'bright':>6} {'shown':>6}")
    with tempfile.TemporaryDirectory() as place:
        for row, name in enumerate(names):
            scene = rs.load(name)
            shown = share_shown(scene, width, height)
            for column, mode in enumerate(modes):
                image, notes = render(name, mode, asked.size, Path(place))
                dark, bright = shares(image)
                is_bad = max(dark, bright) > MOST_EXTREME
                is_bad |= shown < LEAST_SHOWN and not scene.has_own_camera
                fault_count += is_bad
                label = f"{Path(name).name} {mode}"
                print(
                    f"{Path(name).name:24} {mode:8} {dark:6.1%} {bright:6.1%} {shown:6.1%}"
                    f"{'  <--' if is_bad else ''}{'  ' + notes.strip() if notes else ''}",
                    flush=True,
                )
                corner = column * width, row * (height + LABEL)
                sheet.paste(image, (corner[0], corner[1] + LABEL))
                draw.text((corner[0] + 2, corner[1] + 1), label, "black")
            sheet.save(asked.output)
    print(f"{fault_count} faults; {asked.output}")
    return fault_count


if __name__ == "__main__":
    sys.exit(min(main(), 1))

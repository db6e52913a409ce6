"""The gallery: nine images of 1920 x 1080, each made with one command, and the page with them.

    python benchmarks/gallery.py
    python benchmarks/gallery.py kitchen engine --size 640x360 -o /tmp/gallery

Renders all or some of them with their commands, one after another, and writes JPEG files and
gallery.rst, with the commands, samples and times. The first image is a sheet of the eight modes.
Models are found through `RAYSTREAM_SCENES`, an absolute path. The page shows the figures of the
last run of each image, from figures.json in the folder of the images.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import re
import shlex
import subprocess
import sys
import tempfile
import textwrap
import time
from pathlib import Path
from typing import NamedTuple

from PIL import Image, ImageDraw, ImageFont

MODES = ("raycast", "vis", "shadow", "whitted", "xray", "ao", "kajiya", "path")

HEAD = """\
Gallery
=======

*Each image is made by the command below it. Times are those of the whole command, with kernels
compiled in advance, on a machine that ran other work at times. Written by*
``python benchmarks/gallery.py``.
"""


class Entry(NamedTuple):
    """An image of the gallery.

    Attributes
    ----------
    title : str
    command : str
        The size, and for ``raystream render`` the file, are appended.
    text : str
        What the image shows, and who made the model.
    """

    title: str
    command: str
    text: str

    @property
    def is_example(self) -> bool:
        """Whether it is an example, which takes the size and writes its own file."""
        return self.command.startswith("python ")


ENTRIES = {
    "kitchen": Entry(
        "Glass and polished metal",
        "raystream render kitchen --samples 64 --denoise --option clamp=4 --exposure 1.2 --tone "
        "aces",
        "Path tracing with the lights of the file; ``clamp`` bounds the caustics of its small "
        "lamps. Model: BART, a Benchmark for "
        "Animated Ray Tracing (Jonas Lext, Ulf Assarsson and Tomas Möller, 2000).",
    ),
    "sponza": Entry(
        "The atrium at noon",
        "raystream render sponza --sun 285 65 --exposure 3 --samples 64 --denoise --tone aces",
        "A model without lights, in the sun: most of it is lit by light reflected from the floor "
        "and the walls. Model: Marko Dabrovic; "
        "texture coordinates and cracks repaired by Kenzie Lamar, bump maps by Morgan McGuire.",
    ),
    "robots": Entry(
        "Robots in the city",
        "raystream render robots --sun 150 30 --exposure 0.9 --samples 64 --denoise --tone aces",
        "A built-in procedural scene.",
    ),
    "glass": Entry(
        "The bunny in glass",
        "python examples/images/glass_model.py bunny {size} 256",
        "80 lines of Python give the mesh a material, a floor, two lamps and the sky. Model: "
        "Stanford University Computer Graphics "
        "Laboratory (Turk and Levoy, 1994).",
    ),
    "helmet": Entry(
        "Textures of a glTF file",
        "raystream render helmet --sun 230 40 --exposure 1 --samples 64 --denoise --tone aces",
        'Maps of colour, metalness, roughness, normals and emission. Model: "Battle Damaged '
        'Sci-fi Helmet" by theblueturtle\\_ '
        "(Sketchfab), Creative Commons Attribution-NonCommercial.",
    ),
    "forest": Entry(
        "A forest of a million triangles",
        "raystream render forest:1000000 --sun 120 30 --exposure 2 --samples 64 --denoise "
        "--tone aces",
        "A built-in procedural scene for any number of triangles; each leaf is one triangle.",
    ),
    "instances": Entry(
        "A forest of a billion triangles",
        "python examples/images/instances.py {size} 32",
        "A patch of forest, placed 4,096 times as instances: the structure takes 19 MB.",
    ),
    "engine": Entry(
        "X-ray of an engine",
        "python examples/simulation/xray_engine.py {size} 64",
        "Closed solids inside each other; they absorb light along each ray (:doc:`physics`).",
    ),
    "conference": Entry(
        "Ambient occlusion of a conference room",
        "raystream render conference --mode ao --samples 16",
        "512 rays per pixel, each as long as a tenth of the room. Model: Anat Grynberg and "
        "Greg Ward.",
    ),
}


def render(entry: Entry, size: str, folder: Path) -> tuple[Path, str, float]:
    """Run an entry's command; returns the image, what the command printed, and its seconds."""
    words = shlex.split(entry.command.format(size=size))
    path = folder / "image.png"
    if entry.is_example:
        script = Path(__file__).parents[1] / words[1]
        written = {"glass_model": "glass.png", "xray_engine": "engine.png"}.get(
            script.stem, f"{script.stem}.png"
        )
        words, path = [sys.executable, str(script), *words[2:]], folder / written
    else:
        words = [sys.executable, "-m", *words, "--size", size, "-o", str(path), "--json"]
    start = time.perf_counter()
    done = subprocess.run(words, cwd=folder, capture_output=True, text=True, check=False)
    seconds = time.perf_counter() - start
    if done.returncode:
        raise RuntimeError(f"{entry.command}: {done.stderr.strip()}")
    return path, done.stdout, seconds


def sheet(size: str, folder: Path) -> Image.Image:
    """The built-in robots in all modes, with their names."""
    width, height = (int(length) for length in size.split("x"))
    whole = Image.new("RGB", (4 * width, 2 * height))
    for index, mode in enumerate(MODES):
        entry = Entry("", f"raystream render robots --mode {mode}", "")
        with Image.open(render(entry, size, folder)[0]) as image:
            tile = image.convert("RGB")
        draw, font = ImageDraw.Draw(tile), ImageFont.load_default(height // 18)
        left, top, right, bottom = draw.textbbox((16, 16), mode, font)
        draw.rectangle((left - 8, top - 8, right + 8, bottom + 8), "black")
        draw.text((16, 16), mode, "white", font)
        whole.paste(tile, (index % 4 * width, index // 4 * height))
    return whole


def measured(name: str, out: str, size: str, seconds: float, machine: str) -> dict[str, object]:
    """The figures that the page shows for an image."""
    entry = ENTRIES[name]
    command = entry.command.format(size=size)
    if entry.is_example:
        counts = re.findall(r"([\d,]+) (triangles|samples)", out)
        named = {what: int(count.replace(",", "")) for count, what in counts}
    else:
        command += f" --size {size} -o {name}.png"
        named = {what: json.loads(out)[what] for what in ("triangles", "samples")}
    return {"command": command, **named, "seconds": round(seconds), "machine": machine}


def page(figures: dict[str, dict[str, object]]) -> str:
    """The page with all images."""
    lines = [HEAD]
    for name, entry in ENTRIES.items():
        made = figures[name]
        about = (
            f"{made['triangles']:,} triangles, {made['samples']} samples per pixel, "
            f"{made['seconds']} seconds on {made['machine']}. {entry.text}"
        )
        lines += [
            entry.title,
            "-" * len(entry.title),
            "",
            f".. figure:: images/gallery/{name}.jpg",
            f"   :alt: {entry.title}",
            "",
            f"   ``{made['command']}``",
            "",
            *textwrap.wrap(about, 120, initial_indent="   ", subsequent_indent="   "),
            "",
        ]
    return "\n".join(lines)


def machine_name() -> str:
    """The number and kind of this machine's processors."""
    lines = Path("/proc/cpuinfo").read_text() if Path("/proc/cpuinfo").exists() else ""
    named = [line.partition(":")[2].strip() for line in lines.splitlines() if "model name" in line]
    return f"{os.cpu_count()} cores of {named[0] if named else platform.processor()}"


def main() -> int:
    """Render the images, and write the page."""
    docs = Path(__file__).resolve().parents[1] / "docs"
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"modes, {', '.join(ENTRIES)}")
    parser.add_argument("--size", default="1920x1080")
    parser.add_argument("--machine", default=machine_name(), help="name of the machine on the page")
    parser.add_argument("-o", "--output", type=Path, default=docs, help="a folder")
    asked = parser.parse_args()
    names = asked.names or ["modes", *ENTRIES]
    unknown = [name for name in names if name not in ("modes", *ENTRIES)]
    if unknown:
        parser.error(f"{unknown[0]}: expected one of modes, {', '.join(ENTRIES)}")
    folder = asked.output / "images" / "gallery"
    folder.mkdir(parents=True, exist_ok=True)
    record = folder / "figures.json"
    figures = json.loads(record.read_text()) if record.exists() else {}
    has_failed = False
    with tempfile.TemporaryDirectory() as place:
        for name in names:
            if name == "modes":
                image = sheet("400x300", Path(place))
                image.save(folder.parent / "gallery_robots.png", optimize=True)
                continue
            entry = ENTRIES[name]
            try:
                path, out, seconds = render(entry, asked.size, Path(place))
            except RuntimeError as error:
                print(f"{name}: {error}", file=sys.stderr)
                has_failed = True
                continue
            with Image.open(path) as image:
                image.convert("RGB").save(folder / f"{name}.jpg", quality=90, optimize=True)
            figures[name] = measured(name, out, asked.size, seconds, asked.machine)
            record.write_text(json.dumps(figures, indent=1) + "\n")
            print(f"{name}: {seconds:.0f} s", flush=True)
    if figures.keys() >= ENTRIES.keys():
        (asked.output / "gallery.rst").write_text(page(figures))
    return int(has_failed)


if __name__ == "__main__":
    sys.exit(main())

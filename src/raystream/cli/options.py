"""Options shared by several commands: their types, parsing and completion.

Nothing here imports the library's heavy modules, which keeps ``--help`` and completion fast.
"""

from __future__ import annotations

import importlib.util
import math
import os
import re
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import typer

from raystream.cli.console import BadInputError, refuse

#: The library's names, for help and completion; a test compares them.
SCENES = (
    "cornell",
    "cornell_mirrors",
    "cornell_open",
    "three_boxes",
    "cubes",
    "spheres",
    "boxes",
    "building",
    "forest",
    "robots",
)
MODES = ("raycast", "vis", "shadow", "whitted", "xray", "ao", "kajiya", "path")
SAMPLERS = ("sobol", "stratified", "random")
TONES = ("linear", "reinhard", "aces")
HEATMAPS = ("cells", "tests", "steps")
LIGHTS = ("auto", "file", "added")
DEFAULT_MODE = "path"
DEVICES = ("cpu", "graphics", "cuda")
#: Default machine of each device.
DEFAULT_MACHINES = {"cpu": "branching", "graphics": "compute", "cuda": "branching"}
#: Ray sets of a benchmark; those by default, and on request.
DEFAULT_SETS = ("primary", "image", "shadow", "ao", "bounce", "random", "multi")
RAY_SETS = (*DEFAULT_SETS, "random_multi", "closest", "closest_near", "closest_grid")
PEERS = (
    "open3d",
    "embreex",
    "embreex-robust",
    "mitsuba",
    "mitsuba-robust",
    "warp",
    "fcpw",
    "libigl",
)


def complete(names: Collection[str]) -> Callable[[str], list[str]]:
    """Make a completion function for fixed names."""
    return lambda incomplete: [name for name in names if name.startswith(incomplete)]


def complete_scenes(incomplete: str) -> Iterator[tuple[str, str]]:
    """Complete scene names; the shell falls back to files if none matches."""
    from raystream.scene.procedural import BUILTIN
    from raystream.scene.samples import SAMPLES

    for name, builtin in BUILTIN.items():
        if name.startswith(incomplete):
            yield name, builtin.description
    for name in SAMPLES:
        if name.startswith(incomplete):
            yield name, "sample"


def choice(names: Collection[str], text: str) -> Any:
    """Make an option that accepts these names only, with a help text."""

    def check(value: str | None) -> str | None:
        if value is not None and value not in names:
            raise typer.BadParameter(f"expected {' or '.join(names)}, got {value!r}")
        return value

    return typer.Option(metavar="NAME", help=text, callback=check, autocompletion=complete(names))


def finite(value: float | None) -> float | None:
    """Accept a finite number or an omitted option."""
    if value is not None and not math.isfinite(value):
        raise typer.BadParameter(f"expected a finite number, got {value}")
    return value


def positive(value: float | None) -> float | None:
    """Accept a finite number above 0 or an omitted option."""
    if value is not None and not (math.isfinite(value) and value > 0.0):
        raise typer.BadParameter(f"expected a number above 0, got {value}")
    return value


def flag(name: str, text: str) -> Any:
    """Make an option without a value, with a help text."""
    return typer.Option(name, help=text)


def value(metavar: str, text: str) -> Any:
    """Make an option for any text, with a help text."""
    return typer.Option(metavar=metavar, help=text)


def number(metavar: str, text: str) -> Any:
    """Make an option for a finite number, with a help text."""
    return typer.Option(metavar=metavar, help=text, callback=finite)


def positive_number(metavar: str, text: str) -> Any:
    """Make an option for a finite number above 0, with a help text."""
    return typer.Option(metavar=metavar, help=text, callback=positive)


def count(text: str, least: int = 1, most: int | None = None, metavar: str = "N") -> Any:
    """Make an option for an integer from `least` to `most`, with a help text."""
    return typer.Option(min=least, max=most, metavar=metavar, help=text)


def output(text: str, metavar: str = "FILE") -> Any:
    """Make the option ``--output``, with a help text."""
    return typer.Option("--output", "-o", metavar=metavar, help=text)


SCENE_HELP = (
    "A model file (OBJ, PLY, STL, OFF, glTF, GLB, AFF, NFF; optionally compressed as .gz), a "
    f"structure saved by Tracer.save (.npz), a built-in scene ({', '.join(SCENES)}; "
    "'forest:1000000' has about a million triangles), or a sample, such as bunny."
)
SCENE = typer.Argument(
    metavar="SCENE", help=SCENE_HELP, autocompletion=complete_scenes, show_default=False
)

SceneName = Annotated[str, SCENE]
Threads = Annotated[
    int | None, count("Number of threads [default: RAYSTREAM_THREADS, else one per core]")
]
Json = Annotated[bool, flag("--json", "Print the figures as JSON.")]


@dataclass(frozen=True)
class SceneOptions:
    """Options of loading a scene."""

    time: Annotated[float, number("T", "For animated scenes (AFF, glTF): the time to show.")] = 0.0
    triangles: Annotated[
        int | None, count("For built-in scenes: approximate number of triangles.")
    ] = None


def parse_size(text: str) -> tuple[int, int]:
    """Parse an image size such as ``1024x768``.

    Raises
    ------
    BadInputError
        If the text is not a size.
    """
    match = re.fullmatch(r"0*([1-9]\d{0,8})x0*([1-9]\d{0,8})", text.strip().lower(), re.ASCII)
    if match is None:
        raise BadInputError(f"--size: expected WIDTHxHEIGHT, such as 1024x768, got {text!r}")
    return int(match[1]), int(match[2])


def check_output(path: Path, suffixes: Sequence[str], inputs: Sequence[str] = ()) -> None:
    """Check that an output can be written, before any work is done for it.

    Parameters
    ----------
    path : Path
    suffixes : sequence of str
        Accepted extensions.
    inputs : sequence of str, optional
        Files that must not be overwritten.

    Raises
    ------
    BadInputError
        As `check_suffix`; or if the path is a folder or one of the inputs, or its folder does
        not exist or is not writable.
    """
    check_suffix(path, suffixes, "writing")
    folder = path.parent
    if not folder.is_dir():
        raise BadInputError(f"{path}: folder {folder} does not exist")
    if path.is_dir():
        raise BadInputError(f"{path}: is a folder, not a file")
    if not os.access(folder, os.W_OK | os.X_OK):
        raise BadInputError(f"{path}: the folder {folder} is not writable")
    if path.exists() and any(os.path.exists(name) and path.samefile(name) for name in inputs):
        raise BadInputError(f"{path}: is an input and would be overwritten")


def check_replaced(path: Path, force: bool) -> None:
    """Check that an image or a video may be written, where there may be another file.

    Parameters
    ----------
    path : Path
    force : bool
        Whether any file is replaced.

    Raises
    ------
    BadInputError
        If there is a file, not empty, that raystream did not write.
    """
    if force or not path.is_file():
        return
    from raystream.rendering.software_tag import is_tagged

    with refuse(OSError, where=str(path)):
        if path.stat().st_size == 0 or is_tagged(path):
            return
    raise BadInputError(
        f"{path}: exists, and was not written by raystream; choose another --output, or pass "
        "--force to replace it"
    )


def check_suffix(path: Path, suffixes: Sequence[str], purpose: str) -> None:
    """Check a file's extension.

    Parameters
    ----------
    path : Path
    suffixes : sequence of str
        Accepted extensions.
    purpose : {"reading", "writing"}

    Raises
    ------
    BadInputError
        If the extension is not accepted, or is .exr and OpenEXR is not installed.
    """
    if path.suffix.lower() not in suffixes:
        raise BadInputError(f"{path}: file extension must be {' or '.join(suffixes)}")
    if path.suffix.lower() == ".exr" and importlib.util.find_spec("OpenEXR") is None:
        raise BadInputError(f"{path}: {purpose} .exr needs OpenEXR: pip install 'raystream[exr]'")

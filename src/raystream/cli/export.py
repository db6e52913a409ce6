"""``raystream export``: a scene as a web page that traces it on the visitor's GPU."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Annotated

import typer

from raystream.cli import options
from raystream.cli.bars import Bars
from raystream.cli.camera_options import CameraOptions
from raystream.cli.console import BadInputError, one_line, refuse, write_json, write_line
from raystream.cli.load import Stopwatch, choose_threads
from raystream.cli.option_groups import expand_groups
from raystream.cli.tracer_options import parse_keywords
from raystream.structures import StructureOptions, options_of

#: The library's structures with shaders, for help and completion; a test compares them.
STRUCTURES = ("bvh", "kdtree", "grid", "brute", "graph")


@expand_groups
def export(
    scene: options.SceneName,
    *,
    output: Annotated[
        Path, options.output("The page: a .html file or, with --split, a folder.", metavar="PAGE")
    ],
    structure: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME[:KEY=VALUE,...]",
            help=f"A structure that visitors can choose: {', '.join(STRUCTURES)}; with options, as "
            "in kdtree:traversal=restart. Repeatable. [default: bvh]",
            autocompletion=options.complete(STRUCTURES),
        ),
    ] = None,
    size: Annotated[
        str, options.value("WIDTHxHEIGHT", "Size of the image for visitors without WebGPU.")
    ] = "960x540",
    split: Annotated[
        bool, options.flag("--split", "Write a folder of files for a web server, for large scenes.")
    ] = False,
    viewing: CameraOptions,
    threads: options.Threads = None,
    loading: options.SceneOptions,
    json: options.Json = False,
) -> None:
    """Write a scene as a web page that traces it on the visitor's GPU. It needs no network."""
    if split:
        _check_folder(output)
    else:
        options.check_output(output, [".html", ".htm"], [scene])
    width, height = options.parse_size(size)
    structures = [_parsed(one) for one in structure or ["bvh"]]
    choose_threads(threads)
    from raystream.scene.load import load
    from raystream.web import export_page

    watch = Stopwatch()
    with Bars() as bars:
        with watch.measure("load"), bars.step("loading"), refuse(ValueError):
            found = load(scene, time=loading.time, triangles=loading.triangles)
        found, camera = viewing.of(found, width / height)
        with (
            watch.measure("export"),
            bars.step("exporting"),
            refuse(ValueError),
            refuse(OSError, where=str(output)),
        ):
            count = export_page(
                found,
                output,
                structures=structures,
                camera=camera,
                size=(width, height),
                split=split,
            )
    if json:
        figures = {"output": str(output), "scene": scene, "bytes": count}
        write_json({**figures, "triangles": found.triangle_count, "seconds": watch.rounded()})
    else:
        write_line(f"{one_line(str(output))}: {count:,} bytes; {watch.text()}")


def _parsed(text: str) -> StructureOptions:
    """A structure with options, such as ``kdtree:traversal=restart``."""
    name, colon, words = text.partition(":")
    each = re.split(r",(?![^\[]*\])", words)  # at commas outside of lists
    given = parse_keywords("--structure", each) if colon else {}
    try:
        return options_of(name, given)
    except (ValueError, TypeError) as error:
        raise BadInputError(f"--structure: {error}") from error


def _check_folder(output: Path) -> None:
    if not output.parent.is_dir():
        raise BadInputError(f"{output}: folder {output.parent} does not exist")
    if output.exists() and not output.is_dir():
        raise BadInputError(f"{output}: is a file; with --split, pages are folders")
    if output.suffix in (".html", ".htm"):
        raise BadInputError(f"{output}: with --split, pages are folders; give a name without .html")

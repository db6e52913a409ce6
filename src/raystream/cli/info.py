"""``raystream info``: what is in a scene, and what a structure makes of it."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from typing import Any

from raystream.cli import options
from raystream.cli.bars import Bars
from raystream.cli.messages import one_line, write_json, write_line
from raystream.cli.opening import Source, Stopwatch, choose_threads, open_tracer

__all__ = ["info"]

#: Meshes and materials that people see; ``--json`` lists all.
MAX_ROWS = 12

#: Nothing is wrapped for a program that reads the table.
PIPED_WIDTH = 10_000


def info(
    scene: options.SceneName,
    structure: options.Structure = None,
    device: options.Device = "cpu",
    threads: options.Threads = None,
    time: options.Time = 0.0,
    triangles: options.Triangles = None,
    json: options.Json = False,
) -> None:
    """Show what is in a scene, and the time, memory and quality of its structure."""
    choose_threads(threads)
    from raystream.cli.describe import describe

    watch = Stopwatch()
    with Bars() as bars:
        tracer = open_tracer(Source(scene, structure, device, time, triangles), bars, watch)
        figures = describe(scene, tracer, watch)
    if json:
        write_json(figures)
    else:
        _show(figures)


def _show(figures: dict[str, Any]) -> None:
    _write_table(["", ""], _facts(figures))
    meshes = [
        (i, mesh["name"], mesh["triangles"], mesh["vertices"], " ".join(mesh["attributes"]))
        for i, mesh in enumerate(figures["meshes"])
    ]
    materials = [
        (
            i,
            material["name"],
            material["triangles"],
            _vector(material["diffuse"]),
            " ".join(material["textures"].values()),
        )
        for i, material in enumerate(figures["materials"])
    ]
    _write_largest("meshes", ["id", "mesh", "triangles", "vertices", "attributes"], meshes)
    _write_largest("materials", ["id", "material", "triangles", "diffuse", "textures"], materials)


def _facts(figures: dict[str, Any]) -> list[tuple[str, str]]:
    """What there is one of, by name."""
    bounds, camera = figures["bounds"], figures["camera"]
    memory, structure = figures["memory"], figures["structure"]
    parts = [f"{part}={_vector(camera[part], ',')}" for part in ("eye", "look_at", "up")]
    lights = [light["type"] for light in figures["lights"]]
    kinds = [f"{lights.count(kind):,} {kind}" for kind in dict.fromkeys(lights)]
    return [
        ("scene", figures["scene"]),
        ("name", figures["name"]),
        ("triangles", f"{figures['triangles']:,}"),
        ("  degenerate", f"{figures['degenerate_triangles']:,}"),
        ("  non-finite", f"{figures['nonfinite_triangles']:,}"),
        ("vertices", f"{figures['vertices']:,}"),
        ("meshes", f"{len(figures['meshes']):,}"),
        ("materials", f"{len(figures['materials']):,}"),
        ("lights", ", ".join(kinds) or "none"),
        ("low corner", _vector(bounds["low"]) if bounds else "nothing can be hit"),
        ("high corner", _vector(bounds["high"]) if bounds else ""),
        ("camera", " ".join([*parts, f"fov={camera['fov']:g}"])),
        ("memory", " + ".join(f"{size / 1e6:,.1f} MB {name}" for name, size in memory.items())),
        ("load", f"{figures['seconds']['load']:.2f} s"),
        ("structure", f"{structure['name']}, built in {structure['seconds']:.2f} s"),
        *((f"  {name}", f"{value:,.6g}") for name, value in structure["quality"].items()),
    ]


def _vector(numbers: Sequence[float], separator: str = " ") -> str:
    return separator.join(f"{number:.6g}" for number in numbers)


def _write_largest(what: str, columns: Sequence[str], rows: Sequence[tuple[Any, ...]]) -> None:
    """Write the rows with the most triangles, which are the third column."""
    shown = sorted(rows, key=lambda row: -row[2])[:MAX_ROWS]
    if shown:
        write_line()
        _write_table(columns, shown)
    if len(rows) > len(shown):
        write_line(f"and {len(rows) - len(shown):,} more {what} (--json lists all)")


def _write_table(columns: Sequence[str], rows: Sequence[Sequence[Any]]) -> None:
    """Write aligned columns, integers to the right; in colour and wrapped on a terminal only."""
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    table = Table(box=None, pad_edge=False, show_header=any(columns), padding=(0, 2, 0, 0))
    for title, sample in zip(columns, rows[0], strict=True):
        table.add_column(title, justify="right" if isinstance(sample, int) else "left")
    for row in rows:
        cells = (f"{cell:,}" if isinstance(cell, int) else str(cell) for cell in row)
        table.add_row(*(Text(_printable(cell)) for cell in cells))
    console = Console(width=None if sys.stdout.isatty() else PIPED_WIDTH, highlight=False)
    with console.capture() as capture:
        console.print(table)
    for line in capture.get().splitlines():
        write_line(line.rstrip())


def _printable(text: str) -> str:
    indent = len(text) - len(text.lstrip(" "))
    return " " * indent + one_line(text)

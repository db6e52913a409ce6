"""Report: a benchmark's figures as tables."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple

from raystream.bench.results import (
    AGREEMENT_LIMIT,
    NO_QUERY,
    BenchResult,
    SceneResult,
    SetResult,
)
from raystream.core.atomic_write import atomic_write

__all__ = ["OUTPUT_SUFFIXES", "Table", "make_notes", "make_tables", "write_result"]

_NONE = "–"


class Table(NamedTuple):
    """A table with a title; the first column is text, the others are figures.

    Parameters
    ----------
    title : str
    columns : list of str
    rows : list of list of str
    """

    title: str
    columns: list[str]
    rows: list[list[str]]


def make_tables(result: BenchResult) -> list[Table]:
    """Format a result as tables: the speed in each scene, then builds and memory of all.

    Parameters
    ----------
    result : BenchResult

    Returns
    -------
    list of Table
    """
    tables = [_speed_table(result, scene) for scene in result.scenes if scene.sets]
    if any(build.seconds for scene in result.scenes for build in scene.builds.values()):
        tables.append(_build_table(result))
    return tables


def _speed_table(result: BenchResult, scene: SceneResult) -> Table:
    own = result.own[0]
    columns = ["rays", "count", *result.labels, "x best peer", "x open3d", "min diff", "max diff"]
    rows = []
    for rays in scene.sets:
        best = rays.best_peer(result.peers)
        rows.append(
            [
                rays.name,
                f"{rays.ray_count:,}",
                *(_speed(rays, label) for label in result.labels),
                _ratio(rays.ratio(own, best)),
                _ratio(rays.ratio(own, "open3d")),
                *_differing(rays),
            ]
        )
    title = f"{scene.scene}: {scene.triangle_count:,} triangles; millions of rays per second"
    return Table(title, columns, rows)


def _build_table(result: BenchResult) -> Table:
    rows = []
    for scene in result.scenes:
        for what, cell in (("build, s", _build), ("kept, MB", _kept), ("peak, MB", _peak)):
            cells = [cell(scene, label) for label in result.labels]
            if any(text != _NONE for text in cells):
                rows.append([scene.scene, what, *cells])
    return Table("Build times and memory", ["scene", "figure", *result.labels], rows)


def _speed(rays: SetResult, label: str) -> str:
    speed = rays.speed(label)
    return _NONE if speed is None else f"{speed:.3g}" if speed < 100.0 else f"{speed:.0f}"


def _ratio(ratio: float | None) -> str:
    return _NONE if ratio is None else f"{ratio:.2f}"


def _differing(rays: SetResult) -> tuple[str, str]:
    """Format the smallest and the largest share of differing rays, and whose the latter is.

    An exclamation mark flags a large share. If the smallest is small and the largest is not,
    raystream agrees with another peer.
    """
    if not rays.agreement:
        return _NONE, _NONE
    shares = {label: agreement.differing for label, agreement in rays.agreement.items()}
    worst = max(shares, key=lambda label: shares[label])
    text = _share(shares[worst])
    return _share(min(shares.values())), text if shares[worst] == 0.0 else f"{text} {worst}"


def _share(share: float) -> str:
    text = f"{share:.1e}" if share else "0"
    return f"{text} !" if share > AGREEMENT_LIMIT else text


def _build(scene: SceneResult, label: str) -> str:
    build = scene.builds.get(label)
    return _NONE if build is None or not build.seconds else f"{build.median:.3g}"


def _kept(scene: SceneResult, label: str) -> str:
    build = scene.builds.get(label)
    return _NONE if build is None or build.memory is None else f"{build.memory.kept / 1e6:.3g}"


def _peak(scene: SceneResult, label: str) -> str:
    build = scene.builds.get(label)
    return _NONE if build is None or build.memory is None else f"{build.memory.peak / 1e6:.3g}"


def make_notes(result: BenchResult) -> list[str]:
    """List notes for readers of the tables, one line each.

    Parameters
    ----------
    result : BenchResult
    """
    notes = [_machine_line(result)]
    notes += [f"{label}: {note}." for label, note in result.notes.items()]
    notes += [f"{label} is absent: {reason}" for label, reason in result.absent.items()]
    notes += [f"{scene} is skipped: {reason}" for scene, reason in result.skipped.items()]
    for scene in result.scenes:
        notes += [f"{scene.scene}: {label}: {why}" for label, why in scene.failures.items()]
        for rays in scene.sets:
            notes += [
                f"{scene.scene}, {rays.name}: {label}: {why}"
                for label, why in rays.failures.items()
                if why != NO_QUERY and label not in scene.failures
            ]
    flagged = any(
        rays.worst is not None and rays.worst.differing > AGREEMENT_LIMIT
        for scene in result.scenes
        for rays in scene.sets
    )
    if flagged:
        notes.append(f"!: more than {AGREEMENT_LIMIT:g} of the rays got a different result.")
    return notes


def write_result(path: Path, result: BenchResult) -> None:
    """Write a result to a file: its tables, for inclusion in a page, or everything as JSON.

    Parameters
    ----------
    path : Path
        With one of `OUTPUT_SUFFIXES`: Markdown, reStructuredText or JSON.
    result : BenchResult

    Raises
    ------
    OSError
        If the file cannot be written.
    """
    if path.suffix.lower() == ".json":
        text = json.dumps(result.as_json(), indent=2, allow_nan=False)
    else:
        write = _WRITERS[path.suffix.lower()]
        parts = [*(write(table) for table in make_tables(result)), *make_notes(result)]
        text = "\n\n".join(parts)
    with atomic_write(path) as part:
        part.write_text(text + "\n", encoding="utf-8")


def _machine_line(result: BenchResult) -> str:
    machine = result.machine
    versions = ", ".join(f"{label} {version}" for label, version in result.versions.items())
    width, height = result.size
    return (
        f"{machine['cpu']}, threads: {machine['threads']}; {width} x {height} pixels, medians of "
        f"{result.repeats} rounds; {versions}."
    )


def _as_markdown(table: Table) -> str:
    lines = [
        f"**{table.title}**",
        "",
        "| " + " | ".join(table.columns) + " |",
        "| --- |" + " ---: |" * (len(table.columns) - 1),
        *("| " + " | ".join(row) + " |" for row in table.rows),
    ]
    return "\n".join(lines)


def _as_rst(table: Table) -> str:
    lines = [f".. list-table:: {table.title}", "   :header-rows: 1", ""]
    for row in (table.columns, *table.rows):
        lines += [f"   {'*' if index == 0 else ' '} - {cell}" for index, cell in enumerate(row)]
    return "\n".join(lines)


_WRITERS: Mapping[str, Callable[[Table], str]] = MappingProxyType(
    {".md": _as_markdown, ".rst": _as_rst}
)

#: Supported extensions of result files.
OUTPUT_SUFFIXES = (*_WRITERS, ".json")

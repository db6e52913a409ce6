"""Report: a benchmark's figures as tables."""

from __future__ import annotations

import statistics
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple

from raystream.bench.chart import draw_chart
from raystream.bench.goals import Verdict, judge
from raystream.bench.ray_sets import RAY_SETS
from raystream.bench.results import (
    AGREEMENT_LIMIT,
    NO_QUERY,
    BenchResult,
    SceneResult,
    SetResult,
)
from raystream.bench.roofline import most_rays
from raystream.core.atomic_write import atomic_write

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
    """Format a result as tables: speeds of each scene; builds and memory; roofline; goals.

    Parameters
    ----------
    result : BenchResult

    Returns
    -------
    list of Table
        Without those that would be empty.
    """
    tables = [*speed_tables(result), build_table(result)]
    tables += [roofline_table(result), goal_table(result)]
    return [table for table in tables if table.rows]


def speed_tables(result: BenchResult) -> list[Table]:
    """A table of each scene: millions of rays per second of all contenders."""
    return [_speed_table(result, scene) for scene in result.scenes if scene.sets]


def _speed_table(result: BenchResult, scene: SceneResult) -> Table:
    columns = ["rays", "count", *result.labels, "x best peer", "x best watertight peer"]
    columns += ["share", "min diff", "max diff"]
    rows = [
        [
            rays.name,
            f"{rays.ray_count:,}",
            *(_speed(rays, label) for label in result.labels),
            _ratio(result.ratio(rays)),
            _ratio(result.ratio(rays, watertight=True)),
            _share_of(result.share(rays)),
            *_differing(rays),
        ]
        for rays in scene.sets
    ]
    with_points = any(rays.query == "closest" for rays in scene.sets)
    unit = "rays or points" if with_points else "rays"
    title = f"{scene.scene}: {scene.triangle_count:,} triangles; millions of {unit} per second"
    return Table(title, columns, rows)


def build_table(result: BenchResult) -> Table:
    """Build times and memory of all contenders."""
    rows = []
    for scene in result.scenes:
        for what, cell in (("build, s", _build), ("kept, MB", _kept), ("peak, MB", _peak)):
            cells = [cell(scene, label) for label in result.labels]
            if any(text != _NONE for text in cells):
                rows.append([scene.scene, what, *cells])
    return Table("Build times and memory", ["scene", "figure", *result.labels], rows)


def roofline_table(result: BenchResult) -> Table:
    """Tests per ray, and the share of the roofline that raystream reaches; see `roofline`."""
    columns = ["rays", "nodes", "blocks", "hit blocks", "roofline, Mrays/s", "share", "to"]
    found: dict[str, list[tuple[SetResult, float]]] = {}
    for scene in result.scenes:
        for rays in scene.sets:
            share = result.share(rays)
            if share is not None:
                found.setdefault(rays.name, []).append((rays, share))
    rows = []
    for name, pairs in found.items():
        counts = [rays.counts for rays, _ in pairs if rays.counts is not None]
        peaks, shares = result.peaks, [share for _, share in pairs]
        assert peaks is not None
        most = [rate for one in counts if (rate := most_rays(peaks, one)) is not None]
        rows.append(
            [
                RAY_SETS[name].title,
                *(f"{_median(one[k] for one in counts):.1f}" for k in range(3)),
                f"{_median(most) / 1e6:.0f}",
                f"{_median(shares):.0%}",
                f"{min(shares):.0%} to {max(shares):.0%}",
            ]
        )
    return Table(
        "Roofline: tests per ray, and the share reached; medians of the scenes", columns, rows
    )


def goal_table(result: BenchResult) -> Table:
    """The ratios to the best peer over all scenes, beside the goals."""
    columns = ["rays", "median", "goal", "least", "goal", "in", "met", "watertight peers", "least"]
    watertight = {one.name: one for one in judge(result, watertight=True)}
    rows = [_goal_row(one, watertight.get(one.name)) for one in judge(result)]
    return Table("Times the best peer, and the best of those that are watertight", columns, rows)


def _goal_row(one: Verdict, watertight: Verdict | None) -> list[str]:
    goals = (_NONE, _NONE) if one.goal is None else (f"{one.goal.median:g}", f"{one.goal.least:g}")
    met = "both" if one.meets_median else "least"
    if not one.meets_least:
        met = "median" if one.meets_median else "neither"
    return [
        RAY_SETS[one.name].title,
        f"{one.median:.2f}",
        goals[0],
        f"{one.least:.2f}",
        goals[1],
        one.worst_scene,
        _NONE if one.goal is None else met,
        *(_ratio(watertight and getattr(watertight, name)) for name in ("median", "least")),
    ]


def _median(values: Iterable[float]) -> float:
    return statistics.median(values)


def _speed(rays: SetResult, label: str) -> str:
    speed = rays.speed(label)
    return _NONE if speed is None else f"{speed:.3g}" if speed < 100.0 else f"{speed:.0f}"


def _ratio(ratio: float | None) -> str:
    return _NONE if ratio is None else f"{ratio:.2f}"


def _share_of(share: float | None) -> str:
    return _NONE if share is None else f"{share:.0%}"


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
    notes = [machine_line(result)]
    if result.peaks is not None:
        nodes, blocks, hit_blocks = (f"{one / 1e6:.0f}" for one in result.peaks)
        notes.append(
            f"share: fraction of the roofline, at {nodes} million tests of a node, {blocks} of a "
            f"leaf block and {hit_blocks} of one with a hit per second."
        )
    notes += [f"{label}: {note}." for label, note in result.notes.items()]
    notes += [f"{label} is absent: {reason}" for label, reason in result.absent.items()]
    notes += [f"{scene} is skipped: {reason}" for scene, reason in result.skipped.items()]
    for scene in result.scenes:
        if not scene.is_complete:
            notes.append(f"{scene.scene} is incomplete: it was interrupted.")
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


def write_report(path: Path, result: BenchResult) -> None:
    """Write tables for inclusion in a page, or the chart.

    Parameters
    ----------
    path : Path
        With one of `REPORT_SUFFIXES`: Markdown or reStructuredText for tables, SVG for the chart.
    result : BenchResult

    Raises
    ------
    OSError
        If the file cannot be written.
    """
    suffix = path.suffix.lower()
    if suffix == ".svg":
        text = draw_chart(result)
    else:
        parts = [*(_WRITERS[suffix](table) for table in make_tables(result)), *make_notes(result)]
        text = "\n\n".join(parts)
    with atomic_write(path) as part:
        part.write_text(text + "\n", encoding="utf-8")


def machine_line(result: BenchResult) -> str:
    """Where, when and how the figures were measured, in one sentence."""
    machine, settings = result.machine, result.settings
    versions = ", ".join(f"{label} {version}" for label, version in result.versions.items())
    width, height = settings["size"]
    return (
        f"{machine['cpu']}, threads: {machine['threads']}, {result.date}; {width} x {height} "
        f"pixels, medians of {settings['repeats']} rounds after {settings['warm_up_rounds']} to "
        f"warm up; {versions}."
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

#: Extensions of files that are made from a result.
REPORT_SUFFIXES = (*_WRITERS, ".svg")

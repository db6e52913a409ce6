"""``raystream bench``: trace the same rays with raystream and its peers; or report a result."""

from __future__ import annotations

import contextlib
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from raystream.cli import options
from raystream.cli.bars import Bars
from raystream.cli.console import (
    BadInputError,
    one_line,
    refuse,
    write_json,
    write_line,
    write_note,
)
from raystream.cli.load import choose_threads
from raystream.cli.option_groups import expand_groups
from raystream.cli.tables import format_table
from raystream.cli.tracer_options import parse_keywords

if TYPE_CHECKING:
    from raystream.bench.contenders import Entry
    from raystream.bench.results import BenchResult
    from raystream.bench.runner import Bench, Plan

#: Public models, and generated scenes of one and ten million triangles.
DEFAULT_SCENES = (
    *("bunny", "sponza", "sibenik", "conference", "kitchen", "bart_robots"),
    *("robots:1000000", "forest:1000000", "robots:10000000", "forest:10000000"),
)

INTERRUPTED = 130


@dataclass(frozen=True)
class ContenderOptions:
    """Options of what is compared."""

    peers: Annotated[
        str | None,
        options.value(
            "NAMES",
            f"Comma-separated peers to compare against, from {', '.join(options.PEERS)}, or "
            "'none'. Peers that are not installed are listed as absent. [default: all that "
            "support a query of the sets]",
        ),
    ] = None
    option: Annotated[
        list[str] | None,
        options.value("KEY=VALUE", "A Tracer option, such as max_leaf_size=8. Repeatable."),
    ] = None
    variant: Annotated[
        list[str] | None,
        options.value(
            "NAME:KEY=VALUE,...",
            "An additional raystream contender with these Tracer options. Repeatable.",
        ),
    ] = None


@dataclass(frozen=True)
class MeasureOptions:
    """Options of how speed is measured."""

    width: Annotated[int, options.count("Image width in pixels.", most=1 << 14)] = 1024
    height: Annotated[int, options.count("Image height in pixels.", most=1 << 14)] = 768
    repeats: Annotated[int, options.count("Rounds after the warm-up; medians are reported.")] = 5
    threads: Annotated[
        int | None,
        options.count(
            "Threads per contender, on as many cores [default: RAYSTREAM_THREADS, else "
            "one per core]"
        ),
    ] = None
    seed: Annotated[int, options.count("Seed of the random rays.", least=0)] = 0


@expand_groups
def bench(
    scenes: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[SCENE]...",
            help="Scenes, as for render, but not saved structures. Default: "
            + ", ".join(DEFAULT_SCENES),
            autocompletion=options.complete_scenes,
        ),
    ] = None,
    sets: Annotated[
        str,
        options.value("NAMES", f"Comma-separated ray sets, from {', '.join(options.RAY_SETS)}."),
    ] = ",".join(options.DEFAULT_SETS),
    *,
    contenders: ContenderOptions,
    measuring: MeasureOptions,
    output: Annotated[
        Path | None,
        options.output(
            "Write all measurements as they are made; with --report: tables (.md, .rst) or "
            "the chart (.svg).",
            metavar="FILE.json",
        ),
    ] = None,
    resume: Annotated[
        bool, options.flag("--resume", "Keep the scenes that are complete in --output.")
    ] = False,
    report: Annotated[
        Path | None,
        options.value(
            "FILE.json", "Measure nothing: show a stored result, or write it to --output."
        ),
    ] = None,
    json: options.Json = False,
) -> None:
    """Compare speed with other ray tracers. All trace the same rays, taking turns."""
    from raystream.bench.results import write_result

    if report is not None:
        if scenes or resume:
            raise BadInputError("--report: cannot be combined with scenes or --resume")
        _report(report, output, json)
        return
    chosen_sets = _names("--sets", sets, options.RAY_SETS)
    if output is not None:
        options.check_output(output, (".json",), inputs=scenes or ())
    elif resume:
        raise BadInputError("--resume: needs --output, the result to resume")
    entries = _entries(contenders, chosen_sets)
    choose_threads(measuring.threads)
    from raystream.bench.cores import limit_cores
    from raystream.bench.runner import Bench, Plan
    from raystream.jit.threads import thread_count

    plan = Plan(
        entries,
        chosen_sets,
        (measuring.width, measuring.height),
        measuring.repeats,
        thread_count(),
        measuring.seed,
    )
    earlier = None
    if resume and output is not None and output.exists():
        earlier = _read(output)

    def keep(result: BenchResult) -> None:
        if output is not None:
            with refuse(OSError, where=str(output)):
                write_result(output, result)

    # Output printed by packages is not part of the figures.
    with limit_cores(plan.threads), contextlib.redirect_stdout(sys.stderr):
        with refuse(ValueError, where="--resume"):
            running = Bench(plan, keep, earlier)
        interrupted = False
        try:
            with running:
                _run(running, plan, scenes or list(DEFAULT_SCENES), not scenes)
        except KeyboardInterrupt:
            interrupted = True
    if running.result.scenes or not interrupted:
        keep(running.result)
        _show(running.result, json)
    if interrupted:
        raise typer.Exit(INTERRUPTED)


def _run(running: Bench, plan: Plan, scenes: list[str], by_default: bool) -> None:
    from raystream.bench.contender_process import ContenderError
    from raystream.bench.runner import OtherContendersError
    from raystream.core.errors import RaystreamError
    from raystream.scene.load import load

    started, done = time.perf_counter(), 0
    with Bars() as bars:
        with (
            bars.step("starting"),
            refuse(ValueError, TypeError, where="--option, --variant"),
            refuse(OtherContendersError, where="--resume"),
        ):
            running.open()
        todo = [name for name in scenes if not running.has(name)]
        if len(todo) > 1:
            write_note(f"{len(todo)} scenes: {_minutes(plan.expected_seconds(len(todo)))}")
        for number, name in enumerate(todo):
            place = f" ({number + 1} of {len(todo)})" if len(todo) > 1 else ""
            try:
                with bars.step(f"{one_line(name)}{place}: loading"), refuse(ValueError, where=name):
                    scene = load(name)
                    if scene.triangle_count == 0:
                        raise BadInputError(f"{name}: holds no triangles")
            except RaystreamError as error:
                if not by_default:
                    raise
                running.result.skipped[name] = str(error)
                continue
            with (
                bars.step(f"{one_line(name)}{place}") as progress,
                refuse(ContenderError, where=f"{one_line(name)}: raystream"),
            ):
                running.run(name, scene, progress)
            del scene
            done += 1
            spent = time.perf_counter() - started
            if number + 1 < len(todo):
                left = _minutes(spent / done * (len(todo) - number - 1))
                write_note(f"{one_line(name)}: done after {spent / 60.0:.1f} minutes; {left} left")


def _minutes(seconds: float) -> str:
    return f"about {max(1, round(seconds / 60.0))} minutes"


def _report(source: Path, output: Path | None, json: bool) -> None:
    """Show a stored result, or write what is made of it."""
    from raystream.bench.report import REPORT_SUFFIXES, write_report

    if output is not None:
        options.check_output(output, REPORT_SUFFIXES, inputs=[str(source)])
    result = _read(source)
    if output is None:
        _show(result, json)
        return
    with refuse(OSError, where=str(output)):
        write_report(output, result)


def _read(path: Path) -> BenchResult:
    from raystream.bench.results import read_result

    with refuse(OSError, ValueError, where=str(path)):
        return read_result(path)


def _names(option: str, text: str, known: tuple[str, ...]) -> list[str]:
    """Split comma-separated names."""
    names = [name.strip() for name in text.split(",") if name.strip()]
    for name in names:
        if name not in known:
            raise BadInputError(f"{option}: expected some of {', '.join(known)}, got {name!r}")
    if not names:
        raise BadInputError(f"{option}: expected some of {', '.join(known)}")
    return names


def _entries(contenders: ContenderOptions, sets: list[str]) -> list[Entry]:
    from raystream.bench.contenders import PEERS, Entry
    from raystream.bench.ray_sets import RAY_SETS

    peers = contenders.peers
    if peers is None:
        points = {RAY_SETS[name].query == "closest" for name in sets}
        names = [
            name
            for name, peer in PEERS.items()
            if (peer.for_points and True in points) or (peer.for_rays and False in points)
        ]
    else:
        names = [] if peers == "none" else _names("--peers", peers, options.PEERS)
    shared = parse_keywords("--option", contenders.option or [])
    entries = [Entry("raystream", "raystream", shared)]
    for text in contenders.variant or []:
        name, colon, rest = text.partition(":")
        if not colon or not name.strip() or "=" in name:
            raise BadInputError(f"--variant: expected NAME:KEY=VALUE,..., got {text!r}")
        own = parse_keywords("--variant", rest.split(","))
        entries.append(Entry(name.strip(), "raystream", {**shared, **own}))
    entries += [Entry(name, name, {}) for name in names]
    labels = [entry.label for entry in entries]
    for label in labels:
        if labels.count(label) > 1:
            raise BadInputError(f"--variant or --peers: {label!r} is given twice")
    return entries


def _show(result: BenchResult, json: bool) -> None:
    if json:
        write_json(result.as_json())
        return
    from raystream.bench.report import make_notes, make_tables

    for table in make_tables(result):
        write_line(one_line(table.title))
        write_line(format_table(table.columns, table.rows, right=range(1, len(table.columns))))
        write_line()
    for note in make_notes(result):
        write_line(one_line(note))

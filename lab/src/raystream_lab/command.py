"""``raystream lab``: re-run the papers' experiments, beside the published results."""

from __future__ import annotations

import datetime as dt
import shlex
import sys
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from raystream._version import __version__
from raystream.cli import options
from raystream.cli.bars import Bars
from raystream.cli.console import (
    InterruptedRunError,
    refuse,
    write_json,
    write_line,
    write_note,
)
from raystream.cli.load import choose_threads
from raystream.cli.option_groups import expand_groups
from raystream.cli.tables import format_table
from raystream_lab.devices import DEVICES
from raystream_lab.experiments import PAPERS

if TYPE_CHECKING:
    from raystream_lab.experiments import Experiment, Outcome
    from raystream_lab.report import About

#: Default folder of the report.
_FOLDER = Path("raystream-lab")


@dataclass(frozen=True)
class RunOptions:
    """Options of how experiments run."""

    size: Annotated[
        int | None,
        typer.Option(
            min=16,
            max=4096,
            metavar="N",
            help="Width and height of images [default: those of each paper]",
        ),
    ] = None
    quick: Annotated[
        bool,
        typer.Option(help="Small images, scenes and sweeps, as a smoke test."),
    ] = False
    resume: Annotated[
        bool,
        typer.Option(help="Reuse the measurements of an earlier run in the folder."),
    ] = False
    device: Annotated[
        str,
        typer.Option(
            metavar="DEVICE",
            help="cpu, graphics or cuda; the last two run only the experiments for a GPU.",
            autocompletion=options.complete(DEVICES),
        ),
    ] = "cpu"


@expand_groups
def lab(
    papers: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[PAPER]...",
            help=f"{', '.join(PAPERS)} or all.",
            autocompletion=options.complete((*PAPERS, "all")),
        ),
    ] = None,
    only: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME",
            help="Run only this experiment. Repeatable; see --list.",
        ),
    ] = None,
    show_list: Annotated[
        bool, typer.Option("--list", help="List the experiments and exit.")
    ] = False,
    output: Annotated[
        Path,
        typer.Option("--output", "-o", metavar="FOLDER", help="Folder of the report."),
    ] = _FOLDER,
    *,
    run: RunOptions,
    threads: options.Threads = None,
    json: options.Json = False,
) -> None:
    """Re-run the experiments of four papers. Shows our results next to the published ones."""
    from raystream_lab.experiments import choose

    with refuse(ValueError):
        experiments = choose(papers or ["all"], only or [], run.device)
    if show_list:
        rows = [[one.name, one.title] for one in experiments]
        write_json(dict(rows)) if json else write_line(format_table(["", ""], rows))
        return
    choose_threads(threads)
    from raystream.core.errors import RaystreamError
    from raystream_lab.devices import open_facts

    with refuse(RaystreamError):
        facts = open_facts(run.device)
    with refuse(OSError, where=str(output)):
        (output / "pictures").mkdir(parents=True, exist_ok=True)
    from raystream_lab import Runner, Store, run_all
    from raystream_lab.report import build_html, write_report
    from raystream_lab.store import FILE_NAME

    settings: dict[str, Any] = {"quick": run.quick, "size": run.size}
    if run.device != "cpu":
        settings["device"] = run.device
    store = Store(output / FILE_NAME, settings, _source())
    if run.resume:
        store.read()
    with Bars() as bars:
        runner = Runner(
            output / "pictures",
            store,
            size=run.size,
            quick=run.quick,
            watch=_watch(bars),
            device=run.device,
        )
        try:
            outcomes = run_all(runner, experiments, _progress(experiments))
        except KeyboardInterrupt:
            raise InterruptedRunError(
                f"{len(store.values)} measurements are saved in {output}; rerun with --resume to "
                "continue"
            ) from None
    about = _about(papers or ["all"], only or [], output, settings, store.foreign_count)
    about = about._replace(adapter=facts.text)
    with refuse(OSError, where=str(output)):
        write_report(output, outcomes, about)
        page = build_html(output)
    _show(outcomes, about, json)
    write_note(f"wrote {output / 'index.md'}, {page} and {output / 'report.json'}")


def _source() -> str:
    from raystream_lab.source_key import source_key

    return source_key()


def _watch(bars: Bars) -> Any:
    """Show each measurement as a step of the bars."""

    def begin(title: str) -> AbstractContextManager[Any]:
        return bars.step(title)

    return begin


def _progress(experiments: list[Experiment]) -> Callable[[int, int], None] | None:
    """Write a line for each experiment to a log; None where bars are shown instead."""
    if sys.stderr.isatty():
        return None
    return lambda done, total: write_note(f"{done} of {total}: {experiments[done - 1].name}")


def _about(
    papers: list[str],
    only: list[str],
    output: Path,
    settings: dict[str, Any],
    foreign_count: int,
) -> About:
    from raystream.bench.machine import describe_machine
    from raystream.jit.threads import thread_count
    from raystream_lab.report import About

    words = ["raystream", "lab", *papers]
    words += [word for name in only for word in ("--only", name)]
    words += ["--device", settings["device"]] if "device" in settings else []
    words += ["--size", str(settings["size"])] if settings["size"] is not None else []
    words += ["--quick"] if settings["quick"] else []
    words += ["-o", str(output)] if output != _FOLDER else []
    return About(
        shlex.join(words),
        describe_machine(thread_count()),
        __version__,
        _source(),
        dt.date.today().isoformat(),
        foreign_count,
        settings["quick"],
        settings.get("device", "cpu"),
    )


def _show(outcomes: list[Outcome], about: About, json: bool) -> None:
    """Print every table, and the verdicts."""
    from raystream_lab.report.cell_text import are_numbers, cell_text
    from raystream_lab.report.write import as_json

    if json:
        write_json(as_json(outcomes, about))
        return
    for experiment, result, _ in outcomes:
        write_line(f"\n== {experiment.name}: {experiment.title}")
        for table in result.tables:
            write_line(f"\n{table.title}")
            right = [k for k, one in enumerate(are_numbers(table)) if one]
            rows = [[cell_text(cell) for cell in row] for row in table.rows]
            if rows:
                write_line(format_table(table.columns, rows, right))
        for claim in result.claims:
            write_line(f"\n{claim.verdict}: {claim.text} ({claim.source}); {claim.evidence}")
        for note in result.notes:
            write_note(note)

"""``raystream warm``: compile kernels before they are needed."""

from __future__ import annotations

from typing import Annotated

import typer

from raystream.cli import options
from raystream.cli.bars import Bars
from raystream.cli.console import BadInputError, write_json, write_line
from raystream.cli.load import Stopwatch, choose_threads
from raystream.core.cache_folder import cache_folder, is_writable, kernel_folder

TASKS = ("render", "query", "build", "all")


def warm(
    task: Annotated[
        str,
        typer.Argument(
            metavar="TASK",
            help="Commands whose kernels are compiled: render, query, build or all.",
            autocompletion=options.complete(TASKS),
        ),
    ] = "all",
    threads: options.Threads = None,
    json: options.Json = False,
) -> None:
    """Compile kernels before they are needed. Uses all cores; --threads limits the processes.

    Compiled kernels are cached in RAYSTREAM_CACHE_DIR, or the user's cache folder, so that
    the first image or query starts at once. Only kernels of the default structure are compiled
    in advance; others are compiled on first use.
    """
    if task not in TASKS:
        raise BadInputError(f"TASK: expected one of {', '.join(TASKS)}; got {task!r}")
    choose_threads(threads)
    from raystream.jit import warm as kernels
    from raystream.jit.threads import thread_count

    watch = Stopwatch()
    entries = kernels.entries_of(task)
    if not is_writable(kernel_folder()):
        raise BadInputError(
            f"warm: {kernel_folder()} cannot be written; set RAYSTREAM_CACHE_DIR to another folder"
        )
    with Bars() as bars, bars.step("compiling kernels") as progress, watch.measure("compile"):

        def show(share: float) -> None:
            if progress is not None:
                progress(round(100 * share), 100)

        count = kernels.warm(entries, task, thread_count(), show)
    if json:
        figures = {"task": task, "kernels": len(entries), "compiled": count}
        write_json({**figures, "seconds": watch.rounded(), "folder": str(cache_folder())})
    else:
        write_line(
            f"{len(entries)} kernels, {count} of them compiled now; "
            f"cached in {cache_folder()}; {watch.text()}"
        )

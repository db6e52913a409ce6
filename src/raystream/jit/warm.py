"""Precompilation: kernels compiled before they are needed, in several processes.

``kernels.json`` lists the kernels that the commands compile, the types of their arguments, and the
seconds that each took. Threads gain nothing (Numba and LLVM have one lock each), so processes
share the list: each takes kernels that no other has locked (see `compile_lock`).
"""

from __future__ import annotations

import importlib
import json
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from raystream.jit.cache import KERNELS
from raystream.jit.signatures import decode_type

#: Groups of kernels that can be compiled.
TASKS = ("render", "query", "build", "all")

FILE = Path(__file__).with_name("kernels.json")

#: Suffix of kernels for plain scenes.
PLAIN = "_of_plain_scenes"

#: Seconds between two checks of what other processes have compiled.
_PAUSE = 0.25

#: The room whose classes and searches make kernels of their own functions.
_MAKERS = "raystream.structures"


class Entry(NamedTuple):
    """A kernel to be compiled.

    Attributes
    ----------
    kernel : str
        As in `jit.cache.KERNELS`.
    types : list
        Types of its arguments; see `signatures`.
    tasks : list of str
        Commands that need it.
    seconds : float
        Compile time, on some machine.
    """

    kernel: str
    types: list[Any]
    tasks: list[str]
    seconds: float


def entries_of(task: str, file: Path = FILE) -> list[Entry]:
    """Kernels that a task needs, by decreasing compile time.

    Parameters
    ----------
    task : str
        One of `TASKS`, or a part of one: ``"render-ao"``, ``"query-first"``. With ``":full"``, as
        in ``"render-path:full"``, of scenes that are not plain; see `shading.plain_scenes`.
    file : Path, optional
        Another list.
    """
    entries = [Entry(**row) for row in json.loads(file.read_text(encoding="utf-8"))]
    part, _, of_full = task.partition(":")
    found = [
        entry
        for entry in entries
        if task == "all"
        or task in entry.tasks
        or (
            any(one == part or one.startswith(f"{part}-") for one in entry.tasks)
            and not (of_full and entry.kernel.endswith(PLAIN))
        )
    ]
    return sorted(found, key=lambda entry: -entry.seconds)


def compile_kernels(entries: Sequence[Entry], *, takes_all: bool = False) -> int:
    """Compile the kernels that are not on disk yet.

    Parameters
    ----------
    entries : sequence of Entry
        Entries without a kernel of this name and signature are skipped.
    takes_all : bool
        Whether to wait for kernels that another process is compiling, rather than skip them.

    Returns
    -------
    int
        Number of kernels that this process compiled.
    """
    count = 0
    for entry in entries:
        ready = _prepare(entry)
        if ready is None:
            continue
        dispatcher, signature = ready
        if takes_all or dispatcher._cache.is_free(signature, dispatcher.targetctx):
            before = sum(dispatcher.stats.cache_misses.values())
            dispatcher.compile(signature)
            count += sum(dispatcher.stats.cache_misses.values()) - before
    return count


def missing(entries: Sequence[Entry]) -> list[Entry]:
    """Entries whose kernel is not on disk."""
    left = []
    for entry in entries:
        ready = _prepare(entry)
        if ready is not None:
            dispatcher, signature = ready
            if not dispatcher._cache.is_on_disk(signature, dispatcher.targetctx):
                left.append(entry)
    return left


def warm(
    entries: Sequence[Entry], task: str, process_count: int, progress: Callable[[float], None]
) -> int:
    """Compile kernels in several processes, longest first, and wait for them.

    Parameters
    ----------
    entries : sequence of Entry
    task : str
        The task of all entries.
    process_count : int
        Including this process.
    progress : callable
        Called with the fraction done, 0 to 1.

    Returns
    -------
    int
        Number of kernels that were not on disk.
    """
    left = missing(entries)
    total, count = sum(entry.seconds for entry in left), len(left)
    helpers = start_helpers(task, min(process_count, count))
    try:
        while left and any(helper.poll() is None for helper in helpers):
            progress(1.0 - sum(entry.seconds for entry in left) / total)
            time.sleep(_PAUSE)
            left = missing(left)
    finally:
        stop_helpers(helpers)
    compile_kernels(left, takes_all=True)  # left by a helper that died
    progress(1.0)
    return count


def start_helpers(task: str, count: int) -> list[Any]:
    """Start processes that compile a task's kernels, except those locked by other processes."""
    command = [sys.executable, "-m", __name__, task]
    quiet = subprocess.DEVNULL
    return [
        subprocess.Popen(command, stdin=quiet, stdout=quiet, stderr=quiet) for _ in range(count)
    ]


def stop_helpers(helpers: Sequence[Any]) -> None:
    """Terminate processes; kernels that they have finished stay on disk."""
    for helper in helpers:
        helper.terminate()
    for helper in helpers:
        helper.wait()


def _prepare(entry: Entry) -> tuple[Any, Any] | None:
    """The kernel of an entry and its signature; None if there is no such kernel."""
    try:
        importlib.import_module(entry.kernel.partition(":")[0])
        if "[" in entry.kernel:
            makers = importlib.import_module(_MAKERS)
            for name in makers.STRUCTURES:
                makers.structure_class(name)
                makers.form_of(name, "nearest")
        dispatcher = KERNELS.get(entry.kernel)
        if dispatcher is None:
            return None
        return dispatcher, tuple(decode_type(code) for code in entry.types)
    except (ImportError, ValueError):
        return None


if __name__ == "__main__":
    compile_kernels(entries_of(sys.argv[1]))

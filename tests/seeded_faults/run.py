"""Seed faults into copies of the sources, one by one: which tests catch each of them?

    python tests/seeded_faults/run.py                        is each fault caught?
    python tests/seeded_faults/run.py "grid: DDA a cell off" one of them
    python tests/seeded_faults/run.py --matrix               by which files? Kept in matrix.json
    python tests/seeded_faults/run.py --matrix --until-caught  stop at a fault's first catch
    python tests/seeded_faults/run.py --cover                a small set of files that catches all
    python tests/seeded_faults/run.py --list                 their names

The tests of a fault's room run first, then those that compare tracers. Everyday tests come before
those of ci, which run only if no everyday test has caught it. If none has, all other tests follow,
until one fails. A test that has caught a fault must pass without any; otherwise the fault is tried
again without that test.

Without ``--matrix`` a fault is tried until something catches it, and first with the tests that the
matrix names. Nothing is kept. With it, faults whose row is up to date are left out: that of a
fault is stale once its entry, the code of its file or the tier of the tests that caught it has
changed. Rows are written one by one; an interrupted run resumes.

The exit status is 1 if a fault was not caught.
"""

from __future__ import annotations

import argparse
import os
import queue
import signal
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_EXCEPTION, ThreadPoolExecutor, wait
from contextlib import contextmanager
from pathlib import Path

if not __package__:  # a script
    sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from seeded_faults.attempts import ERROR, NOTHING, Row, try_fault
from seeded_faults.by_file import EVERYDAY
from seeded_faults.faults import FAULTS, ROOT, Fault, chosen_faults, read_faults
from seeded_faults.matrix import (
    MATRIX,
    cover,
    is_current,
    read_matrix,
    refreshed,
    summary,
    write_matrix,
)
from seeded_faults.runner import Baseline, Runner, StoppedError


def parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("names", nargs="*", metavar="NAME", help="faults, or rooms [default: all]")
    parser.add_argument("--list", action="store_true", help="print the faults, and end")
    parser.add_argument("--cover", action="store_true", help="print files that suffice, and end")
    parser.add_argument("--matrix", action="store_true", help="update matrix.json")
    parser.add_argument(
        "--until-caught", action="store_true", help="with --matrix: one catch of a fault suffices"
    )
    parser.add_argument(
        "--again", action="store_true", help="with --matrix: also faults whose row is up to date"
    )
    parser.add_argument(
        "--workers", type=int, default=2, metavar="N", help="faults at a time [default: 2]"
    )
    parser.add_argument(
        "--time-limit",
        type=float,
        default=3600.0,
        metavar="SECONDS",
        help="for one run of pytest, of which a fault has two or three [default: 3600]",
    )
    parser.add_argument(
        "--test-limit",
        type=float,
        default=300.0,
        metavar="SECONDS",
        help="for one test [default: 300]",
    )
    return parser.parse_args(arguments)


@contextmanager
def runners(root: Path, asked: argparse.Namespace, count: int) -> Iterator[list[Runner]]:
    """Copies of the tree, with one folder of kernels."""
    with tempfile.TemporaryDirectory(prefix="raystream-faults-") as folder:
        cache = Path(os.environ.get("RAYSTREAM_CACHE_DIR") or Path(folder) / "cache").resolve()
        made = [
            Runner(root, Path(folder) / str(i), cache, asked.time_limit, asked.test_limit)
            for i in range(count)
        ]
        for runner in made:
            runner.check_import()
        yield made


def in_parallel(
    faults: Sequence[Fault], made: Sequence[Runner], work: Callable[[Fault, Runner], None]
) -> None:
    """Have each runner take faults until none is left; an exception ends all of them."""
    left: queue.SimpleQueue[Fault] = queue.SimpleQueue()
    for fault in faults:
        left.put(fault)
    is_ending = threading.Event()

    def take(runner: Runner) -> None:
        while not is_ending.is_set():
            try:
                fault = left.get_nowait()
            except queue.Empty:
                return
            work(fault, runner)

    with ThreadPoolExecutor(len(made)) as pool:
        futures = [pool.submit(take, runner) for runner in made]
        try:
            wait(futures, return_when=FIRST_EXCEPTION)
        finally:
            if not all(future.done() for future in futures):
                is_ending.set()
                for runner in made:
                    runner.stop()
    errors = [error for future in futures if (error := future.exception()) is not None]
    for error in sorted(errors, key=lambda error: isinstance(error, StoppedError)):
        raise error


def line_of(name: str, row: Row, seconds: float) -> str:
    """A fault's result for people."""
    by = " ".join(list(row.by.values())[:1]) + (f" and {len(row.by) - 1} more" * (len(row.by) > 1))
    return f"{name}  {row.verdict.upper():8} {seconds:6.0f} s  {by or row.reason}"


def try_faults(
    chosen: Sequence[Fault],
    asked: argparse.Namespace,
    root: Path,
    known: dict[str, Row],
    keep: Callable[[str, Row], None],
) -> None:
    """Try faults, with --matrix those whose row is not up to date; `keep` receives each result."""
    stops_early = asked.until_caught or not asked.matrix
    lock = threading.Lock()
    baseline = Baseline()

    def work(fault: Fault, runner: Runner) -> None:
        started = time.monotonic()
        row = known.get(fault.name)
        is_hint = row is not None and (row.verdict == EVERYDAY or not asked.matrix)
        found = try_fault(
            fault,
            runner,
            baseline,
            stops_early=stops_early,
            hints=row.by if row is not None and is_hint and stops_early else {},
        )
        with lock:
            keep(fault.name, found)
            print(line_of(fault.name, found, time.monotonic() - started), flush=True)

    with runners(root, asked, max(1, min(asked.workers, len(chosen)))) as made:
        todo = list(chosen)
        if asked.matrix and not asked.again:
            refresh(known, chosen, made[0])
            todo = [
                fault
                for fault in chosen
                if not is_current(known.get(fault.name), fault, root, stops_early=stops_early)
            ]
            print(f"{len(chosen) - len(todo)} rows are up to date", flush=True)
        in_parallel(todo, made, work)
    for test in baseline.false_positives:
        print(f"fails without any fault: {test}", flush=True)


def refresh(rows: dict[str, Row], chosen: Sequence[Fault], runner: Runner) -> None:
    """Take tests that have left their tier, or are gone, out of these faults' rows."""
    files = {file for fault in chosen if fault.name in rows for file in rows[fault.name].by}
    tiers = runner.tiers(sorted(file for file in files if (runner.copy / file).exists()))
    for fault in chosen:
        if (row := rows.pop(fault.name, None)) and (left := refreshed(row, fault, tiers)):
            rows[fault.name] = left


def main(
    arguments: Sequence[str] | None = None,
    root: Path = ROOT,
    faults: Path = FAULTS,
    matrix: Path = MATRIX,
) -> int:
    """Run it; returns the exit status."""
    asked = parse(arguments)
    listed = read_faults(faults)
    chosen = chosen_faults(asked.names, listed)
    if asked.list:
        print("\n".join(f"{fault.name}: {fault.what}" for fault in chosen))
        return 0
    names = {fault.name for fault in listed}
    known = {name: row for name, row in read_matrix(matrix).items() if name in names}
    if asked.cover:
        print("\n".join(summary(known, chosen, root)))
        for file, caught in cover(known, chosen):
            print(f"{len(caught):4}  {file}")
        return 0
    found = known if asked.matrix else {}

    def keep(name: str, row: Row) -> None:
        found[name] = row
        if asked.matrix:
            write_matrix(matrix, found)

    status = 0
    try:
        try_faults(chosen, asked, root, known, keep)
    except KeyboardInterrupt:
        status = 130
    except RuntimeError as error:
        print(error, flush=True)
        status = 2
    if asked.matrix:
        write_matrix(matrix, found)  # without rows that are gone
    print("\n" + "\n".join(summary(found, chosen, root)), flush=True)
    failed = [fault for fault in chosen if fault.name in found]
    failed = [fault for fault in failed if found[fault.name].verdict in (NOTHING, ERROR)]
    for fault in failed:
        print(f"not caught: {fault.name}  {found[fault.name].reason}", flush=True)
    return status or int(bool(failed))


if __name__ == "__main__":
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # ends as Ctrl-C does
    sys.exit(main())

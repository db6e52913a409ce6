"""Seed faults into a copy of the sources, one by one: do the tests catch each of them?

    python tests/seeded_faults/run.py                        all of faults.toml
    python tests/seeded_faults/run.py "grid: DDA a cell off" one of them
    python tests/seeded_faults/run.py --list                 their names

The tests of the fault's room run first, then the rest of the everyday suite, until one fails. A
test that has caught a fault must then pass without any; otherwise the fault is tried again without
that test. Prints a table; exits 1 if a fault was not caught.
"""

from __future__ import annotations

import argparse
import contextlib
import hashlib
import importlib.util
import itertools
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
import tomllib
import uuid
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
FAULTS = Path(__file__).with_name("faults.toml")
SOURCES, LAB = "src/raystream", "lab/src/raystream_lab"

#: Seconds that pytest gets to end by itself after a failure: other tests may not come back.
GRACE = 30.0

#: Variable by which the processes of a run of pytest are known, wherever they went.
_MARK = "RAYSTREAM_SEEDED_RUN"

#: A failure as pytest-xdist prints it when it happens, and as it is in pytest's summary.
_LIVE = re.compile(r"\[gw\d+\] \[ *\d+%\] (?:FAILED|ERROR) (?P<test>.+)")
_SUMMARY = re.compile(r"(?:FAILED|ERROR) (?P<test>(?:tests|src|lab)/.+?)(?: - .*)?")

#: Not needed in the copy; and the faults' own tests, which would notice every fault.
_LEFT_OUT = (".git", ".venv", ".*_cache", ".hypothesis", "__pycache__", "_build", "seeded_faults")

CAUGHT, SURVIVED, TIMED_OUT = "caught", "NOT CAUGHT", "OUT OF TIME"
NOT_RUN, BROKEN = "not run", "NO TESTS RAN"


@dataclass(frozen=True)
class Fault:
    """An entry of faults.toml, where the fields are explained."""

    name: str
    what: str
    file: str
    old: str
    new: str
    tests: tuple[str, ...]
    needs: tuple[str, ...] = ()
    environment: Mapping[str, str] = field(default_factory=dict)
    hangs: bool = False

    @property
    def path(self) -> str:
        """The file, from the repository's root."""
        room, _, rest = self.file.partition("/")
        return f"{LAB}/{rest}" if room == "lab" else f"{SOURCES}/{self.file}"

    @property
    def room(self) -> str:
        """The package of raystream that it is in, or a top-level module; or ``lab``."""
        return self.file.partition("/")[0].removesuffix(".py")

    @property
    def missing(self) -> list[str]:
        """Modules that are needed and not installed."""
        return [name for name in self.needs if importlib.util.find_spec(name) is None]

    @property
    def digest(self) -> str:
        """Hash of everything that determines its result, except for the other sources."""
        return hashlib.sha256(repr(self).encode()).hexdigest()[:16]

    def seeded(self, text: str) -> str:
        """The file's text with the fault.

        Raises
        ------
        ValueError
            If the place is not there, or there several times.
        """
        count = text.count(self.old)
        if count != 1:
            raise ValueError(f"{self.name}: its text is {count} times in {self.path}, not once")
        return text.replace(self.old, self.new)


@dataclass
class Result:
    """Result of a fault: `by` is the test, or the reason."""

    name: str
    verdict: str
    by: str
    seconds: float
    digest: str


def read_faults(path: Path = FAULTS) -> list[Fault]:
    """Read the faults, in the order of the file."""
    entries = tomllib.loads(path.read_text(encoding="utf-8"))["faults"]
    tuples = ("tests", "needs")
    return [
        Fault(**{key: tuple(value) if key in tuples else value for key, value in entry.items()})
        for entry in entries
    ]


def copy_tree(root: Path, to: Path) -> None:
    """Copy everything that tests may read."""
    shutil.copytree(root, to, ignore=shutil.ignore_patterns(*_LEFT_OUT))


class Runner:
    """Runs tests in a copy of the tree.

    Parameters
    ----------
    copy : Path
    cache : Path
        Folder of compiled kernels, which all runs share.
    workers : int
        Processes that test.
    limit : float
        Seconds for one run of pytest.
    """

    def __init__(self, copy: Path, cache: Path, workers: int, limit: float) -> None:
        self.copy, self.limit = copy, limit
        self._moments = itertools.count(10**9)
        self._options = ["--maxfail=1", "--verbose", "--tb=short", f"--numprocesses={workers}"]
        self._environment = {
            **os.environ,
            "PYTHONPATH": os.pathsep.join([str(copy / "src"), str(copy / "lab" / "src")]),
            "RAYSTREAM_CACHE_DIR": str(cache),
        }

    def check_import(self) -> None:
        """Make sure that it is the copy that tests import."""
        command = [sys.executable, "-c", "import raystream; print(raystream.__file__)"]
        found = subprocess.check_output(
            command, cwd=self.copy, env=self._environment, text=True
        ).strip()
        if not Path(found).resolve().is_relative_to(self.copy.resolve()):
            raise SystemExit(f"tests would import {found}, and not the copy in {self.copy}")

    @contextlib.contextmanager
    def seeded(self, fault: Fault) -> Iterator[None]:
        """The copy with a fault in it."""
        path = self.copy / fault.path
        text = path.read_text(encoding="utf-8")
        self._write(path, fault.seeded(text))
        try:
            yield
        finally:
            self._write(path, text)

    def _write(self, path: Path, text: str) -> None:
        path.write_text(text, encoding="utf-8")
        # Two texts of one length, written within a second, would share a .pyc file.
        moment = next(self._moments)
        os.utime(path, (moment, moment))

    def run(
        self, arguments: Sequence[str], environment: Mapping[str, str], limit: float | None = None
    ) -> str | None:
        """Run pytest until a test fails.

        Returns
        -------
        str or None
            The test that failed first; None if all passed.

        Raises
        ------
        TimeoutError
            If none had failed when time was up.
        RuntimeError
            If pytest could not run.
        """
        shutil.rmtree(self.copy / ".hypothesis", ignore_errors=True)  # examples of other faults
        mark = uuid.uuid4().hex
        process = subprocess.Popen(
            [sys.executable, "-m", "pytest", *self._options, *arguments],
            cwd=self.copy,
            env={**self._environment, **environment, _MARK: mark},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            errors="replace",
            start_new_session=True,
        )
        watchdog = _Watchdog(process.pid, self.limit if limit is None else limit)
        failed, lines = None, []
        try:
            assert process.stdout is not None
            for line in process.stdout:
                lines.append(line)
                text = line.rstrip()
                match = _LIVE.fullmatch(text) or _SUMMARY.fullmatch(text)
                if match and failed is None:
                    failed = match["test"]
                    watchdog.restart(min(GRACE, self.limit))
            code = process.wait()
        finally:
            watchdog.stop()
            _end(process, mark)
        if failed is None and watchdog.has_bitten:
            raise TimeoutError
        if failed is None and code:
            raise RuntimeError(f"pytest ended with {code}: {' '.join(lines[-3:])[-300:]}")
        return failed


class _Watchdog:
    """Ends a process group when its time is up."""

    def __init__(self, group: int, seconds: float) -> None:
        self._group = group
        self.has_bitten = False
        self._start(seconds)

    def _start(self, seconds: float) -> None:
        self._timer = threading.Timer(seconds, self._bite)
        self._timer.daemon = True
        self._timer.start()

    def _bite(self) -> None:
        self.has_bitten = True
        _kill_group(self._group)

    def restart(self, seconds: float) -> None:
        self._timer.cancel()
        self._start(seconds)

    def stop(self) -> None:
        self._timer.cancel()


def _kill_group(group: int) -> None:
    with contextlib.suppress(ProcessLookupError):
        os.killpg(group, signal.SIGKILL)


def _end(process: subprocess.Popen[str], mark: str) -> None:
    """Kill all processes of a run, including those that left its group."""
    _kill_group(process.pid)
    process.wait()
    if process.stdout is not None:
        process.stdout.close()
    variable = f"{_MARK}={mark}".encode()
    for environment in Path("/proc").glob("[0-9]*/environ"):
        with contextlib.suppress(OSError):
            if variable in environment.read_bytes().split(b"\0"):
                os.kill(int(environment.parent.name), signal.SIGKILL)


def try_fault(
    fault: Fault, runner: Runner, room_only: bool, left_out: Sequence[str] = ()
) -> tuple[str, str]:
    """Seed a fault and run tests, except some; returns the verdict, and its reason."""
    if fault.missing:
        return NOT_RUN, f"needs {', '.join(fault.missing)}"
    without = [f"--deselect={test}" for test in left_out]
    stages = [([*fault.tests, *without], fault.environment)]
    if not room_only:
        stages.append(([*without, *(f"--deselect={test}" for test in fault.tests)], {}))
    with runner.seeded(fault):
        for arguments, environment in stages:
            try:
                failed = runner.run(arguments, environment)
            except RuntimeError as error:
                return BROKEN, " ".join(str(error).split())
            except TimeoutError:
                # A slow machine is no proof.
                verdict = CAUGHT if fault.hangs else TIMED_OUT
                return verdict, f"no test ended the run within {runner.limit:.0f} s"
            if failed is not None:
                return CAUGHT, failed
    return SURVIVED, "all tests pass"


def false_alarms(
    faults: Sequence[Fault], results: Mapping[str, Result], runner: Runner
) -> list[str]:
    """Tests among those that caught these faults that fail without any."""
    groups: dict[tuple[tuple[str, str], ...], set[str]] = {}
    for fault in faults:
        result = results[fault.name]
        if result.verdict == CAUGHT and result.by.startswith(("tests/", "src/")):
            groups.setdefault(tuple(sorted(fault.environment.items())), set()).add(result.by)
    failing = []
    for environment, tests in groups.items():
        left = sorted(tests)
        limit = runner.limit + 60.0 * len(left)
        while left and (failed := runner.run(left, dict(environment), limit)) is not None:
            failing.append(failed)
            left = [test for test in left if test != failed]
    return failing


def try_all(
    chosen: Sequence[Fault], runner: Runner, asked: argparse.Namespace, results: dict[str, Result]
) -> None:
    """Try faults, those again that a test has caught which fails anyway; fills `results`."""
    earlier = _earlier(asked)
    left_out: list[str] = []
    todo = list(chosen)
    while todo:
        for fault in todo:
            started = time.monotonic()
            result = None if left_out else earlier.get(fault.digest)
            if result is None:
                verdict, by = try_fault(fault, runner, asked.room_tests_only, left_out)
                spent = round(time.monotonic() - started, 1)
                result = Result(fault.name, verdict, by, spent, fault.digest)
            results[fault.name] = result
            print(_line_of(result), flush=True)
            _record(asked, results)
        found = false_alarms(todo, results, runner)
        for test in found:
            print(f"fails without any fault: {test}", flush=True)
        left_out += found
        todo = [fault for fault in todo if results[fault.name].by in found]


def _line_of(result: Result, width: int = 0) -> str:
    return f"{result.name:{width}}  {result.verdict:12} {result.seconds:6.0f} s  {result.by}"


def table_of(results: Sequence[Result]) -> str:
    """Results as lines for people."""
    width = max((len(result.name) for result in results), default=0)
    verdicts = Counter(result.verdict for result in results)
    total = ", ".join(f"{count} {verdict}" for verdict, count in sorted(verdicts.items()))
    lines = [_line_of(result, width) for result in results]
    return "\n".join([*lines, f"{len(results)} faults: {total or 'none'}"])


def parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("names", nargs="*", metavar="NAME", help="faults, or rooms; default: all")
    parser.add_argument("--list", action="store_true", help="print the faults, and end")
    parser.add_argument("--room-tests-only", action="store_true", help="not the rest of the suite")
    parser.add_argument("--workers", type=int, default=2, metavar="N", help="[default: 2]")
    parser.add_argument(
        "--time-limit",
        type=float,
        default=900.0,
        metavar="SECONDS",
        help="for one run of pytest, of which a fault has two [default: 900]",
    )
    parser.add_argument(
        "--json", type=Path, metavar="FILE", help="write results there, after each fault"
    )
    parser.add_argument(
        "--resume", action="store_true", help="leave out what FILE says was caught before"
    )
    return parser.parse_args(arguments)


def chosen_faults(names: Sequence[str], faults: list[Fault]) -> list[Fault]:
    """The faults of these names or rooms; all without any."""
    for name in names:
        if not any(name in (fault.name, fault.room) for fault in faults):
            raise SystemExit(f"no fault and no room {name!r}; see --list")
    return [f for f in faults if not names or f.name in names or f.room in names]


def _earlier(asked: argparse.Namespace) -> dict[str, Result]:
    if not asked.resume or asked.json is None or not asked.json.exists():
        return {}
    found = [Result(**entry) for entry in json.loads(asked.json.read_text(encoding="utf-8"))]
    return {result.digest: result for result in found if result.verdict == CAUGHT}


def _record(asked: argparse.Namespace, results: Mapping[str, Result]) -> None:
    if asked.json is not None:
        text = json.dumps([asdict(result) for result in results.values()], indent=2)
        asked.json.write_text(text + "\n", encoding="utf-8")


def main(arguments: Sequence[str] | None = None, root: Path = ROOT, faults: Path = FAULTS) -> int:
    """Run it; returns the exit status."""
    asked = parse(arguments)
    chosen = chosen_faults(asked.names, read_faults(faults))
    if asked.list:
        print("\n".join(f"{fault.name}: {fault.what}" for fault in chosen))
        return 0
    results: dict[str, Result] = {}
    status = 0
    with tempfile.TemporaryDirectory(prefix="raystream-faults-") as folder:
        copy = Path(folder) / "tree"
        copy_tree(root, copy)
        cache = Path(os.environ.get("RAYSTREAM_CACHE_DIR") or Path(folder) / "cache")
        runner = Runner(copy, cache.resolve(), asked.workers, asked.time_limit)
        runner.check_import()
        try:
            try_all(chosen, runner, asked, results)
        except KeyboardInterrupt:
            status = 130
        except (RuntimeError, TimeoutError) as error:
            print(f"cannot tell whether those tests pass without faults: {error}", flush=True)
            status = 2
    print(f"\n{table_of(list(results.values()))}", flush=True)
    if status == 0 and any(one.verdict not in (CAUGHT, NOT_RUN) for one in results.values()):
        status = 1
    return status


if __name__ == "__main__":
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # ends as Ctrl-C does
    sys.exit(main())

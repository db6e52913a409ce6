"""Run pytest in a copy of the tree, with or without a fault, and read what by_file.py notes."""

from __future__ import annotations

import contextlib
import itertools
import json
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
import uuid
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from seeded_faults.by_file import CI, EVERYDAY
from seeded_faults.faults import Fault

PLUGIN = Path(__file__).with_name("by_file.py")

#: Everyday tests and those of ci.
SELECTED = "not exhaustive and not documentation"

#: Variable by which the processes of a run of pytest are known, wherever they went.
_MARK = "RAYSTREAM_SEEDED_RUN"

#: Not needed in the copy; and the faults' own tests, which would notice every fault.
_LEFT_OUT = (".git", ".venv", ".*_cache", ".hypothesis", "__pycache__", "_build", "seeded_faults")

#: How a run of pytest ended, if not by itself: a test took too long; the run did; pytest could not
#: run; a test ended its process.
STUCK, OUT_OF_TIME, BROKEN, CRASHED = "stuck", "out of time", "no tests ran", "crashed"


class StoppedError(Exception):
    """The run was interrupted."""


@dataclass
class Outcome:
    """What a run of pytest has shown.

    Attributes
    ----------
    files : dict of str to dict
        What by_file.py has noted, by file.
    ended : str
        Empty, `STUCK`, `OUT_OF_TIME`, `BROKEN` or `CRASHED`.
    output : str
        The last lines of pytest.
    """

    files: dict[str, dict[str, Any]]
    ended: str = ""
    output: str = ""

    @property
    def running(self) -> str | None:
        """The test that had begun and not ended."""
        return next((one["running"] for one in self.files.values() if one["running"]), None)

    @property
    def failed(self) -> list[str]:
        """All tests that failed."""
        return [test for one in self.files.values() for test in one["everyday"] + one["ci"]]


class Runner:
    """Runs tests in a copy of the tree.

    Parameters
    ----------
    root : Path
    folder : Path
        Where the copy is made; it may exist.
    cache : Path
        Folder of compiled kernels, which all runners share.
    limit, test_timeout : float
        Seconds for one run of pytest, and for one test.
    """

    def __init__(
        self, root: Path, folder: Path, cache: Path, limit: float, test_timeout: float
    ) -> None:
        self.copy, self.limit, self.test_timeout = folder / "tree", limit, test_timeout
        self._folder = folder
        self._moments = itertools.count(10**9)
        self._stopping = threading.Event()
        shutil.copytree(root, self.copy, ignore=shutil.ignore_patterns(*_LEFT_OUT))
        plugins = folder / "plugins"
        plugins.mkdir()
        shutil.copy(PLUGIN, plugins)
        paths = [self.copy / "src", self.copy / "lab" / "src", plugins]
        self._environment = {
            **os.environ,
            "PYTHONPATH": os.pathsep.join(map(str, paths)),
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

    def stop(self) -> None:
        """End the run of pytest that is in progress; another thread may call this."""
        self._stopping.set()

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
        self,
        arguments: Sequence[str],
        environment: Mapping[str, str],
        test_timeout: float | None = None,
        **plan: object,
    ) -> Outcome:
        """Run pytest in one process, by a plan as in by_file.py.

        Parameters
        ----------
        arguments : list of str
            Files of tests, and options.
        environment : dict of str to str
            Variables of the process.
        test_timeout : float, optional
            Seconds for one test, in place of the runner's.
        **plan

        Raises
        ------
        StoppedError
            If `stop` was called.
        """
        shutil.rmtree(self.copy / ".hypothesis", ignore_errors=True)  # examples of other faults
        record, plans = self._folder / "record.jsonl", self._folder / "plan.json"
        record.write_text("", encoding="utf-8")
        plans.write_text(json.dumps({**plan, "record": str(record)}), encoding="utf-8")
        options = ["-p", "by_file", f"--plan={plans}", "--numprocesses=0", "-m", SELECTED]
        options += ["--doctest-modules", "--continue-on-collection-errors", "--tb=no", "-q"]
        mark = uuid.uuid4().hex
        printed = self._folder / "printed.txt"
        with printed.open("w", encoding="utf-8") as output:
            process = subprocess.Popen(
                [sys.executable, "-m", "pytest", *options, *arguments],
                cwd=self.copy,
                env={**self._environment, **environment, _MARK: mark},
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )
            try:
                ended = self._watch(process, record, test_timeout or self.test_timeout)
            finally:
                _end(process, mark)
        text = printed.read_text(encoding="utf-8", errors="replace")
        outcome = Outcome(_read(record), ended, " ".join(text.split()[-40:])[-300:])
        if not ended and outcome.running:
            outcome.ended = CRASHED
        elif not ended and process.returncode not in (0, 1, 5):  # 5: there are no tests
            outcome.ended = BROKEN
        return outcome

    def tiers(self, files: Sequence[str]) -> dict[str, str]:
        """The tier of each test of these files, and of each file: that of its everyday tests."""
        if not files:
            return {}
        found = self._folder / "tiers.json"
        found.write_text("{}", encoding="utf-8")
        outcome = self.run(files, {}, tiers=str(found))
        if outcome.ended:
            raise RuntimeError(f"pytest cannot collect the tests: {outcome.output}")
        tiers: dict[str, str] = json.loads(found.read_text(encoding="utf-8"))
        # A file that cannot be imported is noted by its own name.
        everyday = {test.partition("::")[0] for test in tiers if tiers[test] == EVERYDAY}
        return tiers | {file: EVERYDAY if file in everyday else CI for file in files}

    def _watch(self, process: subprocess.Popen[bytes], record: Path, test_timeout: float) -> str:
        """Wait for the end, or say why it will not be awaited."""
        started = last = time.monotonic()
        size = 0
        while True:
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(0.1)
                return ""
            if self._stopping.is_set():
                raise StoppedError
            now, found = time.monotonic(), record.stat().st_size
            if found != size:
                size, last = found, now
            if now - last > test_timeout:
                return STUCK
            if now - started > self.limit:
                return OUT_OF_TIME


def _read(record: Path) -> dict[str, dict[str, Any]]:
    files: dict[str, dict[str, Any]] = {}
    for line in record.read_text(encoding="utf-8").splitlines():
        with contextlib.suppress(
            json.JSONDecodeError
        ):  # the last line of a process that was killed
            one = json.loads(line)
            files[one["file"]] = one
    return files


def _end(process: subprocess.Popen[bytes], mark: str) -> None:
    """Kill all processes of a run, including those that left its group."""
    with contextlib.suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    variable = f"{_MARK}={mark}".encode()
    for environment in Path("/proc").glob("[0-9]*/environ"):
        with contextlib.suppress(OSError):
            if variable in environment.read_bytes().split(b"\0"):
                os.kill(int(environment.parent.name), signal.SIGKILL)


class Baseline:
    """Which tests pass without any fault; each is tried once for each set of variables."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._passing: set[tuple[str, tuple[tuple[str, str], ...]]] = set()
        self._failing: set[str] = set()

    @property
    def false_positives(self) -> list[str]:
        """Tests that were found to fail without any fault."""
        with self._lock:
            return sorted(self._failing)

    def check(
        self, tests: Iterable[str], environment: Mapping[str, str], runner: Runner
    ) -> list[str]:
        """Run those not known, without a fault in the copy; returns those that fail.

        Raises
        ------
        RuntimeError
            If pytest cannot run.
        """
        variables = tuple(sorted(environment.items()))
        with self._lock:
            left = sorted(test for test in tests if (test, variables) not in self._passing)
        failing: list[str] = []
        while left:
            files = sorted({test.partition("::")[0] for test in left})
            outcome = runner.run(files, environment, each=True, only=left)
            if outcome.ended == BROKEN:
                raise RuntimeError(f"pytest cannot run without a fault: {outcome.output}")
            failing += [test for test in outcome.failed if test in left]
            if outcome.running is None:
                break
            failing.append(outcome.running)
            left = [test for test in left if test not in failing]
        with self._lock:
            self._failing |= set(failing)
            self._passing |= {(test, variables) for test in tests if test not in failing}
        return failing

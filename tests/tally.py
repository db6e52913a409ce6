"""Counting of the tests of a run and of the kernels that they need, over all of its processes.

In one environment the numbers depend neither on the machine nor on the cache, so `.ci/budget` can
limit those of README's (`[test]`). ``RAYSTREAM_TEST_TALLY=FILE`` writes them there.
"""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import Any

import pytest

from raystream.jit.cache import KernelCache


class Tally:
    """A plugin: counts tests, and kernels by the names of their files in the cache.

    Parameters
    ----------
    path : Path or None
        Where the counts are written.
    """

    def __init__(self, path: Path | None) -> None:
        self._path = path
        self._cases = 0
        self._needed: set[str] = set()
        self._compiled: set[str] = set()
        self._seconds = 0.0

    def listen(self) -> None:
        """Note the kernels that this process needs from now on."""
        load, save = KernelCache.load_overload, KernelCache.save_overload
        started: dict[Any, float] = {}

        def load_overload(cache: KernelCache, sig: Any, context: Any) -> Any:
            found = load(cache, sig, context)
            name = _name_of(cache, sig, context.codegen())
            self._needed.add(name)
            if found is None:
                self._compiled.add(name)
                started[cache, sig] = time.perf_counter()
            return found

        def save_overload(cache: KernelCache, sig: Any, data: Any) -> None:
            self._seconds += time.perf_counter() - started.pop((cache, sig), time.perf_counter())
            save(cache, sig, data)

        KernelCache.load_overload = load_overload  # type: ignore[method-assign]
        KernelCache.save_overload = save_overload  # type: ignore[method-assign]

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        self._cases += report.when == "setup"

    def pytest_sessionfinish(self, session: pytest.Session) -> None:
        """A worker hands its kernels to the process that started it."""
        if (output := getattr(session.config, "workeroutput", None)) is not None:
            output["kernels"] = [sorted(self._needed), sorted(self._compiled), self._seconds]

    @pytest.hookimpl(optionalhook=True)
    def pytest_testnodedown(self, node: Any) -> None:
        needed, compiled, seconds = getattr(node, "workeroutput", {}).get("kernels", ((), (), 0.0))
        self._needed.update(needed)
        self._compiled.update(compiled)
        self._seconds += seconds

    def pytest_terminal_summary(self, terminalreporter: pytest.TerminalReporter) -> None:
        terminalreporter.write_line(
            f"{self._cases:,} cases needed {len(self._needed)} kernels, of which "
            f"{len(self._compiled)} were compiled in {self._seconds:.0f} s of processor time"
        )
        if self._path is not None:
            counts = {"cases": self._cases, "kernels": len(self._needed)}
            self._path.write_text(json.dumps(counts) + "\n", encoding="utf-8")


def _name_of(cache: KernelCache, sig: Any, codegen: Any) -> str:
    """The name of a kernel's file; another one that is unique, if it has no file."""
    return cache._file_name(sig, codegen.magic_tuple()) or f"{cache.name} {sig}"

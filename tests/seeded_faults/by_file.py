"""A plugin for pytest: note for each file of tests the first everyday and ci test that fails.

`python -m pytest -p by_file --plan FILE` reads a plan from a file of JSON:

- ``record``: file to which a line of JSON is added whenever something is known. The last line of
  each file of tests counts: ``file``; ``everyday`` and ``ci``, lists of the tests that failed;
  ``seconds``; ``running``, the test that has begun and not ended, or null, and its ``tier``;
  ``status``, which is ``caught``, ``clean``, ``skipped`` if no test of it has run to its end, or
  ``error`` if the file could not be imported.
- ``each``: run every test; otherwise the rest of a file is skipped once an everyday test of it
  has failed, and tests of ci run only if no everyday test failed at all.
- ``caught``: an everyday test has failed before.
- ``stop``: stop at the first failure.
- ``tier``: that of all tests, in place of the one that their marks give.
- ``only``, ``without``: ids of tests that run alone, or do not run.
- ``tiers``: file to which the tier of each test is written, as JSON; no test runs.

Tests of ci run after all others.
"""

from __future__ import annotations

import json
import time
from collections import Counter, defaultdict
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import pytest

EVERYDAY, CI = "everyday", "ci"


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--plan", type=Path, help="file of JSON, see by_file.py")


def pytest_configure(config: pytest.Config) -> None:
    plan = json.loads(config.getoption("plan").read_text(encoding="utf-8"))
    config.pluginmanager.register(_ByFile(plan))


@dataclass
class _State:
    """What is known of a file: a line of the record."""

    file: str
    everyday: list[str] = field(default_factory=list)
    ci: list[str] = field(default_factory=list)
    seconds: float = 0.0
    running: str | None = None
    tier: str = EVERYDAY
    status: str = "skipped"


class _ByFile:
    def __init__(self, plan: dict[str, Any]) -> None:
        self._record = Path(plan["record"])
        self._runs_each, self._stops = plan.get("each", False), plan.get("stop", False)
        self._is_caught = plan.get("caught", False)
        self._tiers_file = plan.get("tiers")
        self._tier = plan.get("tier")
        self._only = set(plan["only"]) if "only" in plan else None
        self._without = set(plan.get("without", ()))
        self._states: dict[str, _State] = {}
        self._tiers: dict[str, str] = {}
        self._left: defaultdict[str, Counter[str]] = defaultdict(Counter)
        self._session: pytest.Session | None = None

    def pytest_sessionstart(self, session: pytest.Session) -> None:
        self._session = session

    def pytest_collectreport(self, report: pytest.CollectReport) -> None:
        # Of everyday until more is known: it has no tests whose marks could say it.
        is_new = report.nodeid not in self._without
        if report.failed and is_new and _file_of(report.nodeid).endswith(".py"):
            self._note(report.nodeid, self._tier or EVERYDAY, "error")

    @pytest.hookimpl(trylast=True)
    def pytest_collection_modifyitems(
        self, config: pytest.Config, items: list[pytest.Item]
    ) -> None:
        kept = [item for item in items if self._is_wanted(item.nodeid)]
        if len(kept) < len(items):
            left_out = [item for item in items if not self._is_wanted(item.nodeid)]
            config.hook.pytest_deselected(items=left_out)
        for item in kept:
            # The examples of docstrings are marked by tests/conftest.py, if that is read.
            is_ci = isinstance(item, pytest.DoctestItem) or item.get_closest_marker("ci")
            self._tiers[item.nodeid] = self._tier or (CI if is_ci else EVERYDAY)
            self._left[self._tiers[item.nodeid]][_file_of(item.nodeid)] += 1
        places = {_file_of(item.nodeid): i for i, item in reversed(list(enumerate(kept)))}
        items[:] = sorted(
            kept,  # one file after the other, so that one test is running in the record
            key=lambda item: (self._tiers[item.nodeid] == CI, places[_file_of(item.nodeid)]),
        )
        if self._tiers_file is not None:
            Path(self._tiers_file).write_text(json.dumps(self._tiers), encoding="utf-8")
            items.clear()

    def _is_wanted(self, test: str) -> bool:
        return (self._only is None or test in self._only) and test not in self._without

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Iterator[None]:
        started = time.monotonic()
        try:
            return (yield)
        finally:
            state, left = self._state(item.nodeid), self._left[self._tiers[item.nodeid]]
            state.seconds = round(state.seconds + time.monotonic() - started, 3)
            left[state.file] -= 1
            was_running, state.running = state.running is not None, None
            has_failed = item.nodeid in (*state.everyday, *state.ci)
            if was_running and (has_failed or not left[state.file]):
                self._write(state)

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtest_setup(self, item: pytest.Item) -> None:
        # As a test that skips: pytest then tears down what the tests before it have set up.
        if self._is_needless(item.nodeid):
            pytest.skip("another test has failed")
        state = self._state(item.nodeid)
        state.running, state.tier = item.nodeid, self._tiers[item.nodeid]
        self._write(state)

    def _is_needless(self, test: str) -> bool:
        if self._runs_each:
            return False
        state = self._state(test)
        if self._tiers[test] == EVERYDAY:
            return bool(state.everyday)
        return bool(state.ci) or self._is_caught

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        state = self._state(report.nodeid)
        if report.failed:
            self._note(report.nodeid, self._tiers[report.nodeid], "caught")
        elif report.passed and report.when == "call" and state.status == "skipped":
            state.status = "clean"

    def _note(self, test: str, tier: str, status: str) -> None:
        state = self._state(test)
        failed: list[str] = getattr(state, tier)
        if test not in failed:  # a test may fail and then fail to clean up
            failed.append(test)
        state.status = status
        self._is_caught = self._is_caught or tier == EVERYDAY
        self._write(state)
        if self._stops and self._session is not None:
            self._session.shouldfail = "a test has failed"

    def _state(self, test: str) -> _State:
        file = _file_of(test)
        return self._states.setdefault(file, _State(file))

    def _write(self, state: _State) -> None:
        with self._record.open("a", encoding="utf-8") as file:
            file.write(json.dumps(asdict(state)) + "\n")


def _file_of(test: str) -> str:
    return test.partition("::")[0]

"""Runs another library's own tests twice: with its classes, and with our adapter in their place."""

import collections
import json
import os
import subprocess
import sys
from typing import Any, NamedTuple


class Peer(NamedTuple):
    """A library, and how a script runs its tests.

    `explained` has the tests that fail with the adapter, with the fault of the library that they
    test. `replace(calls)` puts the adapter in place of the library's classes; see `counted`. The
    script is called again, with a path, ``--run`` and one of the two names, and answers by `run`.
    """

    name: str
    version: str
    script: str
    explained: dict[str, str]
    replace: Any

    def compare(self, path):
        """Run the tests twice, print both results, and check the explanations."""
        results = {}
        for who in (self.name, "adapter"):
            command = [sys.executable, self.script, str(path), "--run", who]
            environment = {**os.environ, "PYTHONDONTWRITEBYTECODE": "1"}
            done = subprocess.run(command, env=environment, capture_output=True, text=True)
            lines = done.stdout.splitlines()
            if not lines or not lines[-1].startswith("{"):
                print(done.stdout, done.stderr, sep="\n")
                return 1
            results[who] = json.loads(lines[-1])
        tests, calls = results["adapter"]["tests"], results["adapter"]["calls"]
        theirs = results[self.name]["tests"]
        print(f"{self.name} {self.version}, tests in {path}\n")
        print(f"{'test':75} {self.name:>8} {'adapter':>8}")
        for name, (outcome, _) in tests.items():
            print(f"{name:75} {theirs.get(name, ['', ''])[0]:>8} {outcome:>8}")
        counts = collections.Counter(outcome for outcome, _ in tests.values())
        print(f"\nwith the adapter: {dict(counts)}; its methods were called: {calls}")
        failed = {name for name, (outcome, _) in tests.items() if outcome == "failed"}
        both = {name for name in failed if theirs.get(name, [""])[0] == "failed"}
        for name in sorted(both):
            print(f"\n{name} also fails with {self.name} itself:\n    {last_line(tests[name][1])}")
        failed -= both
        for name in sorted(failed):
            print(f"\n{name}: {self.explained.get(name, 'NOT EXPLAINED')}\n{tests[name][1]}")
        stale = set(self.explained) & set(tests) - failed
        for name in sorted(stale):
            print(f"\n{name} passes: its explanation no longer applies")
        skipped = {name: text for name, (outcome, text) in tests.items() if outcome == "skipped"}
        for name, text in skipped.items():
            print(f"\n{name} was skipped: {text}")
        is_right = counts["passed"] and calls and not stale and failed <= set(self.explained)
        return 0 if is_right else 1

    def run(self, folder, files, who):
        """Run files of tests in this process; the last line printed is the results as JSON."""
        import pytest

        calls = collections.Counter()
        if who == "adapter":
            self.replace(calls)
        if not files:
            print(f"{folder}: has no such tests")
            return 1
        results = Results()
        options = [
            "-q",
            "-p",
            "no:cacheprovider",
            "--override-ini",
            "addopts=",
            "--rootdir",
            str(folder),
        ]
        os.chdir(folder)
        status = pytest.main([*options, *map(str, files)], plugins=[results])
        print(json.dumps({"tests": results.tests, "calls": dict(calls), "status": int(status)}))
        return 0


def counted(kind, prefixes, calls):
    """A class like `kind` that counts the uses of its methods, by name."""

    class Counted(kind):
        def __getattribute__(self, name):
            if name.startswith(prefixes):
                calls[name] += 1
            return super().__getattribute__(name)

    return Counted


def last_line(text):
    """The error of a test: the last line that pytest marks with E."""
    errors = [line[1:].strip() for line in text.splitlines() if line.startswith("E ")]
    return errors[-1] if errors else text


class Results:
    """A plugin that records the outcome of each test."""

    def __init__(self):
        self.tests = {}

    def pytest_runtest_logreport(self, report):
        name = report.nodeid.rpartition("/")[2]
        if report.when == "call" or report.outcome != "passed":
            text = report.longreprtext if report.failed else str(report.longrepr or "")
            self.tests[name] = (report.outcome, text[-2000:])

    def pytest_collectreport(self, report):
        if report.outcome != "passed":
            self.tests[report.nodeid] = (report.outcome, str(report.longrepr)[-2000:])

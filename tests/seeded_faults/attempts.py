"""Try a fault: which file of tests catches it, and with which test."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from seeded_faults.by_file import CI, EVERYDAY
from seeded_faults.faults import Fault
from seeded_faults.runner import BROKEN, CRASHED, OUT_OF_TIME, STUCK, Baseline, Outcome, Runner

#: Verdicts beside EVERYDAY and CI (no everyday test caught it): no test caught it; something
#: that it needs is not installed; pytest could not run.
NOTHING, NOT_RUN, ERROR = "nothing", "not run", "error"

#: Part of the time for one test that those of further files get, once one has hung.
KNOWN_TO_HANG = 0.2

#: Where tests and examples of docstrings are.
ALL_TESTS = ("tests", "src", "lab/src")


@dataclass(frozen=True)
class Row:
    """What is known of a fault: a row of the matrix.

    Attributes
    ----------
    digest : str
        `Fault.digest` when it was tried.
    verdict : str
    by : dict of str to str
        The first test of each file that caught it, of the verdict's tier.
    clean : list of str
        Files of its room and of agreement whose tests ran, and did not catch it.
    is_complete : bool
        Whether all files of its room and of agreement were tried.
    reason : str
        Why nothing is known, or not all.
    """

    digest: str
    verdict: str
    by: Mapping[str, str] = field(default_factory=dict)
    clean: Sequence[str] = ()
    is_complete: bool = True
    reason: str = ""


class _Attempt:
    """A fault in the copy; collects what runs of pytest show."""

    def __init__(
        self, fault: Fault, runner: Runner, without: Sequence[str], stops_early: bool
    ) -> None:
        self._fault, self._runner = fault, runner
        self._without, self._stops_early = without, stops_early
        self._by: dict[str, dict[str, str]] = {EVERYDAY: {}, CI: {}}
        self._clean: dict[str, None] = {}
        self._reasons: list[str] = []
        self._is_broken = False
        #: Tests that caught it, by the variables that they had.
        self.catches: dict[tuple[tuple[str, str], ...], list[str]] = {}

    @property
    def is_caught(self) -> bool:
        return any(self._by.values())

    @property
    def _is_decided(self) -> bool:
        return self._is_broken or (self._stops_early and self.is_caught)

    def run(self, files: Iterable[str], environment: Mapping[str, str], **plan: object) -> None:
        """Run files of tests, one process after the other if tests end it."""
        left = list(files)
        while left and not self._is_decided:
            outcome = self._run(left, environment, **plan)
            for file, one in outcome.files.items():
                if one["status"] == "clean" and one["running"] is None:
                    self._clean[file] = None
            if not outcome.running or outcome.ended == OUT_OF_TIME:
                return
            stuck = outcome.running.partition("::")[0]
            done = {file for file, one in outcome.files.items() if one["status"] != "skipped"}
            left = [file for file in left if file != stuck and file not in done]

    def run_rest(self, files: Iterable[str]) -> None:
        """Run all tests but those of these files until one fails."""
        if not self._is_decided:
            arguments = [path for path in ALL_TESTS if (self._runner.copy / path).exists()]
            self._run([*arguments, *(f"--ignore={file}" for file in files)], {}, stop=True)

    def _run(
        self, arguments: Sequence[str], environment: Mapping[str, str], **plan: object
    ) -> Outcome:
        if environment:
            plan["tier"] = CI  # a plain run of pytest does not set variables
        plan = {
            "without": list(self._without),
            "caught": bool(self._by[EVERYDAY]),
            "stop": self._stops_early,
            **plan,
        }
        test_timeout = self._runner.test_timeout
        if self._fault.hangs and self.is_caught:
            test_timeout *= KNOWN_TO_HANG
        outcome = self._runner.run(arguments, environment, test_timeout, **plan)
        for file, one in outcome.files.items():
            for tier in (EVERYDAY, CI):
                for test in one[tier]:
                    self._catch(tier, file, test, environment)
        if (test := outcome.running) is not None:
            file = test.partition("::")[0]
            if outcome.ended == CRASHED or (outcome.ended == STUCK and self._fault.hangs):
                self._catch(outcome.files[file]["tier"], file, test, environment)
            else:  # a slow machine is no proof
                self._reasons.append(f"{outcome.ended}: {test}")
        elif outcome.ended:
            self._reasons.append(f"{outcome.ended}: {outcome.output}")
            self._is_broken = outcome.ended == BROKEN
        return outcome

    def _catch(self, tier: str, file: str, test: str, environment: Mapping[str, str]) -> None:
        self._by[tier].setdefault(file, test)
        self.catches.setdefault(tuple(sorted(environment.items())), []).append(test)

    def assign_tiers(self) -> None:
        """Find the tier of files that could not be imported; the fault is no longer there."""
        everyday = self._by[EVERYDAY]
        files = [file for file, test in everyday.items() if test == file]
        tiers = self._runner.tiers(files)
        for file in files:
            if tiers[file] == CI:
                self._by[CI].setdefault(file, everyday.pop(file))

    def row(self, digest: str) -> Row:
        """What has been found."""
        tier = next((tier for tier in (EVERYDAY, CI) if self._by[tier]), None)
        verdict = tier or (ERROR if self._is_broken else NOTHING)
        by = self._by.get(verdict, {})
        caught = self._by[EVERYDAY] | self._by[CI]
        return Row(
            digest,
            verdict,
            dict(sorted(by.items())),
            sorted(file for file in self._clean if file not in caught),
            is_complete=not self._reasons and not (self._stops_early and self.is_caught),
            reason="; ".join(self._reasons),
        )


def try_fault(
    fault: Fault,
    runner: Runner,
    baseline: Baseline,
    *,
    stops_early: bool,
    hints: Mapping[str, str],
) -> Row:
    """Try a fault until no test that caught it fails without it.

    Parameters
    ----------
    fault : Fault
    runner : Runner
    baseline : Baseline
    stops_early : bool
        Whether to stop at the first test that catches it.
    hints : dict of str to str
        Tests that caught it before, by file: they run first.
    """
    digest = fault.digest(runner.copy)
    if fault.missing:
        return Row(digest, NOT_RUN, reason=f"needs {', '.join(fault.missing)}")
    while True:
        attempt = _Attempt(fault, runner, baseline.false_positives, stops_early)
        with runner.seeded(fault):
            _run_stages(fault, runner.copy, attempt, hints)
        false_positives = [
            test
            for variables, tests in attempt.catches.items()
            for test in baseline.check(tests, dict(variables), runner)
        ]
        if not false_positives:
            attempt.assign_tiers()
            return attempt.row(digest)


def _run_stages(fault: Fault, root: Path, attempt: _Attempt, hints: Mapping[str, str]) -> None:
    room, agreement = fault.room_files(root), fault.agreement_files(root)
    files = [file for file in hints if (root / file).exists()]
    attempt.run(files, fault.environment, only=list(hints.values()))
    if fault.environment:
        attempt.run(room, fault.environment)
        attempt.run(agreement, {})
    else:
        attempt.run([*room, *agreement], {})
    if not attempt.is_caught:
        attempt.run_rest([] if fault.environment else [*room, *agreement])

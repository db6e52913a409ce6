"""Optional packages: tests that need a missing one skip and say how to install it.

`[test]` has none of them, `[dev]` all but the lab, which is a distribution of its own, and those
that are too large for each run of CI (`LARGE`). Two variables of the environment let CI run the
tests that skipped, once it has installed the rest:

- ``RAYSTREAM_TEST_SKIPPED=FILE`` writes their ids to a file that pytest takes as ``@FILE``;
- ``RAYSTREAM_TEST_EXTRAS=1`` makes a missing package a failure.
"""

from __future__ import annotations

import os
from importlib.util import find_spec
from pathlib import Path

import pytest

#: The command that installs all of them.
REMEDY = 'pip install -e ".[dev]" -e ./lab'

#: Rooms of the package that cannot be imported without these.
ROOMS = {
    "cluster": ("dask", "distributed"),
    "cuda": ("numba_cuda",),
    "jax": ("jax",),
    "torch": ("torch",),
}

#: Packages that are not in `[dev]`, and how to install them: their tests skip in CI, too.
LARGE = {"torch": "pip install torch"}


def missing_of(*packages: str) -> list[str]:
    """The packages among these that are not installed."""
    return [package for package in packages if find_spec(package) is None]


def need(*packages: str, whose: str = "") -> None:
    """Skip the test, or on import the module, if one of these packages is missing."""
    __tracebackhide__ = True  # the place that is reported is the caller's
    missing = missing_of(*packages)
    if not missing:
        return
    for package in filter(LARGE.get, missing):
        reason = f"{whose} needs {package}: {LARGE[package]}".lstrip()
        pytest.skip(reason, allow_module_level=True)
    reason = f"{whose} needs {', '.join(missing)}: {REMEDY}".lstrip()
    if os.environ.get("RAYSTREAM_TEST_EXTRAS") == "1":
        pytest.fail(reason)
    pytest.skip(reason, allow_module_level=True)


class Skipped:
    """A plugin for pytest: writes down which tests and modules skipped for want of a package.

    Parameters
    ----------
    path : Path
        The file; one id a line.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._ids: dict[str, None] = {}

    def pytest_collectreport(self, report: pytest.CollectReport) -> None:
        self._note(report)

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        self._note(report)

    def _note(self, report: pytest.CollectReport | pytest.TestReport) -> None:
        if not report.skipped or not isinstance(report.longrepr, tuple):
            return
        if report.longrepr[2].endswith(REMEDY):
            self._ids[report.nodeid] = None

    def pytest_sessionfinish(self) -> None:
        self._path.write_text("".join(f"{one}\n" for one in self._ids), encoding="utf-8")

"""Tests that need a package skip, fail, and are recorded as they should be."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

import extras
from extras import REMEDY, Skipped, need


def test_a_missing_package_skips_with_what_to_do(monkeypatch):
    monkeypatch.delenv("RAYSTREAM_TEST_EXTRAS", raising=False)
    with pytest.raises(pytest.skip.Exception) as caught:
        need("pytest", "no_such_package")
    assert str(caught.value) == 'needs no_such_package: pip install -e ".[dev]" -e ./lab'


def test_a_missing_package_fails_where_all_are_wanted(monkeypatch):
    monkeypatch.setenv("RAYSTREAM_TEST_EXTRAS", "1")
    with pytest.raises(pytest.fail.Exception, match="room needs no_such_package: pip install"):
        need("no_such_package", whose="room")
    need("pytest")


def test_a_large_package_skips_in_ci_too(monkeypatch):
    monkeypatch.setenv("RAYSTREAM_TEST_EXTRAS", "1")
    monkeypatch.setitem(extras.LARGE, "no_such_package", "pip install it")
    with pytest.raises(pytest.skip.Exception, match="needs no_such_package: pip install it"):
        need("pytest", "no_such_package")


def report(name, reason, skipped=True):
    return SimpleNamespace(skipped=skipped, longrepr=("file.py", 1, reason), nodeid=name)


def test_what_skipped_for_want_of_a_package_is_noted(tmp_path):
    noted = Skipped(tmp_path / "skipped")
    for _ in range(2):  # by each worker
        noted.pytest_collectreport(report("test_a.py", f"Skipped: needs zarr: {REMEDY}"))
    noted.pytest_runtest_logreport(report("test_b.py::test[x y]", f"Skipped: needs x: {REMEDY}"))
    noted.pytest_runtest_logreport(report("test_b.py::test_gpu", "Skipped: there is no GPU"))
    noted.pytest_runtest_logreport(report("test_b.py::test_failed", REMEDY, skipped=False))
    expected_failure = SimpleNamespace(
        skipped=True, longrepr="text", nodeid="test_b.py::test_fault"
    )
    noted.pytest_runtest_logreport(expected_failure)
    noted.pytest_sessionfinish()
    assert (tmp_path / "skipped").read_text() == "test_a.py\ntest_b.py::test[x y]\n"

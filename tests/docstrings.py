"""Collection of docstring examples by pytest, from the modules that have some."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

import raystream
from extras import ROOMS, missing_of, need

PACKAGE = Path(raystream.__file__).parent
LAB = Path(__file__).parents[1] / "lab"


class Docstrings:
    """A plugin: pytest does not call hooks of a conftest for modules in other folders."""

    @staticmethod
    def pytest_ignore_collect(collection_path: Path) -> bool | None:
        """Leave out modules with neither tests nor examples, which need not be imported."""
        if collection_path.suffix != ".py" or collection_path.name.startswith("test_"):
            return None
        return b">>>" not in collection_path.read_bytes() or None

    @staticmethod
    @pytest.hookimpl(wrapper=True)
    def pytest_collect_file(
        file_path: Path, parent: pytest.Collector
    ) -> Iterator[list[pytest.Collector]]:
        """Take no examples from modules of tests, nor from packages that cannot be imported."""
        found = yield
        if file_path.name.startswith("test_"):
            return [one for one in found if type(one) is pytest.Module]
        if found and missing_of(*_packages_of(file_path)):
            return [_Room.from_parent(parent, path=file_path)]
        return found


def _packages_of(file: Path) -> tuple[str, ...]:
    """Packages needed to import a module of ours."""
    if LAB in file.parents:
        return ("raystream_lab",)
    is_ours = PACKAGE in file.parents
    return ROOMS.get(file.relative_to(PACKAGE).parts[0], ()) if is_ours else ()


class _Room(pytest.File):
    """A module that cannot be imported: it skips."""

    def collect(self) -> list[pytest.Item]:
        need(*_packages_of(self.path), whose=self.path.name)
        return []

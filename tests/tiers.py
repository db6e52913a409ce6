"""The three tiers of tests: every day, in CI, and at night.

A plain ``pytest`` runs the everyday tests: one row of each oracle for each kind of code. ``pytest
-m ci tests src lab/src --doctest-modules`` runs the second tier as `.ci/run` does, and
`.ci/nightly` the tests marked ``exhaustive``. The second tier has the tests marked ``ci``, the
examples of docstrings, and all of the files and folders below.

Seeded faults judge the division: `seeded_faults/matrix.json` records a test file that catches each,
and its tier.
"""

from __future__ import annotations

from pathlib import Path

import pytest

ROOT = Path(__file__).parent

#: Files and folders of the second tier. A default run does not even import them.
CI = (
    # The papers' experiments, and what needs a GPU, a simulator, a driver, a browser or a cluster.
    "cluster",
    "cuda",
    "graphics",
    "lab",
    "test_jax.py",
    "viewer/test_browser_device.py",
    "viewer/server",
    # The repository's own tools, texts and examples.
    "documentation",
    "examples",
    "seeded_faults",
    "test_budget.py",
    "test_docstrings.py",
    "test_examples.py",
    "test_import_time.py",
    "test_imports.py",
    "test_install_lines.py",
    "test_nightly.py",
    "test_packaging.py",
    "test_typing.py",
    "test_words.py",
    # Vector types, which nearly all other tests use; and slabs, which agreement tests.
    "jit/test_simd_arithmetic.py",
    "jit/test_simd_errors.py",
    "jit/test_simd_gathers.py",
    "jit/test_simd_lanes.py",
    "jit/test_simd_machines.py",
    "jit/test_simd_memory.py",
    "jit/test_simd_single_lane.py",
    "test_slabs.py",
    # Public models.
    "scene/io/test_models.py",
    # Tests that start a process of Python for most of their cases.
    "bench/test_contenders.py",
    "bench/test_measures.py",
    "bench/test_render_speed.py",
    "bench/test_runner.py",
    "bench/test_scripts.py",
    "cli/test_bench.py",
    "cli/test_devices.py",
    "cli/test_export.py",
    "cli/test_first_images.py",
    "cli/test_lab.py",
    "jit/test_cache_edits.py",
    "jit/test_ready_kernels.py",
    "jit/test_warm.py",
    "programs/test_disk_cache.py",
    "streams/test_disk_cache.py",
)

#: Fixtures of tests in a browser.
_BROWSERS = {"browser", "chromium"}

_PATHS = frozenset(ROOT / one for one in CI)
_OTHER_TIERS = {"documentation", "exhaustive"}


def _is_ci(path: Path) -> bool:
    return not _PATHS.isdisjoint((path, *path.parents))


def _is_on_way(path: Path, named: Path) -> bool:
    return path.is_relative_to(named) or named.is_relative_to(path)


class Tiers:
    """A plugin: marks the second tier, and collects it only where it is asked for."""

    @staticmethod
    @pytest.hookimpl(tryfirst=True)
    def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
        """Leave out what a default run would deselect, unless it is named."""
        if "not ci" not in config.option.markexpr or not _is_ci(collection_path):
            return None
        named = (Path(one.partition("::")[0]).resolve() for one in config.args)
        return not any(_is_ci(one) and _is_on_way(collection_path, one) for one in named) or None

    @staticmethod
    @pytest.hookimpl(tryfirst=True)  # before -m chooses
    def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
        """Mark what is listed, and examples of docstrings."""
        for item in items:
            if not _OTHER_TIERS.isdisjoint(mark.name for mark in item.iter_markers()):
                continue
            in_browser = not _BROWSERS.isdisjoint(getattr(item, "fixturenames", ()))
            if in_browser or isinstance(item, pytest.DoctestItem) or _is_ci(item.path):
                item.add_marker(pytest.mark.ci)

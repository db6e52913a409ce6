"""The lab's experiments on CUDA: it counts what the CPU does."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from extras import need

need("numba_cuda", "raystream_lab")

import raystream as rs
from raystream.cuda.rendering import CudaBands
from raystream_lab import EXPERIMENTS, Result, Runner, Store
from raystream_lab.christen import image_times
from raystream_lab.devices import CUDA_PASSES, open_facts
from raystream_lab.rayforce import build_on_device, hidden_triangles, layers, render_modes
from raystream_lab.views import View

SIZE = 4


def small_view(name: str) -> View:
    """Two squares, one behind the other, of four triangles."""
    vertices = [[x, y, z] for z in (0.0, 1.0) for x in (-1.0, 1.0) for y in (-1.0, 1.0)]
    faces = [[0, 1, 2], [1, 2, 3], [4, 5, 6], [5, 6, 7]]
    camera = rs.Camera((0.3, 0.2, 5.0), (0.0, 0.0, 0.0), fov=40.0)
    return View(name, name, rs.Scene([rs.Mesh(vertices, faces)], camera=camera), camera, "")


class SmallRunner(Runner):
    """Has a small scene in the place of each model."""

    def view(self, name: str) -> View:
        return self._views.setdefault(name, small_view(name))


@pytest.fixture
def runner(tmp_path: Path, gpu: Any) -> Runner:
    store = Store(tmp_path / "measurements.json", {}, "test")
    return SmallRunner(tmp_path, store, size=SIZE, quick=True, device="cuda")


def run(runner: Runner, name: str) -> Result:
    (experiment,) = (one for one in EXPERIMENTS if one.name == name)
    return runner.run(name, experiment.function("cuda"))


def assert_equal(result: Result, name: str) -> None:
    (table,) = (one for one in result.tables if one.name == name)
    assert table.rows
    assert [row for row in table.records() if row["agreement"] != "equal"] == []
    assert result.claims[-1].verdict == "holds"


def test_purcells_statistics(runner: Runner, monkeypatch: pytest.MonkeyPatch) -> None:
    module = "raystream_lab.purcell.statistics_on_device"
    monkeypatch.setattr(f"{module}.PURCELL_VIEWS", ("bunny",))
    monkeypatch.setattr(f"{module}.grid_options", lambda *_: {"resolution": 2})
    assert_equal(run(runner, "purcell-statistics"), "purcell-statistics")


def test_foleys_times(runner: Runner) -> None:
    result = run(runner, "foley-times")
    assert_equal(result, "foley-device-counts")
    assert {row["machine"] for row in result.tables[0].records()} == {"branching"}
    assert CUDA_PASSES in result.tables[0].notes


def test_the_posters_counts(runner: Runner, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(layers, "CELLS", 1)
    monkeypatch.setattr(layers, "_QUICK_LAYERS", (2,))
    monkeypatch.setattr(layers, "QUERIES", {name: layers.QUERIES[name] for name in _QUERIES})
    for module in (layers, hidden_triangles):
        monkeypatch.setattr(module, "STRUCTURES", ("graph",))
    monkeypatch.setattr(hidden_triangles, "VISIBLE", "cornell")
    monkeypatch.setattr(hidden_triangles, "_QUICK_FACTORS", (0, 1))
    assert_equal(run(runner, "rayforce-layers"), "rayforce-layer-agreement")
    assert_equal(run(runner, "rayforce-hidden"), "rayforce-hidden-agreement")


_QUERIES = ("first_hit", "multi_hit, 1", "multi_hit, all")


def test_the_device_renders_the_modes(runner: Runner, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(render_modes, "STRUCTURES", ("graph",))
    monkeypatch.setattr(render_modes, "MODES", {"vis": "visible surfaces"})
    renders = []
    trace = CudaBands.trace
    monkeypatch.setattr(CudaBands, "trace", lambda *given: renders.append(given) or trace(*given))
    result = run(runner, "rayforce-modes")
    assert renders  # what is timed is the renderer of the device, not its queries
    assert {row["rays per pixel"] for row in result.tables[0].records()} == {1.0}
    assert_equal(result, "rayforce-mode-rays")


def test_the_device_builds_the_same(runner: Runner, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(build_on_device, "STRUCTURES", ("graph",))
    assert_equal(run(runner, "rayforce-build"), "rayforce-build-agreement")


def test_images_are_timed_without_passes(runner: Runner, monkeypatch: pytest.MonkeyPatch) -> None:
    timed = {"size": SIZE, "seconds": [1.0] * image_times.ITERATIONS}
    monkeypatch.setattr(image_times, "LETTERS", ("A",))
    monkeypatch.setattr(image_times, "_fast", lambda *_: timed)
    result = run(runner, "christen-times")
    assert {row["machine"] for row in result.tables[1].records()} == {"branching"}
    assert CUDA_PASSES in result.notes


def test_the_device_is_described(gpu: Any) -> None:
    facts = open_facts("cuda")
    assert facts.text.startswith(gpu.name)
    assert ("It is software" in facts.note) == facts.is_software

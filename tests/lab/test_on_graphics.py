"""The experiments on the graphics device: it counts what the CPU does."""

from __future__ import annotations

from pathlib import Path
from typing import Any, get_type_hints

import pytest

from extras import need

need("raystream_lab")

import raystream as rs
from conftest import skip_without_adapter
from meshes import dented_sphere, soup
from raystream.graphics.errors import GraphicsError
from raystream.graphics.multipass.backend import MultipassBackend
from raystream_lab import EXPERIMENTS, Result, Runner, Store
from raystream_lab.devices import DEVICES
from raystream_lab.experiments import choose
from raystream_lab.foley.kernels_on_graphics import TimedScheduler
from raystream_lab.views import View

SIZE = 16


def small_view(name: str) -> View:
    """A dented sphere in a cloud of triangles."""
    meshes = [rs.Mesh(*parts) for parts in (dented_sphere(2), soup(60, 2))]
    camera = rs.Camera((0.4, 0.3, 3.0), (0.0, 0.0, 0.0), fov=40.0)
    lights = [rs.PointLight((3.0, 4.0, 5.0))]
    return View(name, name, rs.Scene(meshes, lights=lights, camera=camera), camera, "")


class SmallRunner(Runner):
    """Has a small scene in the place of each model."""

    def view(self, name: str) -> View:
        return self._views.setdefault(name, small_view(name))


@pytest.fixture
def runner(tmp_path: Path) -> Runner:
    skip_without_adapter()
    store = Store(tmp_path / "measurements.json", {}, "test")
    return SmallRunner(tmp_path, store, size=SIZE, quick=True, device="graphics")


def run(runner: Runner, name: str) -> Result:
    (experiment,) = (one for one in EXPERIMENTS if one.name == name)
    return runner.run(name, experiment.function(runner.device))


def rows_of(result: Result, name: str) -> list[dict[str, Any]]:
    (table,) = (one for one in result.tables if one.name == name)
    return table.records()


def assert_equal(result: Result, name: str) -> None:
    rows = rows_of(result, name)
    assert rows
    assert [row for row in rows if row["agreement"] != "equal"] == []
    assert result.claims[-1].verdict == "holds"


def assert_explained(result: Result) -> None:
    """Every row that is off by more than a quarter says why."""
    for table in result.tables:
        for row in table.records():
            if row.get("ratio") is not None and abs(row["ratio"] - 1.0) > 0.25:
                assert row["why they differ"], (table.name, row)


def test_the_device_counts_the_statistics(runner: Runner, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("raystream_lab.purcell.statistics_on_device.PURCELL_VIEWS", ("bunny",))
    result = run(runner, "purcell-statistics")
    assert_equal(result, "purcell-statistics")
    assert_explained(result)
    view = runner.view("bunny")
    tracer = rs.Tracer(view.scene, "grid", min_resolution=64, counters=True)
    tracer.first_hit(*view.rays(SIZE))
    rows = {row["quantity"]: row["ours"] for row in rows_of(result, "purcell-figure-6")}
    assert rows["bunny: cells per ray (v)"] == tracer.counters.total["steps"] / SIZE**2
    assert rows["bunny: triangles per ray (t)"] == tracer.counters.total["tests"] / SIZE**2


@pytest.mark.exhaustive
def test_the_device_takes_the_passes_that_are_simulated(
    runner: Runner, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("raystream_lab.purcell.on_device.PURCELL_VIEWS", ("bunny",))
    result = run(runner, "purcell-machines")
    rows = {row["machine"]: row for row in rows_of(result, "purcell-machines")}
    assert all(row["rays with other triangles"] == 0 for row in rows.values())
    for name in ("multipass", "multipass, naive"):
        assert rows[f"graphics, {name}"]["passes"] == rows[f"cpu, {name}"]["passes"]
        assert rows[f"graphics, {name}"]["draws"] > rows[f"graphics, {name}"]["passes"]
    fewer = rows["graphics, multipass, unrolled"]["passes"]
    assert fewer < rows["graphics, multipass"]["passes"]
    assert {"graphics, branching", "graphics, compute"} < set(rows)
    assert result.claims[0].verdict == "holds"
    table = {row["quantity"]: row["ours"] for row in rows_of(result, "purcell-table-2")}
    searched = table["bunny: traversal passes"] + table["bunny: intersection passes"]
    assert searched + 2 == table["bunny: passes"] == rows["cpu, multipass"]["passes"]
    assert_explained(result)


@pytest.mark.exhaustive
def test_structures_are_timed_on_both_machines(runner: Runner) -> None:
    result = run(runner, "foley-times")
    assert_equal(result, "foley-device-counts")
    assert_explained(result)
    rows = rows_of(result, "foley-table-1")
    traced = {(row["machine"], row["structure"]) for row in rows if row["scene"] == "cornell"}
    assert {name for machine, name in traced if machine == "multipass"} == {
        *("brute", "grid", "restart", "backtrack")
    }
    assert {name for machine, name in traced if machine == "compute"} == {
        *("brute", "grid", "restart", "backtrack", "stack", "bvh")
    }
    brute = next(
        row for row in rows if (row["machine"], row["structure"]) == ("multipass", "brute")
    )
    triangles = runner.view("cornell").scene.triangle_count
    assert brute["passes"] == triangles + 2  # set up, shade


def test_a_refusal_is_a_row_and_a_note(runner: Runner, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(_: object, structure: Any, *__: object, **___: object) -> Any:
        raise GraphicsError(f"no room for {structure.name}")

    monkeypatch.setattr("raystream_lab.foley.times_on_device._Scene._tracer", refuse)
    result = run(runner, "foley-times")
    assert "cornell, grid, machine compute: no room for grid" in result.notes
    rows = rows_of(result, "foley-table-1")
    assert {row["why they differ"] for row in rows} == {"refused: see notes"}
    assert {claim.verdict for claim in result.claims} == {"not measured"}


def test_states_are_counted_by_the_kernels(runner: Runner, monkeypatch: pytest.MonkeyPatch) -> None:
    structures = []
    run_chunk = MultipassBackend._run

    def note(machine: MultipassBackend, chunk: Any) -> Any:
        structures.append(machine.structure.options.traversal)
        return run_chunk(machine, chunk)

    monkeypatch.setattr(MultipassBackend, "_run", note)
    result = run(runner, "foley-counts")
    assert {*structures} == {"restart", "backtrack"}  # the device ran the passes
    assert_equal(result, "foley-device-states")
    assert_explained(result)
    runs = {
        (row["traversal"], row["kernel"]): row["runs"]
        for row in rows_of(result, "foley-kernel-runs")
    }
    counts = {row["count"]: row["graphics"] for row in rows_of(result, "foley-device-states")}
    assert runs["backtrack", "up"] == counts["robots, backtrack: backtrack steps"] > 0
    assert runs["restart", "down"] == counts["robots, restart: steps"]
    assert runs["restart", "leaf"] == counts["robots, restart: leaves"]
    assert ("restart", "up") not in runs


def test_key_kernels_have_words_and_times(runner: Runner) -> None:
    result = run(runner, "foley-kernels")
    rows = rows_of(result, "foley-bandwidth")
    assert [row["kernel"] for row in rows] == [
        *("brute intersect", "grid traverse", "grid intersect", "kd down", "kd up", "kd intersect")
    ]
    assert all(row["ns per run"] > 0.0 and row["runs"] >= row["passes"] for row in rows)
    assert_explained(result)
    words = {row["quantity"]: row["ours"] for row in rows_of(result, "foley-table-3")}
    assert all(count % 4 == 0 for count in words.values())  # texels


def test_scheduler_times_the_passes_between_its_choices(runner: Runner) -> None:
    view, scheduler = runner.view("any"), TimedScheduler()
    options = {"device": "graphics", "machine": "multipass", "counters": True, "loop": "queries"}
    tracer = rs.Tracer(view.scene, "grid", scheduler=scheduler, **options)
    tracer.first_hit(*view.rays(SIZE))
    passes = list(tracer.counters.passes)[:-1]
    for kernel in ("set up", "traverse", "intersect"):
        assert scheduler.passes[kernel] == sum(one.kernel == kernel for one in passes)
        runs = sum(one.run_count for one in passes if one.kernel == kernel)
        assert scheduler.runs[kernel] == runs
    assert all(seconds > 0.0 for seconds in scheduler.seconds.values())


@pytest.mark.exhaustive
@pytest.mark.parametrize(
    ("name", "table"),
    [
        ("rayforce-modes", "rayforce-mode-rays"),
        ("rayforce-layers", "rayforce-layer-agreement"),
        ("rayforce-hidden", "rayforce-hidden-agreement"),
        ("christen-loops", "christen-loop-passes"),
    ],
)
def test_counts_are_the_cpus(
    runner: Runner, monkeypatch: pytest.MonkeyPatch, name: str, table: str
) -> None:
    monkeypatch.setattr("raystream_lab.rayforce.layers._QUICK_LAYERS", (1, 3))
    monkeypatch.setattr("raystream_lab.rayforce.hidden_triangles._QUICK_FACTORS", (0, 1))
    monkeypatch.setattr("raystream_lab.christen.loops_on_device.SCENES", ("A",))
    result = run(runner, name)
    assert_equal(result, table)
    assert result.images == []


@pytest.mark.exhaustive
def test_images_are_timed_on_the_device(runner: Runner, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("raystream_lab.christen.image_times.LETTERS", ("A",))
    rows = rows_of(run(runner, "christen-times"), "christen-times")
    assert {(row["device"], row["machine"]) for row in rows} == {
        ("graphics", "compute"),
        ("graphics", "multipass"),
    }


@pytest.mark.exhaustive
def test_iterations_take_passes(runner: Runner, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("raystream_lab.christen.on_graphics.SCENES", ("A",))
    rows = run(runner, "christen-graphics").tables[0].records()
    assert [row["iterations"] for row in rows] == [1, 3]
    assert rows[1]["passes"] > rows[0]["passes"]
    assert all(row["largest colour difference"] < 1e-4 for row in rows)


def test_software_traces_smaller_images(tmp_path: Path) -> None:
    skip_without_adapter()
    store = Store(tmp_path / "measurements.json", {}, "test")
    whole = Runner(tmp_path, store, device="graphics")
    is_software = whole.facts.is_software
    assert whole.device_size(512) == (128 if is_software else 512)
    assert Runner(tmp_path, store).device_size(512) == 512
    assert Runner(tmp_path, store, device="graphics", size=300).device_size(512) == 300


def test_experiments_are_chosen_by_device() -> None:
    names = {device: [one.name for one in choose(["all"], device=device)] for device in DEVICES}
    papers = ("purcell", "foley", "rayforce", "christen")
    for device in DEVICES:
        assert {name.partition("-")[0] for name in names[device]} == {*papers}
    assert "christen-graphics" in names["graphics"]
    assert "christen-graphics" not in names["cuda"] + names["cpu"]
    assert "rayforce-build" in names["cuda"]
    of_passes = {"purcell-machines", "christen-loops"}
    assert of_passes < {*names["graphics"]}
    assert not of_passes & {*names["cpu"], *names["cuda"]}
    assert "foley-counts" not in names["cuda"]
    with pytest.raises(ValueError, match="no experiment 'cache'"):
        choose(["purcell"], ["cache"], device="graphics")
    with pytest.raises(ValueError, match="one of cpu, graphics, cuda, got 'abacus'"):
        choose(["all"], device="abacus")


@pytest.mark.parametrize("device", DEVICES)
def test_every_experiment_of_a_device_is_a_function_of_its_own(device: str) -> None:
    functions = [one.function(device) for one in choose(["all"], device=device)]
    assert len(set(functions)) == len(functions)
    for function in functions:
        assert get_type_hints(function) == {"runner": Runner, "return": Result}, function

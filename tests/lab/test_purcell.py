"""Purcell's experiments on small images: exact identities, and that all of them run."""

from __future__ import annotations

from pathlib import Path

import pytest

from extras import need

need("raystream_lab")

import raystream as rs
from raystream_lab import EXPERIMENTS, Result, Runner, Store
from raystream_lab.cost_model import prices
from raystream_lab.purcell.image_counts import count_image, grid_options, grid_tracer
from raystream_lab.purcell.loop_unrolling import compare
from raystream_lab.purcell.schedules import image_schedule
from raystream_lab.purcell.zbuffer import _crossing

SIZE = 32

#: Built-in scenes only, with a name for each part that has its own list of views.
VIEWS = ("forest top", "forest inside")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("lab")


@pytest.fixture
def runner(folder: Path, monkeypatch: pytest.MonkeyPatch) -> Runner:
    """Measurements are shared by the tests of this file."""
    for module in (
        "scene_statistics",
        "grid_resolution",
        "schedules",
        "exact_lists",
        "loop_unrolling",
        "image_costs",
        "texture_cache",
    ):
        monkeypatch.setattr(f"raystream_lab.purcell.{module}.PURCELL_VIEWS", VIEWS)
    monkeypatch.setattr("raystream_lab.purcell.mailbox.PURCELL_VIEWS", VIEWS)
    monkeypatch.setattr("raystream_lab.purcell.small_memory._VIEWS", VIEWS[1:])
    monkeypatch.setattr("raystream_lab.purcell.texture_cache._VARIED", VIEWS[1:])
    store = Store(folder / "measurements.json", {}, "test")
    store.read()
    return Runner(folder, store, size=SIZE, quick=True)


def run(runner: Runner, name: str) -> Result:
    (experiment,) = [one for one in EXPERIMENTS if one.name == f"purcell-{name}"]
    return runner.run(experiment.name, experiment.function())


def test_statistics_are_those_of_counters(runner: Runner) -> None:
    result = run(runner, "statistics")
    table = {row["quantity"]: row["ours"] for row in result.tables[0].records()}
    view = runner.view("forest top")
    tracer = rs.Tracer(view.scene, "grid", counters=True, **grid_options(view, quick=True))
    hits = tracer.first_hit(*view.rays(SIZE))
    assert table["forest top: cells per ray (v)"] == tracer.counters.steps.mean()
    assert table["forest top: triangles per ray (t)"] == tracer.counters.tests.mean()
    assert table["forest top: share of rays that hit (s)"] == hits.is_hit.mean()
    assert [one.path.stat().st_size > 1000 for one in result.images] == [True, True]


@pytest.mark.parametrize("name", VIEWS)
def test_replayed_passes_are_the_machines(runner: Runner, name: str) -> None:
    # Identity: the report's passes are those that the multipass machine runs.
    run(runner, "passes")
    found = image_schedule(runner, name)
    view = runner.view(name)
    options = {"machine": "multipass", "counters": True, **grid_options(view, quick=True)}
    tracer = rs.Tracer(view.scene, "grid", **options)
    tracer.first_hit(*view.rays(SIZE))
    passes = tracer.counters.passes
    assert passes is not None
    assert found["passes"] == found["schedulers"]["threshold"] == len(passes)
    assert found["traverse"] == passes.of("traverse")
    assert found["intersect"] == passes.of("intersect")
    assert found["efficiency"] == pytest.approx(passes.efficiency)
    assert found["optimal"] == passes.optimal_count
    assert dict(map(tuple, found["sweep"]))[20] == len(passes)
    unrolled = rs.Tracer(view.scene, "grid", traversal_steps=4, intersections=2, **options)
    unrolled.first_hit(*view.rays(SIZE))
    assert found["unrolled"]["passes"] == len(unrolled.counters.passes)


def test_both_lists_are_those_of_tracers(runner: Runner) -> None:
    prices, figure, table = run(runner, "lists").tables
    view = runner.view("forest top")
    options = {**grid_options(view, quick=True), "counters": True}
    for overlap, column in (("plane", "planes"), ("exact", "exact")):
        tracer = rs.Tracer(view.scene, "grid", overlap=overlap, **options)
        tracer.first_hit(*view.rays(SIZE))
        rows = {row["quantity"]: row[column] for row in (*figure.records(), *table.records())}
        assert rows["forest top: triangles per ray (t)"] == tracer.counters.tests.mean()
        assert rows["forest top: cells per ray (v)"] == tracer.counters.steps.mean()
        row = prices.records()[0]
        assert row[f"references, {column}"] == len(tracer.structure.lists.references)
        machine = rs.Tracer(view.scene, "grid", overlap=overlap, machine="multipass", **options)
        machine.first_hit(*view.rays(SIZE))
        assert rows["forest top: passes"] == len(machine.counters.passes)
    assert all(float(row["longer by"] or 0.0) > 0.1 for row in prices.records())
    # Nothing but the lists differs: cells and hits are the same.
    for row in figure.records():
        if "triangles" not in str(row["quantity"]):
            assert row["planes"] == row["exact"]


def test_shares_of_costs_add_up(runner: Runner) -> None:
    by_kernel, by_kind, _ = run(runner, "costs").tables
    sums: dict[tuple[object, object], list[float]] = {}
    for row in by_kernel.rows:
        view, architecture, part, instructions, _, moved, _ = row
        if part != "all, per ray":
            one = sums.setdefault((view, architecture), [0.0, 0.0])
            one[0] += float(instructions or 0.0)
            one[1] += float(moved or 0.0)
    assert len(sums) == 2 * len(VIEWS)
    assert all(one == pytest.approx([1.0, 1.0]) for one in sums.values())
    for row in by_kind.rows:
        assert sum(float(row[k] or 0.0) for k in (2, 4, 6)) == pytest.approx(1.0)
    rate = run(runner, "speed").tables[0]
    assert [row["ratio"] for row in rate.records()] == pytest.approx([1.0, 1.0], rel=0.01)


def test_unrolling_by_hand() -> None:
    # One ray, 8 steps in a row and 2 tests; 4 steps and 2 tests in a pass: 2 + 1 runs.
    schedule = {
        "passes": 12,
        "unrolled": {
            "passes": 5,
            "once": {"traverse": 8, "intersect": 2},
            "runs": {"traverse": 2, "intersect": 1},
        },
    }
    found = compare(schedule, 1, {"traversal_steps": 4, "intersections": 2})
    step, test = prices("multipass")["step"], prices("multipass")["intersect"]
    before = 8 * (4 * (14 + 9 + 1) + 1) + 2 * (4 * (14 + 5 + 10) + 1) + 12
    after = 2 * (4 * (14 + 9 + 4) + 1) + (4 * (14 + 5 + 20) + 1) + 5
    assert found["saved"] == pytest.approx(1 - after / before)
    assert found["suppressed"] == pytest.approx(found["saved"])  # no step was in vain
    bare = prices("branching")["step"].instructions, prices("branching")["intersect"].instructions
    once = 8 * step.instructions + 2 * test.instructions
    around = step.instructions - bare[0], test.instructions - bare[1]
    more = 2 * (around[0] + 4 * bare[0]) + around[1] + 2 * bare[1]
    assert found["added"] == pytest.approx(more / once - 1)


def test_fewer_instructions_are_a_changed_reading(runner: Runner) -> None:
    result = run(runner, "unrolling")
    added = [float(row["instructions added"] or 0.0) for row in result.tables[0].records()[1:]]
    assert min(added) < 0.0 < max(added) < 0.1
    claim = result.claims[1]
    assert claim.verdict == "holds"
    assert "our reading" in claim.text
    assert "fewer in 1 of 2" in claim.evidence


def test_cache_sees_every_reference(runner: Runner) -> None:
    result = run(runner, "cache")
    rates = next(one for one in result.tables if one.name == "purcell-hit-rates").records()
    assert len(rates) == 3 * len(VIEWS)
    for name in VIEWS:
        view = runner.view(name)
        values = count_image(grid_tracer(runner, view), view, SIZE)
        steps, tests, hits = (values["rays"] * values[key] for key in ("v", "t", "s"))
        multipass, tiled, branching = (row["references"] for row in rates if row["view"] == name)
        assert multipass == tiled == branching
        # A step reads a word, a test an entry and three corners, a hit seven texels.
        assert branching == pytest.approx(steps + 4 * tests + 7 * hits)
    misses = result.plots[0].series[0].y
    assert misses == sorted(misses, key=float, reverse=True)


@pytest.mark.parametrize("name", ["resolution", "unrolling", "mailbox", "memory"])
def test_experiment_runs(runner: Runner, name: str) -> None:
    result = run(runner, name)
    assert result.notes == []
    assert all(table.rows for table in result.tables)
    assert all(one.verdict != "not measured" for one in result.claims)


@pytest.mark.parametrize(
    ("traced", "expected"),
    [([4, 4, 4, 4], 4.0), ([0.5] * 4, 1.0), ([100] * 4, None), ([4, 5.6568542, 8, 11.3137085], 16)],
)
def test_crossings_of_known_lines(traced: list[float], expected: float | None) -> None:
    # Against a line that is the depth itself, at depths of 1, 4, 16 and 64... on logarithms.
    depths = [1.0, 4.0, 16.0, 64.0]
    if expected == 16:
        traced = [4.0 * depth**0.5 for depth in depths]
    found = _crossing(depths, list(map(float, traced)), depths)
    assert found == (None if expected is None else pytest.approx(expected))

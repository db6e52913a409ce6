"""The experiments of the graphics device, which run the simulated machines."""

from __future__ import annotations

from pathlib import Path

import pytest

from extras import need

need("raystream_lab")

from conftest import skip_without_adapter
from raystream_lab import EXPERIMENTS, Result, Runner, Store
from raystream_lab.experiments import choose


@pytest.fixture
def runner(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Runner:
    skip_without_adapter()
    monkeypatch.setattr("raystream_lab.purcell.on_graphics.PURCELL_VIEWS", ("forest top",))
    monkeypatch.setattr("raystream_lab.christen.on_graphics.SCENES", ("A",))
    store = Store(tmp_path / "measurements.json", {}, "test")
    return Runner(tmp_path, store, size=16, quick=True)


def run(runner: Runner, name: str) -> Result:
    (experiment,) = [one for one in EXPERIMENTS if one.name == name]
    return runner.run(name, experiment.function())


@pytest.mark.exhaustive
def test_the_device_takes_the_passes_that_are_simulated(runner: Runner) -> None:
    result = run(runner, "purcell-graphics")
    rows = {row["machine"]: row for row in result.tables[0].records()}
    assert all(row["rays with other triangles"] == 0 for row in rows.values())
    for name in ("multipass", "multipass, naive"):
        assert rows[f"graphics, {name}"]["passes"] == rows[f"cpu, {name}"]["passes"]
        assert rows[f"graphics, {name}"]["draws"] > rows[f"graphics, {name}"]["passes"]
    fewer = rows["graphics, multipass, unrolled"]["passes"]
    assert fewer < rows["graphics, multipass"]["passes"]
    assert result.claims[0].verdict == "holds"


@pytest.mark.exhaustive
def test_iterations_take_passes(runner: Runner) -> None:
    rows = run(runner, "christen-graphics").tables[0].records()
    assert [row["iterations"] for row in rows] == [1, 3]
    assert rows[1]["passes"] > rows[0]["passes"]
    assert all(row["farthest colour"] < 1e-4 for row in rows)


def test_experiments_are_chosen_by_device() -> None:
    names = [one.name for one in choose(["all"], device="graphics")]
    assert names == ["purcell-graphics", "christen-graphics"]
    assert not {*names} & {one.name for one in choose(["all"])}
    with pytest.raises(ValueError, match="'graphics': has experiments of purcell, christen"):
        choose(["foley"], device="graphics")
    with pytest.raises(ValueError, match="cpu or graphics, got 'abacus'"):
        choose(["all"], device="abacus")

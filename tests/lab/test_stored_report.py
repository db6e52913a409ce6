"""The report stored in the documentation: what it counts is what is counted now."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from extras import need

need("raystream_lab")

from raystream_lab import Runner, Store, run_all
from raystream_lab.experiments import EXPERIMENTS

STORED = Path(__file__).resolve().parents[2] / "docs" / "lab" / "cpu" / "report.json"

#: Experiments that count and time nothing, so that every figure is the same on every machine.
COUNTING = ("purcell-statistics", "foley-counts")


def test_the_stored_report_has_all_experiments() -> None:
    stored = json.loads(STORED.read_text(encoding="utf-8"))["experiments"]
    on_cpu = [one.name for one in EXPERIMENTS if "cpu" in one.devices]
    assert list(stored) == on_cpu


@pytest.mark.exhaustive  # minutes each: all views in the papers' sizes
@pytest.mark.filterwarnings("ignore:.*can never be hit")  # of the models
@pytest.mark.usefixtures("scenes_folder")
@pytest.mark.parametrize("name", COUNTING)
def test_counts_are_those_of_the_stored_report(name: str, tmp_path: Path) -> None:
    (experiment,) = (one for one in EXPERIMENTS if one.name == name)
    runner = Runner(tmp_path, Store(tmp_path / "measurements.json", {}, "tests"))
    (outcome,) = run_all(runner, [experiment])
    counted = json.loads(json.dumps(outcome.result.as_json()))
    stored = json.loads(STORED.read_text(encoding="utf-8"))["experiments"][name]
    tables = {table["name"]: table["rows"] for table in stored["tables"]}
    assert tables
    assert {table["name"]: table["rows"] for table in counted["tables"]} == tables
    assert counted["claims"] == stored["claims"]

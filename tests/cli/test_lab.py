"""``raystream lab``: selecting experiments, writing reports, resuming."""

from __future__ import annotations

import json

import pytest

from extras import need

need("raystream_lab")

from conftest import skip_without_adapter
from raystream.core.errors import RaystreamError
from raystream_lab import EXPERIMENTS, PAPERS
from raystream_lab.devices import open_facts
from raystream_lab.experiments import choose


def test_experiments_have_names_of_their_own_and_of_a_paper():
    assert {one.paper for one in EXPERIMENTS} <= set(PAPERS)
    assert len({one.name for one in EXPERIMENTS}) == len(EXPERIMENTS)


def test_list_names_all_experiments(run):
    found = run("lab", "--list")
    assert found.code == 0
    assert all(one.name in found.out for one in choose(["all"]))
    assert list(run("lab", "purcell", "--list", "--json").figures) == [
        one.name for one in choose(["all"]) if one.paper == "purcell"
    ]


def test_unknown_names_are_refused(run):
    assert "expected purcell" in run("lab", "newton").complaint
    assert "no experiment 'apples'" in run("lab", "purcell", "--only", "apples").complaint


def test_list_of_a_device(run):
    names = list(run("lab", "--device", "graphics", "--list", "--json").figures)
    assert names == [one.name for one in choose(["all"], device="graphics")]
    assert "expected one of cpu, graphics, cuda" in run("lab", "--device", "abacus").complaint


@pytest.mark.parametrize("device", ["graphics", "cuda"])
def test_a_missing_device_is_refused_before_anything_is_written(run, tmp_path, monkeypatch, device):
    def refuse(*_):
        raise RaystreamError(f"device {device!r}: there is no driver")

    monkeypatch.setattr("raystream.graphics.adapters.open_device", refuse)
    monkeypatch.setattr("raystream.cuda.devices.open_device", refuse)
    found = run("lab", "all", "--device", device, "--quick", "-o", "out")
    assert found.complaint == f"device {device!r}: there is no driver"
    assert not (tmp_path / "out").exists()


def test_a_report_names_its_device(run, tmp_path):
    skip_without_adapter()
    arguments = ("lab", "foley", "--only", "kernels", "--quick", "--size", "16", "-o", "out")
    found = run(*arguments, "--device", "graphics", "--json")
    about = found.figures["about"]
    assert (about["device"], about["adapter"]) == ("graphics", open_facts("graphics").text)
    assert "--device graphics" in about["command"]
    assert f"Device graphics: {about['adapter']}." in (tmp_path / "out" / "index.md").read_text()
    # Measurements of one device are not those of another.
    assert "device graphics" in run(*arguments, "--resume").complaint


def test_folder_that_is_a_file_is_refused(run, tmp_path):
    (tmp_path / "taken").write_text("x")
    assert "taken" in run("lab", "purcell", "--only", "unrolling", "-o", "taken").complaint


@pytest.fixture
def small(monkeypatch):
    """Purcell's experiments with only the built-in scenes, in a small part."""
    views = ("forest top",)
    for module in ("scene_statistics", "schedules", "loop_unrolling", "image_costs"):
        monkeypatch.setattr(f"raystream_lab.purcell.{module}.PURCELL_VIEWS", views)


def test_report_is_written_and_a_run_resumes(run, tmp_path, small):
    arguments = ("lab", "purcell", "--only", "unrolling", "--quick", "--size", "32", "-o", "out")
    first = run(*arguments, "--json")
    assert first.code == 0
    names = {path.name for path in (tmp_path / "out").iterdir()}
    assert {"index.md", "purcell.md", "html", "report.json", "measurements.json"} <= names
    table = first.figures["experiments"]["purcell-unrolling"]["tables"][0]
    assert [row["view"] for row in table["rows"]] == ["the paper", "forest top"]
    # Existing measurements are not repeated: a changed figure stays as it is.
    path = tmp_path / "out" / "measurements.json"
    content = json.loads(path.read_text())
    (name,) = [key for key in content["measurements"] if "schedules" in key]
    content["measurements"][name]["value"]["passes"] = 123456
    path.write_text(json.dumps(content))
    again = run(*arguments, "--resume")
    assert again.code == 0
    assert "123,456" in again.out
    assert "123,456" not in run(*arguments).out
    other = run(*arguments[:-4], "--size", "48", "-o", "out", "--resume")
    assert "size 32" in other.complaint


def test_interruption_says_how_to_resume(run, monkeypatch, small):
    def stop(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr("raystream_lab.purcell.loop_unrolling.compare", stop)
    found = run("lab", "purcell", "--only", "unrolling", "--quick", "--size", "32", "-o", "out")
    assert found.code == 130
    assert "measurements are saved in out; rerun with --resume" in found.err

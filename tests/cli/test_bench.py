"""``raystream bench``."""

from __future__ import annotations

import importlib
import inspect

import pytest

from raystream.bench.contenders import PEERS
from raystream.bench.ray_sets import DEFAULT_SETS, RAY_SETS
from raystream.bench.report import REPORT_SUFFIXES
from raystream.bench.results import read_result, write_result
from raystream.bench.runner import Bench
from raystream.cli import options
from raystream.cli.bench import DEFAULT_SCENES, ContenderOptions, _entries, bench

pytestmark = pytest.mark.usefixtures("few_objects")

QUICK = ("--width", 8, "--height", 6, "--repeats", 1)


def test_names_are_the_librarys():
    assert tuple(RAY_SETS) == options.RAY_SETS
    assert tuple(PEERS) == options.PEERS
    assert DEFAULT_SETS == options.DEFAULT_SETS
    assert inspect.signature(bench).parameters["sets"].default == ",".join(DEFAULT_SETS)
    assert REPORT_SUFFIXES == (".md", ".rst", ".svg")


def test_json(run):
    done = run("bench", "cornell", *QUICK, "--peers", "none", "--sets", "primary,ao", "--json")
    assert done.code == 0
    figures = done.figures
    assert figures["schema"] == 1
    assert figures["settings"]["size"] == [8, 6]
    assert figures["settings"]["repeats"] == 1
    assert figures["own"] == ["raystream"]
    assert figures["machine"]["threads"] >= 1
    (scene,) = figures["scenes"]
    assert scene["scene"] == "cornell"
    assert [rays["name"] for rays in scene["sets"]] == ["primary", "ao"]
    assert len(scene["builds"]["raystream"]["seconds"]) == 1
    assert scene["sets"][0]["figures"]["ratio_to_best_peer"] == {"raystream": None}
    assert scene["sets"][0]["figures"]["share_of_roofline"] > 0.0


def test_variants_and_a_stored_result(run, tmp_path):
    done = run(
        *("bench", "cornell", "spheres:500", *QUICK, "--peers", "none", "--sets", "bounce,multi"),
        *("--option", "max_leaf_size=2", "--variant", "fat:max_leaf_size=8,structure=bvh"),
        *("-o", "result.json"),
    )
    assert done.code == 0
    assert "cornell: 3" in done.out
    header = next(line for line in done.out.splitlines() if line.startswith("rays"))
    assert header.split()[:4] == ["rays", "count", "raystream", "fat"]
    assert "spheres:500" not in done.err  # it is the last one
    assert "cornell: done after" in done.err
    again = run("bench", "--report", "result.json")
    assert again.out == done.out
    assert run("bench", "--report", "result.json", "--json").figures["own"] == ["raystream", "fat"]
    assert run("bench", "--report", "result.json", "-o", "table.md").code == 0
    assert "| bounce |" in (tmp_path / "table.md").read_text()
    assert run("bench", "--report", "result.json", "-o", "chart.svg").code == 0
    assert (tmp_path / "chart.svg").read_text().startswith("<svg")


@pytest.mark.parametrize(
    ("sets", "peers"),
    [
        (["primary", "multi"], [name for name in PEERS if name not in ("fcpw", "libigl")]),
        (["closest_near"], ["open3d", "warp", "fcpw", "libigl"]),
        (["ao", "closest"], list(PEERS)),
    ],
)
def test_peers_by_default_have_a_query_of_the_sets(sets, peers):
    entries = _entries(ContenderOptions(), sets)
    assert [entry.name for entry in entries] == ["raystream", *peers]


def test_points_without_a_structure_for_them_are_no_figures(run):
    asked = ("bench", "cornell", *QUICK, "--peers", "none", "--sets", "closest", "--json")
    ((rays,),) = (scene["sets"] for scene in run(*asked).figures["scenes"])
    assert (rays["query"], rays["ray_count"], rays["hit_count"]) == ("closest", 48, 48)
    assert rays["figures"]["mrays_per_second"]["raystream"] > 0.0
    assert rays["figures"]["share_of_roofline"] is None
    (scene,) = run(*asked, "--option", "structure=grid").figures["scenes"]
    (rays,) = scene["sets"]
    assert rays["failures"] == {"raystream": "does not support this query"}
    assert rays["figures"]["mrays_per_second"] == {}


def test_an_interrupt_shows_what_there_is_and_the_run_can_go_on(run, monkeypatch, tmp_path):
    ran, names = Bench.run, []

    def stop(self, name, scene, progress=None):
        names.append(name)
        if names == ["cornell", "spheres"]:
            raise KeyboardInterrupt
        ran(self, name, scene, progress)

    monkeypatch.setattr(Bench, "run", stop)
    asked = ("bench", "cornell", "spheres", *QUICK, "--peers", "none", "--sets", "primary")
    asked += ("-o", "result.json", "--resume")
    done = run(*asked)
    assert done.code == 130
    assert done.err.endswith("interrupted\n")
    assert "cornell" in done.out
    assert [one.scene for one in read_result(tmp_path / "result.json").scenes] == ["cornell"]
    assert run(*asked).code == 0
    assert names == ["cornell", "spheres", "spheres"]
    kept = read_result(tmp_path / "result.json")
    assert [one.scene for one in kept.scenes] == ["cornell", "spheres"]
    assert "different settings" in run(*asked, "--repeats", 2).complaint
    kept.versions["raystream"] = "0.0.1"
    write_result(tmp_path / "result.json", kept)
    fault = run(*asked).complaint
    assert "--resume: the earlier result has different contenders: raystream 0.0.1 (now " in fault
    assert "--option" not in fault


def test_default_scenes_that_are_not_there_are_left_out(run, monkeypatch, tmp_path):
    monkeypatch.setenv("RAYSTREAM_SCENES", str(tmp_path / "none"))
    command = importlib.import_module("raystream.cli.bench")  # the name means its function
    monkeypatch.setattr(command, "DEFAULT_SCENES", ("conference", "cornell"))
    done = run("bench", *QUICK, "--peers", "none", "--sets", "primary", "--json")
    assert list(done.figures["skipped"]) == ["conference"]
    assert [scene["scene"] for scene in done.figures["scenes"]] == ["cornell"]
    assert "bunny" in DEFAULT_SCENES


@pytest.mark.parametrize(
    ("arguments", "fault"),
    [
        (["--sets", "primary,secondary"], "--sets: expected"),
        (["--peers", "optix"], "--peers: expected"),
        (["--option", "leaf"], "--option: expected KEY=VALUE"),
        (["--option", "leaf=2"], "leaf"),
        (["--option", "max_leaf_size=0"], "max_leaf_size"),
        (["--variant", "leaf=2"], "--variant: expected NAME:KEY=VALUE"),
        (["--variant", "raystream:structure=brute"], "'raystream' is given twice"),
        (["--output", "table.md"], ".json"),
        (["--resume"], "--resume: needs --output"),
        (["--report", "result.json"], "--report: cannot be combined with scenes"),
    ],
)
def test_bad_arguments(run, arguments, fault):
    assert fault in run("bench", "cornell", *QUICK, "--peers", "none", *arguments).complaint


def test_bad_reports(run, tmp_path):
    assert "nothing.json" in run("bench", "--report", "nothing.json").complaint
    (tmp_path / "other.json").write_text("{}")
    assert "other.json: not a benchmark result" in run("bench", "--report", "other.json").complaint
    (tmp_path / "broken.json").write_text("{")
    assert "broken.json" in run("bench", "--report", "broken.json").complaint
    bad = run("bench", "--report", "other.json", "-o", "chart.png").complaint
    assert ".md or .rst or .svg" in bad


def test_bad_scenes(run, tmp_path):
    quick = (*QUICK, "--peers", "none")
    assert "nowhere.obj" in run("bench", "nowhere.obj", *quick).complaint
    (tmp_path / "points.ply").write_text("")
    assert "points.ply" in run("bench", "points.ply", *quick).complaint
    assert "forest" in run("bench", "forest:3", *quick).complaint

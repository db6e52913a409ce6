"""``raystream bench``."""

from __future__ import annotations

import importlib
import inspect

import pytest

from raystream.bench.contenders import PEERS
from raystream.bench.ray_sets import DEFAULT_SETS, RAY_SETS
from raystream.bench.report import OUTPUT_SUFFIXES
from raystream.bench.runner import Bench
from raystream.cli import options
from raystream.cli.bench import DEFAULT_SCENES, bench

pytestmark = pytest.mark.usefixtures("few_objects")

QUICK = ("--width", 8, "--height", 6, "--repeats", 1, "--no-memory")


def test_names_are_the_librarys():
    assert tuple(RAY_SETS) == options.RAY_SETS
    assert tuple(PEERS) == options.PEERS
    assert inspect.signature(bench).parameters["sets"].default == ",".join(DEFAULT_SETS)
    assert OUTPUT_SUFFIXES == (".md", ".rst", ".json")


def test_json(run):
    done = run("bench", "cornell", *QUICK, "--peers", "none", "--sets", "primary,ao", "--json")
    assert done.code == 0
    figures = done.figures
    assert figures["size"] == [8, 6]
    assert figures["repeats"] == 1
    assert figures["own"] == ["raystream"]
    assert figures["machine"]["threads"] >= 1
    (scene,) = figures["scenes"]
    assert scene["scene"] == "cornell"
    assert [rays["set"] for rays in scene["sets"]] == ["primary", "ao"]
    assert len(scene["builds"]["raystream"]["seconds"]) == 1
    assert scene["sets"][0]["ratio_to_open3d"] == {"raystream": None}


def test_table_variants_and_file(run, tmp_path):
    done = run(
        *("bench", "cornell", "spheres:500", *QUICK, "--peers", "none", "--sets", "bounce,multi"),
        *("--option", "max_leaf_size=2", "--variant", "fat:max_leaf_size=8,structure=bvh"),
        *("-o", "table.md"),
    )
    assert done.code == 0
    assert "cornell: 3" in done.out
    header = next(line for line in done.out.splitlines() if line.startswith("rays"))
    assert header.split()[:4] == ["rays", "count", "raystream", "fat"]
    assert "| bounce |" in (tmp_path / "table.md").read_text()


def test_interrupt_shows_what_there_is(run, monkeypatch):
    ran = Bench.run

    def stop(self, name, scene, progress=None):
        if name == "spheres":
            raise KeyboardInterrupt
        ran(self, name, scene, progress)

    monkeypatch.setattr(Bench, "run", stop)
    done = run("bench", "cornell", "spheres", *QUICK, "--peers", "none", "--sets", "primary")
    assert done.code == 130
    assert done.err.endswith("interrupted\n")
    assert "cornell" in done.out


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
        (["--output", "table.pdf"], ".md or .rst or .json"),
    ],
)
def test_bad_arguments(run, arguments, fault):
    assert fault in run("bench", "cornell", *QUICK, "--peers", "none", *arguments).complaint


def test_bad_scenes(run, tmp_path):
    quick = (*QUICK, "--peers", "none")
    assert "nowhere.obj" in run("bench", "nowhere.obj", *quick).complaint
    (tmp_path / "points.ply").write_text("")
    assert "points.ply" in run("bench", "points.ply", *quick).complaint
    assert "forest" in run("bench", "forest:3", *quick).complaint

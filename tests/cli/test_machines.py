"""``--machine``, ``--scheduler`` and ``--adapter``, in every command that traces."""

from __future__ import annotations

import importlib
import re

import numpy as np
import pytest

import raystream as rs

COMMANDS = {
    "render": ["render", "SCENE", "--size", "8x8"],
    "info": ["info", "SCENE"],
    "query": ["query", "SCENE", "rays.npz", "-o", "hits.npz"],
}


def on(scene, command):
    """A command's words, with its scene."""
    return [scene if word == "SCENE" else word for word in COMMANDS[command]]


@pytest.fixture(params=COMMANDS)
def command(request, square, rays):
    return [*on("square.obj", request.param), "--structure", "grid"]


@pytest.fixture(params=COMMANDS)
def on_saved(request, square, rays):
    """A command on a structure that was saved."""
    rs.Tracer(rs.load(square), "kdtree").save("saved.npz")
    return on("saved.npz", request.param)


@pytest.fixture
def asked(monkeypatch):
    """Options that tracers were made with, except for progress callbacks."""
    importlib.import_module("raystream.rendering.arguments")  # has the tracer's class by its name
    made = []

    class Noted(rs.Tracer):
        def __init__(self, *arguments, progress=None, **options):
            made.append(options)
            super().__init__(*arguments, progress=progress, **options)

        @classmethod
        def load(cls, path, **options):
            made.append(options)
            return super().load(path, **options)

    monkeypatch.setattr("raystream.tracer.Tracer", Noted)
    return made


@pytest.mark.ci
@pytest.mark.parametrize(
    ("arguments", "options"),
    [
        ([], {}),
        (["--machine", "branching"], {"machine": "branching"}),
        (["--machine", "multipass"], {"machine": "multipass"}),
        (
            ["--machine", "multipass", "--scheduler", "most-work"],
            {"machine": "multipass", "scheduler": "most-work"},
        ),
        (
            ["--option", "machine=multipass", "--scheduler", "double"],
            {"machine": "multipass", "scheduler": "double"},
        ),
        (["--machine", "multipass", "--option", "machine=multipass"], {"machine": "multipass"}),
    ],
)
def test_machine_reaches_the_tracer(run, command, asked, arguments, options):
    assert run(*command, *arguments).code == 0
    assert asked == [options]


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (["--machine", "abacus"], "expected branching or multipass or compute, got 'abacus'"),
        (["--machine", "compute"], "--machine: expected one of 'branching', 'multipass', got"),
        (["--adapter", "llvmpipe"], "--adapter: only with --device graphics"),
        (["--machine", "multipass", "--scheduler", "fair"], "--scheduler"),
        (["--scheduler", "naive"], "--scheduler: only with --machine multipass"),
        (
            ["--machine", "branching", "--scheduler", "naive"],
            "--scheduler: only with --machine multipass",
        ),
        (
            ["--machine", "branching", "--option", "machine=multipass"],
            "--option: machine differs from --machine",
        ),
        (
            ["--machine", "multipass", "--scheduler", "naive", "--option", "scheduler=double"],
            "--option: scheduler differs from --scheduler",
        ),
    ],
)
def test_contradictions_are_refused_in_one_line(run, command, arguments, complaint):
    assert complaint in run(*command, *arguments).complaint


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (["--option", "machine=abacus"], "--machine: expected one of 'branching', 'multipass'"),
        (
            ["--machine", "multipass", "--option", "scheduler=fair"],
            "--scheduler: expected one of 'threshold', 'naive', 'most-work', 'double', got 'fair'",
        ),
        (
            ["--machine", "multipass", "--option", "threshold=2"],
            "--option: threshold: expected 0 to 1, got 2",
        ),
        (["--option", "threshold=0.5"], "--option: branching: has no option 'threshold'"),
        (["--option", "resolution=0"], "--option: resolution: "),
    ],
)
def test_option_at_fault_is_named(run, command, arguments, complaint):
    assert run(*command, *arguments).complaint.startswith(complaint)


@pytest.mark.ci
@pytest.mark.parametrize(
    ("arguments", "figures"),
    [
        ([], {"machine": "branching"}),
        (["--machine", "branching"], {"machine": "branching"}),
        (["--machine", "multipass"], {"machine": "multipass", "scheduler": "threshold"}),
        (
            ["--machine", "multipass", "--scheduler", "double"],
            {"machine": "multipass", "scheduler": "double"},
        ),
        (
            ["--option", "machine=multipass", "--option", "scheduler=naive"],
            {"machine": "multipass", "scheduler": "naive"},
        ),
    ],
)
def test_json_names_the_machine(run, command, arguments, figures):
    printed = run(*command, *arguments, "--json").figures
    assert printed["device"] == "cpu"
    assert {key: printed[key] for key in ("machine", "scheduler") if key in printed} == figures


@pytest.mark.ci
@pytest.mark.parametrize("structure", ["bvh", "kdtree", "grid", "brute"])
def test_machines_find_the_same(run, square, rays, structure):
    found = []
    for machine in ("branching", "multipass"):
        asked = ("--structure", structure, "--machine", machine)
        assert run("query", square, rays, "-o", f"{machine}.npz", *asked).code == 0
        with np.load(f"{machine}.npz") as arrays:
            found.append(dict(arrays))
    for name in found[0]:
        np.testing.assert_array_equal(found[0][name], found[1][name])


# Saved structures.


@pytest.mark.ci
@pytest.mark.parametrize(
    ("arguments", "options"),
    [
        ([], {}),
        (["--machine", "branching"], {"machine": "branching"}),
        (
            ["--machine", "multipass", "--scheduler", "naive", "--option", "traversal_steps=4"],
            {"machine": "multipass", "scheduler": "naive", "traversal_steps": 4},
        ),
    ],
)
def test_machine_reaches_a_saved_structure(run, on_saved, asked, arguments, options):
    result = run(*on_saved, *arguments, "--json")
    assert (result.code, result.err) == (0, "")
    assert asked == [{"device": "cpu", **options}]
    assert result.figures["machine"] == options.get("machine", "branching")


@pytest.mark.ci
@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (
            ["--option", "max_leaf_size=8"],
            "saved.npz: the structure is already built.* 'max_leaf_size'",
        ),
        (
            ["--traversal", "stack"],
            "saved.npz: the structure is already built.* 'traversal' does not apply",
        ),
        (
            ["--machine", "multipass", "--option", "traversal_steps=0"],
            "--option: traversal_steps: expected at least 1",
        ),
        (["--option", "threshold=0.5"], "--option: branching: has no option 'threshold'"),
        (["--scheduler", "naive"], "--scheduler: only with --machine multipass"),
    ],
)
def test_saved_structure_takes_options_of_the_machine_only(run, on_saved, arguments, complaint):
    assert re.match(complaint, run(*on_saved, *arguments).complaint)


def test_damaged_structure_is_blamed_whatever_the_machine(run, tmp_path):
    (tmp_path / "damaged.npz").write_bytes(b"PK\x03\x04 no archive")
    complaint = run("info", "damaged.npz", "--machine", "multipass").complaint
    assert complaint.startswith("damaged.npz: ")


@pytest.mark.ci
def test_passes_of_an_image_are_counted(run):
    arguments = ("render", "cornell", "--size", "16x12", "--mode", "shadow", "--json")
    figures = run(*arguments, "--machine", "multipass", "--structure", "grid").figures
    assert list(figures["passes"]) == ["eye rays", "set up", "traverse", "intersect", "shade"]
    assert "passes" not in run(*arguments).figures

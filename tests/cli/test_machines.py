"""``--machine`` and ``--scheduler``, in every command that traces."""

from __future__ import annotations

import pytest

import raystream as rs
from counting import CountingTracer

SQUARE = "square.obj"
COMMANDS = {
    "render": ["render", SQUARE, "--size", "8x8"],
    "info": ["info", SQUARE],
    "query": ["query", SQUARE, "rays.npz", "-o", "hits.npz"],
}


@pytest.fixture(params=COMMANDS)
def command(request, square, rays):
    return COMMANDS[request.param]


@pytest.fixture
def asked(monkeypatch):
    """Options of the machine that tracers were made with."""
    made = []

    class Noted(CountingTracer):
        def __init__(self, *arguments, **options):
            super().__init__(*arguments, **options)
            made.append(self.asked)

    monkeypatch.setattr("raystream.tracer.Tracer", Noted)
    return made


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
        (["--machine", "abacus"], "expected branching or multipass, got 'abacus'"),
        (["--machine", "multipass", "--scheduler", "fair"], "--scheduler"),
        (["--scheduler", "naive"], "--scheduler: only with --machine multipass"),
        (
            ["--machine", "branching", "--scheduler", "naive"],
            "--scheduler: only with --machine multipass",
        ),
        (
            ["--machine", "branching", "--option", "machine=multipass"],
            "--option: another machine than --machine",
        ),
        (
            ["--machine", "multipass", "--scheduler", "naive", "--option", "scheduler=double"],
            "--option: another scheduler than --scheduler",
        ),
    ],
)
def test_contradictions_are_refused_in_one_line(run, command, arguments, complaint):
    assert complaint in run(*command, *arguments).complaint


def test_saved_structure_has_no_machine(run, square):
    rs.Tracer(rs.load(square)).save("saved.npz")
    complaint = run("info", "saved.npz", "--machine", "multipass").complaint
    assert complaint.startswith("saved.npz: a saved structure has no --option")

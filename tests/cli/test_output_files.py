"""Output files of ``raystream render``: their default names, and which files are replaced."""

from __future__ import annotations

from pathlib import Path

import pytest
from PIL import Image

import raystream as rs
from raystream.cli.render_job import _default_output

TINY = ("--size", "8x6", "--mode", "vis", "--samples", 1)
REFUSAL = (
    "{}: exists, and was not written by raystream; choose another --output, or pass --force to "
    "replace it"
)


@pytest.fixture
def forbidden(monkeypatch):
    """Fail if a scene is loaded or rendered."""

    def fail(*_, **__):
        pytest.fail("work before the refusal")

    monkeypatch.setattr("raystream.scene.load.load", fail)
    monkeypatch.setattr("raystream.tracer.Tracer.first_hit", fail)


def foreign(name: str) -> bytes:
    """Save an image as another program would; returns the file's bytes."""
    Image.new("RGB", (8, 6), "red").save(name)
    return Path(name).read_bytes()


@pytest.mark.parametrize(
    ("scene", "name"),
    [
        ("cornell", "cornell.png"),
        ("forest:1000", "forest.png"),
        ("models/truck.glb", "truck.png"),
        ("../city.v2.obj.gz", "city.v2.png"),
        ("tree.npz", "tree.png"),
        ("", "image.png"),
    ],
)
def test_default_names(scene, name):
    assert _default_output(scene) == Path(name)


def test_the_default_is_in_the_current_folder(run, square, tmp_path, monkeypatch):
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    assert run("render", square, *TINY, "--json").figures["output"] == "square.png"
    assert [path.name for path in Path().iterdir()] == ["square.png"]


@pytest.mark.parametrize("arguments", [(), ("-o", "a.png")], ids=["default", "named"])
def test_a_file_of_raystream_is_replaced(run, square, arguments):
    name = arguments[-1] if arguments else "square.png"
    rs.Image([[[1.0, 0.0, 0.0]]]).save(name)
    assert run("render", square, *TINY, *arguments).code == 0
    assert rs.Image.load(name).size == (8, 6)


@pytest.mark.parametrize("arguments", [(), ("-o", "a.png"), ("--resume",), ("--frames", "0")])
def test_other_files_are_kept_before_any_work(run, square, forbidden, arguments):
    name = "a.png" if "-o" in arguments else "square.png"
    kept = foreign(name)
    assert run("render", square, *arguments).complaint == REFUSAL.format(name)
    assert Path(name).read_bytes() == kept


def test_a_name_that_frames_cannot_have_is_told_before_force(run, square, forbidden):
    foreign("square.png")
    complaint = run("render", square, "--frames", "0:9").complaint
    assert complaint.startswith("square.png: expected one frame number placeholder")


def test_heat_maps_follow_the_rule(run, square, forbidden):
    kept = foreign("square.png")
    assert run("render", square, "--heatmap", "cells").complaint == REFUSAL.format("square.png")
    assert Path("square.png").read_bytes() == kept


def test_force_replaces_any_file(run, square):
    foreign("square.png")
    assert run("render", square, *TINY, "--force").code == 0
    assert rs.Image.load("square.png").size == (8, 6)


def test_an_empty_file_is_replaced(run, square):
    Path("square.png").touch()
    assert run("render", square, *TINY).code == 0


def test_a_file_that_cannot_be_read_is_one_line(run, square, monkeypatch):
    def fail(_):
        raise PermissionError(13, "Permission denied")

    foreign("square.png")
    monkeypatch.setattr("raystream.rendering.software_tag.is_tagged", fail)
    assert run("render", square).complaint == "square.png: Permission denied"


MOVING = """v from 0 0 5 at 0 0 0 up 0 1 0 angle 40
a 0 2 2
x a { p 3 0 0 0 1 0 0 0 1 0 }
k a { transl 2 0 -1 0 0 0 0 0 2 1 0 0 0 0 0 }
"""


def test_frames_and_videos_follow_the_rule(run, tmp_path):
    Path("a.aff").write_text(MOVING, encoding="ascii")
    frames = ("render", "a.aff", *TINY, "--frames", ":", "-o", "f%d.png")
    assert run(*frames).code == 0
    assert run(*frames).code == 0
    kept = foreign("f1.png")
    Path("f0.png").unlink()
    assert run(*frames).complaint == REFUSAL.format("f1.png")
    assert not Path("f0.png").exists()
    assert Path("f1.png").read_bytes() == kept
    assert run(*frames, "--force").code == 0
    assert Path("f1.png").read_bytes() != kept
    video = ("render", "a.aff", *TINY, "-o", "a.gif")
    assert run(*video).code == 0
    assert run(*video).code == 0
    kept = foreign("a.gif")
    assert run(*video).complaint == REFUSAL.format("a.gif")
    assert Path("a.gif").read_bytes() == kept
    assert not Path("a.gif.frames").exists()
    assert run(*video, "--force").code == 0

"""``raystream render --frames``."""

from __future__ import annotations

import functools
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import raystream as rs
from raystream.rendering import frames as render_frames_room

MOVING = """v from 0 0 5 at 0 0 0 up 0 1 0 angle 40
a 0 2 10
x a { p 3 0 0 0 1 0 0 0 1 0 }
k a { transl 2 0 -1 0 0 0 0 0 2 1 0 0 0 0 0 }
"""
SIZE = ("--size", "16x12")


@pytest.fixture
def moving(tmp_path) -> Path:
    path = tmp_path / "a.aff"
    path.write_text(MOVING)
    return path


@pytest.mark.ci
def test_frames_are_the_librarys(run, moving) -> None:
    plain = (*SIZE, "--samples", 2, "--exposure", 1)
    result = run("render", moving, "-o", "f%03d.png", "--frames", "2:9:3", *plain, "--json")
    figures = result.figures
    assert (figures["frames"], figures["fps"], figures["frames_before"]) == (3, 5.0, 0)
    assert sorted(p.name for p in Path().glob("*.png")) == ["f002.png", "f005.png", "f008.png"]
    scene = rs.load(moving)
    for frame, image in rs.render_frames(scene, frames=[2, 5, 8], size=(16, 12), samples=2):
        with Image.open(f"f{frame:03d}.png") as found:
            np.testing.assert_array_equal(np.asarray(found), image.to_bytes())
    assert run("render", moving, "-o", "one.png", "--frames", "-1", *SIZE).code == 0
    assert run("render", moving, "-o", "folder", "--fps", "1", "--frames", ":", *SIZE).code == 0
    assert sorted(p.name for p in Path("folder").iterdir()) == ["0000.png", "0001.png"]


@pytest.mark.ci
def test_resume_renders_what_is_missing(run, moving) -> None:
    animation = ("render", moving, "-o", "f%d.png", "--frames", ":", *SIZE, "--samples", "2")
    assert run(*animation).code == 0
    whole = {path.name: path.read_bytes() for path in Path().glob("f*.png")}
    assert len(whole) == 10
    Path("f3.png").unlink()
    Path("f7.png").write_bytes(whole["f7.png"][:60])
    kept = Path("f5.png").stat().st_mtime_ns
    result = run(*animation, "--resume", "--json")
    assert (result.figures["frames_before"], result.err) == (8, "8 of 10 frames exist already\n")
    assert {path.name: path.read_bytes() for path in Path().glob("f*.png")} == whole
    assert Path("f5.png").stat().st_mtime_ns == kept
    animation = ("render", moving, "-o", "f%d.png", "--frames", ":", "--size", "8x6", "--resume")
    other = run(*animation)
    assert "f0.png: is 16x12, not 8x6" in other.complaint


@pytest.mark.ci
def test_videos_go_on_after_an_interrupt(run, moving, monkeypatch) -> None:
    animation = ("render", moving, "-o", "animation.gif", "--size", "64x48")
    real, calls = render_frames_room.render, []

    @functools.wraps(real)
    def interrupted(*arguments, **options):
        calls.append(1)
        if len(calls) == 4:
            raise KeyboardInterrupt
        return real(*arguments, **options)

    monkeypatch.setattr(render_frames_room, "render", interrupted)
    result = run(*animation)
    assert result.code == 130
    assert result.err.startswith("interrupted; 3 of 10 frames are in animation.gif.frames")
    assert "--resume" in result.err
    assert not Path("animation.gif").exists()
    assert "contains frames" in run(*animation).complaint
    result = run(*animation, "--resume")
    assert (result.code, result.err) == (0, "3 of 10 frames exist already\n")
    assert "10 frames of 64x48, 5 fps" in result.out
    assert len(calls) == 4 + 7
    assert not Path("animation.gif.frames").exists()
    with Image.open("animation.gif") as found:
        assert (found.n_frames, found.info["duration"]) == (10, 200)


@pytest.mark.parametrize(
    ("scene", "arguments", "reason"),
    [
        ("a.aff", ("-o", "x%d.png", "--frames", "5:11"), "--frames: expected 0 to 9"),
        ("a.aff", ("-o", "x%d.png", "--frames", "3:3"), "--frames: selects none of"),
        ("a.aff", ("-o", "x%d.png", "--frames", "1:b"), "--frames: expected 0:100"),
        ("a.aff", ("-o", "x.png", "--frames", ":"), "x.png: expected one frame number placeholder"),
        ("a.aff", ("-o", "x%d%d.png", "--frames", ":"), "expected one frame number placeholder"),
        ("a.aff", ("-o", "x%d.bmp", "--frames", ":"), "extension must be .png or .exr or .hdr"),
        ("a.aff", ("-o", "no/x%d.png", "--frames", ":"), "folder no does not exist"),
        ("a.aff", ("-o", "no/there", "--frames", ":"), "folder no does not exist"),
        ("a.aff", ("-o", "x.png", "--fps", "5"), "--fps: only with --frames"),
        ("a.aff", ("-o", "x.gif", "--time", "1"), "--time: cannot be combined with --frames"),
        (
            "a.aff",
            ("-o", "x.gif", "--heatmap", "cells"),
            "--heatmap: cannot be combined with --frames",
        ),
        ("a.aff", ("-o", "x.gif", "--camera", "left door"), "no camera 'left door'"),
        ("cornell", ("-o", "x%d.png", "--frames", ":"), "cornell: is static"),
        ("a.npz", ("-o", "x%d.png", "--frames", ":"), "a saved structure is static"),
    ],
)
def test_refusals(run, moving, scene, arguments, reason) -> None:
    assert reason in run("render", scene, *arguments).complaint


def test_videos_that_need_ffmpeg_say_so_first(run, moving, monkeypatch, tmp_path) -> None:
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    assert "animation.mp4: needs ffmpeg" in run("render", moving, "-o", "animation.mp4").complaint
    assert not list(tmp_path.glob("animation*"))


def test_camera_parts_replace_those_of_the_scene(run, moving) -> None:
    view = ("--camera", "camera", "--fov", 20, "--mode", "vis", "--samples", 1)
    assert run("render", moving, "-o", "x%d.png", "--frames", "4", *SIZE, *view).code == 0
    assert run("render", moving, "-o", "still.png", "--time", "0.8", *SIZE, *view).code == 0
    assert Path("x4.png").read_bytes() == Path("still.png").read_bytes()

"""``raystream render --environment`` and ``--lights``."""

from __future__ import annotations

import numpy as np
import pytest
from PIL import Image

import raystream as rs
from raystream.cli.brightness import Exposure
from raystream.cli.lighting import SUFFIXES, LightingOptions
from raystream.rendering.environment import MAP_SUFFIXES

SIZE = ("--size", "16x12")
WHITTED = (*SIZE, "--mode", "whitted", "--samples", 1)

WEAK = """\
mtllib weak.mtl
v 0 0 0
v 40 0 0
v 0 40 0
v 1 1 1
v 2 1 1
v 1 2 1
usemtl wall
f 1 2 3
usemtl lamp
f 4 5 6
"""
MATERIALS = "newmtl wall\nKd 0.8 0.1 0.1\nnewmtl lamp\nKe 0.02 0.02 0.02\n"
NOTE = (
    "warning: the scene's own lights are too weak to see by: added {} (lights='file' or --lights "
    "file uses only the scene's own)\n"
)


@pytest.fixture
def sky(run, tmp_path):
    """A map in the folder that commands run in."""
    pixels = np.random.default_rng(1).integers(0, 256, (8, 16, 3), np.uint8)
    Image.fromarray(pixels).save(tmp_path / "sky.png")
    return "sky.png"


def test_the_sky_is_replaced(run, sky):
    """The scene's own environment light and background go, its sun stays."""
    result = run("render", "robots", *WHITTED, "--environment", sky, "--environment-rotation", 30)
    assert (result.code, result.err) == (0, "")
    scene = rs.load("robots")
    light = rs.EnvironmentLight(image=sky, up=tuple(scene.up), rotation=30)
    kinds = [type(other) for other in scene.lights]
    assert kinds == [rs.DirectionalLight, rs.EnvironmentLight]
    scene = scene.replace(lights=(scene.lights[0], light), background=(0.0, 0.0, 0.0))
    expected = rs.render(scene, "whitted", (16, 12)).to_bytes()
    with Image.open("robots.png") as image:
        np.testing.assert_array_equal(np.asarray(image), expected)


def test_suffixes_are_those_of_the_library():
    assert SUFFIXES == MAP_SUFFIXES


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (["--environment-rotation", 3], "--environment-rotation: only with --environment"),
        (["--environment", "sky.gif"], "sky.gif: file extension must be .hdr or"),
        (["--environment", "none.hdr"], "none.hdr: cannot be read"),
        (["--environment", "sky.png", "-o", "sky.png"], "sky.png: is an input"),
        (
            ["--environment", "sky.png", "--heatmap", "steps"],
            "--environment: cannot be combined with --heatmap",
        ),
    ],
)
def test_bad_maps_are_refused(run, sky, arguments, reason):
    mode = () if "--heatmap" in arguments else WHITTED
    assert run("render", "cornell", *mode, *arguments).complaint.startswith(reason)


@pytest.fixture
def weak(tmp_path):
    """A model with a lamp that is too weak, in the folder that commands run in."""
    (tmp_path / "weak.obj").write_text(WEAK)
    (tmp_path / "weak.mtl").write_text(MATERIALS)
    return "weak.obj"


def pixels(name="weak.png"):
    with Image.open(name) as image:
        return np.asarray(image)


@pytest.mark.parametrize(
    ("mode", "added"), [("raycast", "a light at the eye"), ("path", "a sun and a sky")]
)
def test_a_note_says_what_is_added_to_weak_lights(run, weak, mode, added):
    result = run("render", weak, *SIZE, "--mode", mode, "--samples", 1)
    assert (result.code, result.err) == (0, NOTE.format(added))
    assert pixels().max() > 100
    with pytest.warns(rs.RaystreamWarning, match=f"too weak to see by: added {added}"):
        image = rs.render(rs.load(weak), mode, (16, 12), 1)
    np.testing.assert_array_equal(pixels(), image.to_bytes())


def test_the_files_own_lights_are_taken_if_asked(run, weak):
    result = run("render", weak, *SIZE, "--mode", "raycast", "--samples", 1, "--lights", "file")
    assert result.code == 0
    assert result.err.startswith("the image is black: the scene's own lights do not reach")
    own = rs.render(rs.load(weak), "raycast", size=(16, 12), lights="file")
    np.testing.assert_array_equal(pixels(), own.to_bytes())
    assert pixels().max() < 50


@pytest.mark.parametrize(
    "arguments",
    [
        ("weak.obj", "--mode", "vis"),
        ("weak.obj", "--heatmap", "tests"),
        ("cornell", "--samples", 4),
    ],
)
def test_nothing_is_said_where_nothing_is_added(run, weak, arguments):
    result = run("render", *arguments, *SIZE)
    assert (result.code, result.err) == (0, "")


def test_animations_say_it_once(run, tmp_path):
    (tmp_path / "a.aff").write_text(
        "v from 0 0 5 at 0 0 0 up 0 1 0 angle 40\nl 0 3 5 0.0005 0.0005 0.0005\n"
        "a 0 2 10\nx a { p 3 0 0 0 1 0 0 0 1 0 }\nk a { transl 2 0 -1 0 0 0 0 0 2 1 0 0 0 0 0 }\n"
    )
    animation = ("render", "a.aff", "-o", "f%d.png", "--frames", "0:3", *SIZE, "--mode", "raycast")
    assert run(*animation).err == NOTE.format("a light at the eye")
    with Image.open("f2.png") as image:
        assert np.asarray(image).max() > 100
    assert run(*animation, "--lights", "file").err == ""
    with Image.open("f2.png") as image:
        assert np.asarray(image).max() < 5


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (["--lights", "all"], "'--lights': expected auto or file or added, got 'all'"),
        (["--lights", "file", "--heatmap", "steps"], "--lights: cannot be combined with --heatmap"),
    ],
)
def test_bad_lights_are_refused(run, arguments, reason):
    assert reason in run("render", "cornell", *SIZE, *arguments).err


def test_a_sun_and_a_clear_sky_replace_the_scene_s(run):
    result = run("render", "robots", *WHITTED, "--sun", 200, 35)
    assert (result.code, result.err) == (0, "")
    scene = rs.load("robots")
    scene = scene.replace(lights=rs.daylight(200, 35, up=scene.up), background=(0.0, 0.0, 0.0))
    with Image.open("robots.png") as image:
        expected = rs.render(scene, "whitted", (16, 12)).to_bytes("auto")
        np.testing.assert_array_equal(np.asarray(image), expected)


def test_modes_without_light_are_exposed_by_1_under_a_sun(run):
    assert (
        run("render", "robots", *SIZE, "--mode", "vis", "--samples", 1, "--sun", 200, 35).code == 0
    )
    shown = pixels("robots.png")
    expected = rs.render(rs.load("robots").replace(background=(0, 0, 0)), "vis", (16, 12))
    covered = expected.pixels.any(axis=2)
    np.testing.assert_array_equal(shown[covered], expected.to_bytes()[covered])


def test_images_that_lights_leave_dark_are_shown_brighter(capsys):
    lit, dark, own = rs.load("cornell"), rs.Image(np.full((8, 8, 3), 0.01)), LightingOptions()
    chosen = Exposure(None, own, lit, "path")
    assert chosen.of(dark) == pytest.approx(90.0)
    assert Exposure(None, LightingOptions(sun=(0, 30)), lit, "path").of(dark) == chosen.of(dark)
    assert Exposure(None, own, lit, "path").of(rs.Image(np.full((8, 8, 3), 0.05))) == 1.0
    chosen.report_dark(dark)
    assert "leave the image dark: it is shown 90 times as bright" in capsys.readouterr().err
    assert chosen.of(rs.Image(np.full((8, 8, 3), 0.2))) == 1.0
    insisted = LightingOptions(lights="file")
    off = lit.replace(lights=[rs.PointLight((0, 0, 0), (0, 0, 0))])
    for exposure in (
        Exposure("1", own, lit, "path"),
        Exposure(None, own, lit, "vis"),
        Exposure(None, own, off, "path"),
        Exposure(None, own, lit, "path", is_fixed=True),
        Exposure(None, insisted, lit, "path"),
    ):
        assert exposure.of(dark) == 1.0
        exposure.report_dark(dark)
    assert not capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (["--sun", 0, 0], "--sun': expected an elevation above 0 and at most 90 degrees, got 0"),
        (["--sun", 0, "nan"], "--sun': expected an elevation"),
        (["--sun", "inf", 30], "--sun': expected a finite azimuth, got inf"),
        (["--sun", 0, 30, "--environment", "sky.png"], "--sun: cannot be combined with"),
        (["--sun", 0, 30, "--heatmap", "steps"], "--sun: cannot be combined with --heatmap"),
    ],
)
def test_bad_suns_are_refused(run, arguments, reason):
    result = run("render", "cornell", *SIZE, *arguments)
    assert result.code == 2
    assert reason in result.err

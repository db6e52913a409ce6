"""``raystream render --environment``."""

from __future__ import annotations

import numpy as np
import pytest
from PIL import Image

import raystream as rs
from raystream.cli.environment import SUFFIXES
from raystream.rendering.environment import MAP_SUFFIXES

SIZE = ("--size", "16x12", "--mode", "whitted")


@pytest.fixture
def sky(run, tmp_path):
    """A map in the folder that commands run in."""
    pixels = np.random.default_rng(1).integers(0, 256, (8, 16, 3), np.uint8)
    Image.fromarray(pixels).save(tmp_path / "sky.png")
    return "sky.png"


def test_the_sky_is_replaced(run, sky):
    """The scene's own environment light and background go, its sun stays."""
    result = run("render", "robots", *SIZE, "--environment", sky, "--environment-rotation", 30)
    assert (result.code, result.err) == (0, "")
    scene = rs.load("robots")
    light = rs.EnvironmentLight(image=sky, up=tuple(scene.up), rotation=30)
    kinds = [type(other) for other in scene.lights]
    assert kinds == [rs.DirectionalLight, rs.EnvironmentLight]
    scene = scene.replace(lights=(scene.lights[0], light), background=(0.0, 0.0, 0.0))
    expected = rs.render(scene, "whitted", (16, 12)).to_bytes()
    with Image.open("out.png") as image:
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
    mode = () if "--heatmap" in arguments else SIZE
    assert run("render", "cornell", *mode, *arguments).complaint.startswith(reason)

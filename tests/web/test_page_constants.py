"""Constants that the scripts of pages share with Python."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

import raystream as rs
from raystream.graphics.multipass import device_scheduler, loops, ray_loop
from raystream.graphics.multipass.kernels import STREAMS
from raystream.graphics.rendering import compute_bands, path_rows
from raystream.graphics.rendering.modes import mode_of
from raystream.graphics.rendering.uniforms import BandPlace, shading_uniform
from raystream.graphics.streams import textures
from raystream.machines.records import RayState
from raystream.machines.schedulers import SCHEDULERS, Threshold, make_scheduler
from raystream.rendering.render import RENDERERS
from raystream.web import pass_kernels
from raystream.web.scene_data import _context

PAGE = Path(rs.__file__).parent / "web" / "page"
IMAGES = (PAGE / "images.js").read_text()
PASSES = "".join(
    (PAGE / f"{one}.js").read_text() for one in ("pass_streams", "pass_schedule", "passes")
)


def constant(name, text=IMAGES):
    return int(re.search(rf"\b{name} = (\d+)", text)[1])


def test_sizes_are_python_s():
    assert constant("PIXEL_BYTES") == compute_bands._PIXEL_BYTES
    assert constant("GROUP_SIZE") == compute_bands._GROUP_SIZE
    assert constant("FIRST_ROOM") == path_rows._FIRST_ROOM
    assert constant("MOST_ROOM") == path_rows._MOST_ROOM
    assert constant("ROW_BYTES") == path_rows._ROW_BYTES


def test_words_of_the_uniform_are_python_s():
    scene = rs.load("cornell")
    context = _context(rs.Tracer(scene, "brute"), scene.camera_for(1.0), "raycast")
    mode = mode_of(RENDERERS["raycast"].stages)
    place = BandPlace(first_pixel=1001, pixel_count=1002, sample=1003, room=1004)
    words = np.frombuffer(shading_uniform(context, mode, place), np.uint32)
    known = re.search(r"const AT = \{(.*)\};", IMAGES)[1]
    places = dict(one.split(": ") for one in known.split(", "))
    assert places.keys() == place._asdict().keys()
    for name, at in places.items():
        assert words[int(at)] == getattr(place, name), name


def names_in(name):
    """A list of names in the scripts of passes."""
    listed = re.search(rf"\b{name} = \[(.*?)\];", PASSES, re.DOTALL)[1]
    return re.findall(r'"(\w+)"', listed)


def test_streams_are_python_s():
    assert names_in("SHADING_STREAMS") == list(ray_loop.LOOP_STREAMS)
    assert names_in("SEARCH_STREAMS") == list(STREAMS)
    assert names_in("READ_BY_SHADING") == list(ray_loop._READ_BY_SHADING)
    assert [*names_in("READ_BY_SEARCHES"), *STREAMS] == list(ray_loop._READ_BY_SEARCHES)
    floats = {name for name, dtype in ray_loop.LOOP_TYPES.items() if dtype == "float32"}
    assert set(names_in("FLOATS")) == floats
    assert constant("TEXEL_BYTES", PASSES) == textures.TEXEL_BYTES
    assert constant("COLUMNS", PASSES) == textures._COLUMNS
    assert constant("PIXEL_TEXELS", PASSES) * textures.TEXEL_BYTES == compute_bands._PIXEL_BYTES
    assert constant("LIGHT", PASSES) * textures.TEXEL_BYTES == compute_bands._LIGHT_OFFSET


def test_the_schedule_is_python_s():
    for name in ("COUNTS_AT", "LATEST_AT", "HEAD_WORDS"):
        assert constant(name, PASSES) == getattr(device_scheduler, f"_{name}")
    assert constant("MOST_KERNELS", PASSES) == device_scheduler._MOST_KERNELS
    assert constant("GROUP_SIDE", PASSES) == device_scheduler._GROUP_SIZE
    assert constant("FIRST_PASSES", PASSES) == loops._FIRST_PASSES
    assert constant("MOST_PASSES", PASSES) == loops.MOST_PASSES
    made = pass_kernels.schedule()
    assert made["states"]["no room"] == RayState.NO_ROOM
    assert SCHEDULERS.index("threshold") == 0  # what multipass/schedule.wgsl has by default
    default = make_scheduler("threshold")
    assert isinstance(default, Threshold)
    assert made["threshold"] == default.share

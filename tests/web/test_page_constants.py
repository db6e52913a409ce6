"""Constants that the scripts of pages share with Python."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

import raystream as rs
from raystream.graphics.rendering import compute_bands, path_rows
from raystream.graphics.rendering.modes import mode_of
from raystream.graphics.rendering.uniforms import BandPlace, shading_uniform
from raystream.rendering.render import RENDERERS
from raystream.web.scene_data import _context

IMAGES = (Path(rs.__file__).parent / "web" / "page" / "images.js").read_text()


def constant(name):
    return int(re.search(rf"\b{name} = (\d+)", IMAGES)[1])


def test_sizes_are_python_s():
    assert constant("PIXEL_BYTES") == compute_bands._PIXEL_BYTES
    assert constant("GROUP_SIZE") == compute_bands._GROUP_SIZE
    assert constant("FIRST_ROOM") == path_rows._FIRST_ROOM
    assert constant("MOST_ROOM") == path_rows._MOST_ROOM
    assert constant("ROW_BYTES") == path_rows._ROW_BYTES


def test_words_of_the_uniform_are_python_s():
    scene = rs.load("cornell")
    context = _context(rs.Tracer(scene, "brute"), scene.camera_for(1.0), (4, 3), "raycast")
    mode = mode_of(RENDERERS["raycast"].stages)
    place = BandPlace(first_pixel=1001, pixel_count=1002, sample=1003, room=1004)
    words = np.frombuffer(shading_uniform(context, mode, place), np.uint32)
    known = re.search(r"const AT = \{(.*)\};", IMAGES)[1]
    places = dict(one.split(": ") for one in known.split(", "))
    assert places.keys() == place._asdict().keys()
    for name, at in places.items():
        assert words[int(at)] == getattr(place, name), name

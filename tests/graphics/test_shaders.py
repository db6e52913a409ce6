"""Shader files: all are used and compiled, and none is too long."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

import raystream as rs
from conftest import GRAPHICS_TRACERS
from meshes import soup
from raystream.graphics import shader_source as sources
from raystream.graphics.errors import GraphicsError
from raystream.graphics.pipelines import shader_module
from raystream.graphics.shader_source import shader_source
from raystream.graphics.structures import shader_structure_of

ROOM = Path(sources.__file__).parent
SHADERS = ROOM / "shaders"
FILES = {path.relative_to(SHADERS).as_posix(): path for path in SHADERS.rglob("*.wgsl")}

MAX_LINES = 400

#: The comment that `shader_source` begins each file with.
BEGINNING = re.compile(r"^// ([a-z0-9_/]+\.wgsl)$", re.MULTILINE)


#: Halves of a kernel's outputs, for adapters that allow few.
SOMETIMES = {"fragment/targets_found.wgsl", "fragment/targets_place.wgsl"}

#: Those of images, which `test_raster` and `test_fragment_renderer` compile.
OF_PICTURES = ("multipass/loop/", "rendering/", "raster/", "camera.wgsl", "no_hit_rows.wgsl")

#: Those of scenes with instances.
OF_INSTANCES = ("instances/", "float64.wgsl")

#: Those of exported pages, which `web.test_pages` runs in a browser.
OF_PAGES = "page/"

ENTRY = re.compile(r"^@(compute|vertex|fragment)\b", re.MULTILINE)

#: Tracers that have other files than those of the agreement.
MORE_TRACERS = (
    {"structure": "kdtree", "traversal": "backtrack", "device": "graphics"},
    {"structure": "brute", "device": "graphics", "machine": "multipass", "loop": "queries"},
)


def text_of(name: str) -> str:
    return FILES[name].read_text(encoding="utf-8")


def test_no_file_is_longer_than_one_idea():
    assert FILES
    counts = {name: len(text_of(name).splitlines()) for name in FILES}
    assert not {name: count for name, count in counts.items() if count > MAX_LINES}


def test_every_file_says_what_it_holds():
    silent = [name for name in FILES if not re.match(r"// [A-Z0-9].{10,}\n", text_of(name))]
    assert not silent


def test_every_include_is_there():
    included = {one for name in FILES for one in sources._INCLUDE.findall(text_of(name))}
    assert included <= set(FILES)
    # Everything that looks like an include is one: a typo would make it a comment.
    for name in FILES:
        assert text_of(name).count("include ") == len(sources._INCLUDE.findall(text_of(name)))


def test_a_file_is_included_once_and_can_be_replaced():
    whole = shader_source("compute.wgsl", "brute.wgsl", "exact.wgsl")
    names = BEGINNING.findall(whole)
    assert len(names) == len(set(names))
    assert {
        "compute.wgsl",
        "brute.wgsl",
        "exact.wgsl",
        "vertices.wgsl",
        "nearest_hits.wgsl",
    } <= set(names)
    assert "//! include" not in whole
    other = shader_source(
        "compute.wgsl", "brute.wgsl", instead={"nearest_hits.wgsl": "no_hit_rows.wgsl"}
    )
    assert "nearest_hits.wgsl" not in BEGINNING.findall(other)
    assert "no_hit_rows.wgsl" in BEGINNING.findall(other)


@pytest.mark.parametrize("structure", ["bvh", "brute"])
def test_plain_scenes_have_no_code_for_instances(structure):
    plain = rs.Scene.from_arrays(*soup(20, 1))
    placed = rs.Scene.instances(plain, np.eye(3, 4)[None])
    sources = [
        shader_structure_of(rs.Tracer(scene, structure).structure).source("compute.wgsl")
        for scene in (plain, placed)
    ]
    of_plain, of_placed = ({*BEGINNING.findall(source)} for source in sources)
    assert not {name for name in of_plain if name.startswith(OF_INSTANCES)}
    assert {name for name in of_placed if name.startswith(OF_INSTANCES)}
    # One traversal serves both levels.
    assert {name for name in of_plain if name.startswith(("bvh", "brute"))} - of_placed == {
        {"bvh": "bvh_root.wgsl", "brute": "brute_rows.wgsl"}[structure]
    }


@pytest.mark.exhaustive
def test_every_file_is_compiled_for_some_tracer(fresh, monkeypatch):
    """Every file is in some tracer's shaders: with hits, without, or counting."""
    made = type(fresh.device).create_shader_module
    compiled: set[str] = set()

    def note(self, *, code, **options):
        compiled.update(BEGINNING.findall(code))
        return made(self, code=code, **options)

    monkeypatch.setattr(type(fresh.device), "create_shader_module", note)
    plain = rs.Scene.from_arrays(*soup(20, 1))
    placed = rs.Scene.instances(plain, np.eye(3, 4)[None])
    rays = {"origins": np.full((5, 3), 0.5), "directions": np.eye(5, 3) + 0.1}
    tracers = [(plain, options) for options in (*GRAPHICS_TRACERS.values(), *MORE_TRACERS)]
    tracers += [(placed, GRAPHICS_TRACERS[f"{one}, graphics"]) for one in ("bvh", "brute")]
    for scene, options in tracers:
        seen = rs.Tracer(scene, **options).any_hit(**rays)
        every = rs.Tracer(scene, **options, counters=True).multi_hit(**rays)
        assert seen.tolist() == (every.counts > 0).tolist()
    left = {name for name in FILES if not name.startswith((*OF_PICTURES, OF_PAGES))}
    assert sorted(left - SOMETIMES - compiled) == []


def test_programs_of_pages_are_valid_for_another_compiler(opened):
    """That of Firefox: browsers differ in what they accept."""
    names = [name for name in FILES if name.startswith(OF_PAGES) and ENTRY.search(text_of(name))]
    assert names
    for name in names:
        # What searches needs a structure's files.
        more = ["brute.wgsl"] if "search(ray)" in text_of(name) else []
        shader_module(opened, shader_source(name, *more), name)


@pytest.mark.parametrize(
    ("name", "broken"),
    [
        ("brute.wgsl", "fn search(ray: Ray) { let x: u32 = 1.5; }"),
        ("brute.wgsl", "fn search("),
        ("compute.wgsl", "fn nothing() {}"),  # no entry point
    ],
)
def test_a_shader_that_does_not_compile_is_one_error(fresh, monkeypatch, name, broken):
    text = sources._text_of
    monkeypatch.setattr(
        sources, "_text_of", lambda one: text(one) + broken if one == name else text(one)
    )
    if name == "compute.wgsl":
        monkeypatch.setattr(sources, "_text_of", lambda one: broken if one == name else text(one))
    scene = rs.Scene.from_arrays(*soup(20, 1))
    with pytest.raises(GraphicsError, match=r"shader brute, FIRST_HIT: (does not|gives no)"):
        rs.Tracer(scene, "brute", "graphics")
    # The device still works, and so does the CPU.
    monkeypatch.setattr(sources, "_text_of", text)
    for device in ("graphics", "cpu"):
        assert not rs.Tracer(scene, "brute", device).any_hit([9, 9, 9], [1, 0, 0])

"""Gather arrays in textures instead of buffers: the same hits and images."""

from __future__ import annotations

import numpy as np
import pytest

import raystream as rs
from conftest import assert_same_bits
from meshes import soup
from raystream.graphics import gather_arrays
from raystream.graphics.errors import GraphicsError
from raystream.graphics.gather_arrays import in_textures

STRUCTURES = {
    "grid": {"structure": "grid"},
    "grid, two levels": {"structure": "grid", "levels": 2},
    "brute": {"structure": "brute"},
    "kd-restart": {"structure": "kdtree", "traversal": "restart"},
    "kd-backtrack": {"structure": "kdtree", "traversal": "backtrack"},
    "kd-backtrack, foley": {"structure": "kdtree", "traversal": "backtrack", "layout": "foley"},
}


def tracer_of(scene, **options):
    return rs.Tracer(scene, device="graphics", machine="multipass", **options)


@pytest.mark.parametrize("name", STRUCTURES)
def test_hits_have_the_same_bits(opened, name, rng):
    scene = rs.Scene.from_arrays(*soup(5000, 1))  # more than a row of texels
    origins = rng.normal(size=(200, 3)) * 2
    directions = rng.random((200, 3)) - origins
    buffers, textures = (
        tracer_of(scene, memory=memory, **STRUCTURES[name]) for memory in ("buffers", "textures")
    )
    expected, found = (one.first_hit(origins, directions) for one in (buffers, textures))
    assert (expected.prim_id >= 0).any()
    for column in ("t", "u", "v", "prim_id"):
        assert_same_bits(getattr(found, column), getattr(expected, column))


@pytest.mark.parametrize(
    "mode", ["raycast", "whitted", pytest.param("path", marks=pytest.mark.exhaustive)]
)
def test_images_have_the_same_bits(opened, mode):
    scene = rs.load("spheres")
    size = (24, 16)
    ours, theirs = (
        rs.render(tracer_of(scene, structure="grid", memory=memory), mode, size)
        for memory in ("textures", "buffers")
    )
    assert_same_bits(ours.pixels, theirs.pixels)
    assert ours.figures["passes"] == theirs.figures["passes"]
    assert ours.pixels.any()


def test_no_gather_array_is_a_buffer(opened, monkeypatch):
    sources = []
    made = type(opened.device).create_shader_module

    def note(self, *, code, **options):
        sources.append(code)
        return made(self, code=code, **options)

    monkeypatch.setattr(type(opened.device), "create_shader_module", note)
    monkeypatch.setattr("raystream.graphics.pipelines._MADE", {})
    scene = rs.load("three_boxes")
    rs.render(tracer_of(scene, structure="grid", memory="textures"), "shadow", (8, 8))
    kernels = [one for one in sources if "fn shade(" in one or "fn traverse(" in one]
    assert kernels
    for one in kernels:
        assert "var<storage, read>" not in one
        assert "texture_2d<f32>" in one


def test_reads_within_reads_are_rewritten():
    source = (
        "@group(1) @binding(0) var<storage, read> first: array<u32>;\n"
        "@group(1) @binding(1) var<storage, read> second: array<vec4u>;\n"
        "let x = second[first[i + 1u] * 2u][lane] + other[first[0]];"
    )
    found = in_textures(source)
    assert "second_at(u32(first_at(u32(i + 1u)) * 2u))[lane] + other[first_at(u32(0))]" in found
    assert "var first_texels: texture_2d<u32>" in found
    assert in_textures("let x = y[0];") == "let x = y[0];"


def test_an_array_larger_than_a_texture_is_an_error(opened, monkeypatch):
    monkeypatch.setattr(gather_arrays, "_WIDTH", 16)
    scene = rs.Scene.from_arrays(*soup(40_000, 1))
    with pytest.raises(GraphicsError, match=r"texels, more than .*use memory='buffers'"):
        tracer_of(scene, structure="brute", memory="textures")


def test_unknown_memory(opened):
    from raystream.graphics.multipass import MultipassBackend

    scene = rs.load("three_boxes")
    with pytest.raises(ValueError, match="memory: expected"):
        tracer_of(scene, structure="grid", memory="paper")
    structure = rs.Tracer(scene, "grid").structure
    with pytest.raises(ValueError, match="memory: expected one of 'buffers', 'textures', got 'x'"):
        MultipassBackend(structure, opened, memory="x")
    with pytest.raises(TypeError, match="'memory'"):
        rs.Tracer(scene, "grid", "graphics", memory="textures")
    assert np.isfinite(tracer_of(scene, structure="grid").first_hit([0, 0, 0], [0, 0, -1]).u)

"""Renderers as compute shaders: the images of the CPU, without a query."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import raystream as rs
from dark_views import DARK_VIEWS
from graphics.test_fragment_renderer import assert_alike
from raystream.graphics import compute
from raystream.graphics.errors import GraphicsError
from raystream.graphics.rendering import ComputeBands, path_rows
from raystream.structures import names_with

pytestmark = pytest.mark.usefixtures("opened")

MODES = {
    "raycast": {},
    "vis": {},
    "shadow": {},
    "whitted": {"max_bounces": 5},
    "ao": {"rays": 5},
    "path": {"max_bounces": 4},
    "kajiya": {},
}

IN_CI = {("three_boxes", "shadow"), ("cornell", "ao"), ("cornell", "path")}

CASES = [
    pytest.param(
        name,
        mode,
        marks=[pytest.mark.exhaustive] * ((name, mode) not in IN_CI),
        id=f"{name}-{mode}",
    )
    for name in ("three_boxes", "cubes", "spheres", "cornell", "robots")
    for mode in MODES
]


def pictures(scene, mode, size=(40, 32), structure="bvh", tracing=None, **options):
    """The image of compute shaders, and the CPU's."""
    own = {**MODES[mode], **options}
    tracers = (
        rs.Tracer(scene, structure, "graphics", **(tracing or {})),
        rs.Tracer(scene, structure),
    )
    return tuple(rs.render(tracer, mode, size, **own) for tracer in tracers)


@pytest.fixture(autouse=True)
def no_queries(monkeypatch):
    """Images must not come from queries."""

    def refuse(*_):
        raise AssertionError("an image asked a query")

    monkeypatch.setattr(compute.ComputeBackend, "_run", refuse)


@pytest.mark.parametrize(("name", "mode"), CASES)
def test_images_are_the_cpu_s(name, mode):
    size = (40, 32) if (name, mode) in IN_CI else (96, 96)
    assert_alike(*pictures(rs.load(name), mode, size))


@pytest.mark.parametrize("structure", names_with("graphics"))
def test_each_structure(structure):
    scene = rs.load("three_boxes")
    assert_alike(*pictures(scene, "whitted", (16, 12), structure, lights="file"))


@pytest.mark.filterwarnings("ignore:the scene's own lights")
@pytest.mark.parametrize(
    ("name", "mode"),
    [
        pytest.param(name, mode, marks=[pytest.mark.exhaustive] * (mode in ("whitted", "kajiya")))
        for name in DARK_VIEWS
        for mode in ("shadow", "whitted", "kajiya", "path")
    ],
)
def test_dark_views_get_the_cpu_s_lights_by_default(name, mode):
    """Decided by the CPU, so without queries of the device too."""
    ours, theirs = pictures(DARK_VIEWS[name](), mode, (24, 18), samples=2)
    assert np.median(theirs.pixels) > 0.01
    assert_alike(ours, theirs, 0.005)


def test_glass_takes_more_room(monkeypatch):
    grown = []
    plain = path_rows.PathRows.grow
    monkeypatch.setattr(
        path_rows.PathRows, "grow", lambda self, encoder: grown.append(plain(self, encoder))
    )
    assert_alike(*pictures(rs.load("spheres"), "whitted", (48, 36), min_weight=0.0))
    assert grown
    monkeypatch.setattr(path_rows, "_MOST_ROOM", 2)
    with pytest.raises(GraphicsError, match="more than 2 paths at once behind glass; use"):
        pictures(rs.load("spheres"), "whitted", (48, 36), min_weight=0.0)


@pytest.mark.parametrize("sampler", ["sobol", "random"])
def test_samples_are_the_cpu_s(sampler):
    """The numbers of pixels, lenses and paths have the same bits."""
    scene = rs.load("cornell")
    lens = replace(scene.camera_for(1.0), aperture=0.05, focus=3.0)
    options = {"samples": 4, "seed": 7, "sampler": sampler, "camera": lens}
    assert_alike(*pictures(scene, "path", (24, 24), **options), 0.01)


def test_few_pixels_at_once():
    """Bands in several dispatches are the same image."""
    scene = rs.load("cornell")
    whole, parts = (
        rs.render(rs.Tracer(scene, device="graphics", rays_at_once=count), "shadow", (40, 32))
        for count in (1 << 18, 100)
    )
    np.testing.assert_array_equal(whole.pixels, parts.pixels)


def test_a_device_with_few_buffers_has_surfaces_in_textures(opened, monkeypatch):
    memories = []
    plain = ComputeBands._memory

    def note(self, mode):
        memories.append(plain(self, mode))
        return memories[-1]

    monkeypatch.setattr(ComputeBands, "_memory", note)
    for most in (8, 64):
        monkeypatch.setitem(opened.limits, "max-storage-buffers-per-shader-stage", most)
        assert_alike(*pictures(rs.load("spheres"), "whitted", (24, 18)))
    assert memories == ["textures", "buffers"]


def test_an_endless_search_is_an_error(monkeypatch):
    scene = rs.load("cornell")
    tracer = rs.Tracer(scene, device="graphics")
    shaders = replace(tracer._backend._shaders, budget=3)
    monkeypatch.setattr(tracer._backend, "_shaders", shaders)
    with pytest.raises(GraphicsError, match=r"of 768 rays in 'bvh' took more than 3 steps"):
        rs.render(tracer, "raycast", (32, 24))


def test_what_shaders_do_not_support_is_rendered_by_queries(monkeypatch):
    asked = []
    monkeypatch.undo()
    plain = compute.ComputeBackend._run

    def note(self, chunk):
        asked.append(chunk.kind)
        return plain(self, chunk)

    monkeypatch.setattr(compute.ComputeBackend, "_run", note)
    rough = rs.Material(roughness=0.4, metallic=1.0)
    scene = rs.load("cornell")
    scene = scene.replace(materials=[rough, *scene.materials[1:]])
    rs.render(rs.Tracer(scene, device="graphics"), "path", (8, 8))
    assert asked

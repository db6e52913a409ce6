"""Heat maps: the ramp, the scale, and what is counted."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from PIL import Image as PillowImage
from PIL import ImageFont

import raystream as rs
from counting import CountingTracer
from raystream.render import heatmap as module
from raystream.render import scale_bar
from raystream.render.color import decode_srgb
from raystream.render.false_colors import _ANCHORS, color_ramp, draw_counts

LUMINANCE = np.array([0.2126, 0.7152, 0.0722])
TITLE = "cells visited per ray, mean 12.3, most 87"


def lightness(linear):
    """CIE L* of linear RGB."""
    luminance = linear @ LUMINANCE
    return np.where(luminance > 0.008856, 116 * np.cbrt(luminance) - 16, 903.3 * luminance)


# The ramp.


def test_ramp_grows_lighter_evenly():
    ramp = color_ramp(256).astype(float)
    assert (np.diff(ramp @ LUMINANCE) > 0).all()
    steps = np.diff(lightness(ramp))
    np.testing.assert_allclose(steps, steps.mean(), rtol=1e-3)
    assert lightness(ramp[0]) == 0
    assert lightness(ramp[-1]) > 95


def test_ramp_is_as_designed_in_a_png(tmp_path):
    """Bytes of the file: black for 0, the last anchor for the top, lighter step by step."""
    counts = np.arange(256)[None, :].repeat(2, axis=0)
    rs.Image(draw_counts(counts)).save(tmp_path / "x.png")
    with PillowImage.open(tmp_path / "x.png") as read:
        row = np.asarray(read)[0]
    assert row[0].tolist() == [0, 0, 0]
    assert row[-1].tolist() == list(_ANCHORS[-1])
    assert (np.diff(decode_srgb(row) @ LUMINANCE) > 0).all()


def test_anchors_are_met_at_their_lightness():
    anchors = decode_srgb(np.array(_ANCHORS, np.uint8))
    places = lightness(anchors.astype(float))
    counts = places[None, :]
    drawn = rs.Image(draw_counts(counts)).to_bytes()[0].astype(int)
    assert np.abs(drawn - _ANCHORS).max() <= 1


def to_anomalous(linear, kind):
    """What dichromats see, in linear RGB (Viénot, Brettel and Mollon 1999)."""
    matrix = {
        "protan": [[0.11238, 0.88762, 0], [0.11238, 0.88762, 0], [0.00401, -0.00401, 1]],
        "deutan": [[0.29275, 0.70725, 0], [0.29275, 0.70725, 0], [-0.02234, 0.02234, 1]],
    }[kind]
    return np.clip(linear @ np.array(matrix).T, 0, 1)


@pytest.mark.parametrize("kind", ["protan", "deutan"])
def test_ramp_keeps_its_order_for_the_colour_blind(kind):
    assert (np.diff(lightness(to_anomalous(color_ramp(64).astype(float), kind))) > 0).all()


# The counts.


def test_equal_counts_have_equal_colours():
    counts = np.array([[0, 5, 10], [10, 5, 0]])
    pixels = draw_counts(counts)
    ramp = color_ramp(1024)
    np.testing.assert_array_equal(pixels[0], ramp[[0, 512, 1023]])
    np.testing.assert_array_equal(pixels[1], ramp[[1023, 512, 0]])


def test_maximum_fixes_the_scale():
    counts = np.array([[0.0, 5, 10, 40]])
    low, high = draw_counts(counts, maximum=10)[0], draw_counts(counts, maximum=80)[0]
    np.testing.assert_array_equal(low[2], low[3])  # above the top: drawn as the top
    np.testing.assert_array_equal(high[3], low[1])  # both are half of it
    assert lightness(high[1].astype(float)) < lightness(low[1].astype(float))


def test_nothing_counted_is_black():
    pixels = draw_counts(np.zeros((4, 300)), TITLE)
    assert not pixels[:4].any()
    assert pixels[4:].any()


@pytest.mark.parametrize(
    ("counts", "options", "words"),
    [
        (np.zeros(3), {}, r"shape \(H, W\), got \(3,\)"),
        (np.zeros((0, 3)), {}, "shape"),
        ([[1, -1]], {}, "not negative"),
        ([[1, np.nan]], {}, "finite"),
        ([[np.nan, 1]], {}, "finite"),
        ([[1, np.inf]], {}, "finite"),
        ([[1]], {"maximum": 0}, "maximum"),
        ([[1]], {"maximum": np.nan}, "maximum"),
    ],
)
def test_bad_counts_are_refused(counts, options, words):
    with pytest.raises(ValueError, match=words):
        draw_counts(counts, **options)


# The scale.


@pytest.mark.parametrize(
    ("top", "step_count", "expected"),
    [
        (87, 10, [0, 10, 20, 30, 40, 50, 60, 70, 80]),
        (87, 5, [0, 20, 40, 60, 80]),
        (100, 10, [0, 10, 20, 30, 40, 50, 60, 70, 80, 90, 100]),
        (101, 2, [0, 50, 100]),
        (1, 5, [0, 0.2, 0.4, 0.6, 0.8, 1]),
        (0.3, 3, [0, 0.1, 0.2, 0.3]),
        (7, 1, [0, 5]),
        (1234567, 3, [0, 500000, 1000000]),
        (1e-30, 1, [0, 1e-30]),
    ],
)
def test_ticks_are_round(top, step_count, expected):
    assert scale_bar.round_ticks(top, step_count) == expected


@pytest.mark.parametrize("top", [1e-12, 0.7, 1, 3, 87, 999, 1_000_000, 123_456_789, 1e300])
@pytest.mark.parametrize("is_cut", [False, True])
@pytest.mark.parametrize("width", [1, 2, 8, 20, 64, 100, 333, 1024, 4000])
def test_labels_are_in_the_picture_and_apart(width, top, is_cut):
    font = ImageFont.load_default(13)
    margin = min(6, width // 16)
    bar = margin, max(width - margin, margin + 1)
    ticks = scale_bar._place_ticks(top, is_cut, bar, width, font)
    ends = [0.0]
    for tick in ticks:
        assert bar[0] <= tick.at < bar[1]
        assert ends[-1] <= tick.begin <= tick.at + 1
        assert tick.at <= tick.end <= width
        ends.append(tick.end)
    if width >= 333 and top < 1e9:
        assert len(ticks) >= 3
    if is_cut and ticks:
        assert ticks[-1].label.endswith("+")
        assert ticks[-1].at == bar[1] - 1


@pytest.mark.parametrize("width", [64, 333, 1024])
def test_scale_shows_the_ramp_from_0_to_the_top(width):
    counts = np.zeros((5, width))
    counts[0, 0] = 87
    pixels = draw_counts(counts, TITLE)
    ramp = color_ramp()
    scale = pixels[5:]
    is_top = (scale == ramp[-1]).all(axis=2)
    column = int(np.flatnonzero(is_top.any(axis=0))[-1])
    row = int(np.flatnonzero(is_top[:, column])[0])
    light = lightness(scale[row, width - 1 - column : column + 1].astype(float))
    assert light[0] == 0
    assert (np.diff(light) > 0).all()


def test_scale_has_room_for_its_text():
    """Nothing is written on the outermost pixels; wider pictures have larger text."""
    heights = []
    for width in (64, 200, 640, 1024, 4000):
        scale = draw_counts(np.full((2, width), 87), TITLE)[2:]
        rim = np.concatenate([scale[0], scale[-1], scale[:, 0], scale[:, -1]])
        assert rim.max() < 0.02
        heights.append(len(scale))
    assert heights[-1] > heights[-2]


def test_narrow_pictures_wrap_the_title_or_leave_it_out():
    font = ImageFont.load_default(13)
    assert scale_bar._wrap(TITLE, 1000, font) == [TITLE]
    narrow = scale_bar._wrap(TITLE, 60, font)
    assert " ".join(narrow) == TITLE
    assert all(font.getlength(line) <= 60 for line in narrow)
    assert scale_bar._wrap(TITLE, 20, font) == []
    for width in (1, 3, 10, 20):
        assert draw_counts(np.ones((1, width)), TITLE).shape[1] == width


def test_scale_says_what_it_cuts_off(monkeypatch):
    written = []
    monkeypatch.setattr(scale_bar, "_wrap", lambda text, *_: written.append(text) or [text[:10]])
    counts = np.array([[0.0] * 300 + [60.0]])
    draw_counts(counts, TITLE, 50)
    draw_counts(counts, TITLE, 60)
    draw_counts(counts, "", 50)
    assert written == [f"{TITLE}, drawn up to 50", TITLE, "drawn up to 50"]


# Tracing.


@pytest.fixture
def triangle():
    """Seen from above, the lower left half of the picture; prim_id 4, after four of no size."""
    faces = [[0, 0, 1]] * 4 + [[0, 1, 2]]
    camera = rs.Camera((0, 0, 1), (0, 0, 0), (0, 1, 0), 90)
    vertices = [[-1, -1, 0], [1, -1, 0], [-1, 1, 0]]
    return rs.Scene([rs.Mesh(vertices, faces)], camera=camera)


@pytest.fixture
def half():
    """Pixels whose centres the triangle covers, in a picture of 20 x 20."""
    row, column = np.mgrid[:20, :20]
    return column <= row


@pytest.mark.parametrize(
    ("what", "hit", "miss"), [("steps", 7, 1), ("cells", 3, 0), ("tests", 4, 0)]
)
def test_counts_are_those_of_each_pixels_ray(triangle, half, what, hit, miss):
    tracer = CountingTracer(triangle, counters=True)
    heat = rs.heatmap(tracer, what, (20, 20))
    assert heat.counts.dtype == np.float32
    np.testing.assert_array_equal(heat.counts, np.where(half, hit, miss))
    assert heat.image.size[0] == 20
    assert heat.image.size[1] > 20
    np.testing.assert_array_equal(heat.image.pixels[:20], draw_counts(heat.counts)[:20])


def test_figures_of_every_count(triangle, half):
    heat = rs.heatmap(CountingTracer(triangle, counters=True), "cells", (20, 20))
    hits = int(half.sum())
    assert heat.costs == {
        "cells": rs.RayCost(3 * hits / 400, 3, 3 * hits),
        "tests": rs.RayCost(4 * hits / 400, 4, 4 * hits),
        "steps": rs.RayCost((400 + 6 * hits) / 400, 7, 400 + 6 * hits),
    }
    assert heat.title == "cells visited per ray, mean 1.57, most 3"
    assert repr(heat) == f"Heatmap(20x20, {heat.title})"


def test_samples_are_averaged(triangle, half):
    tracer = CountingTracer(triangle, counters=True)
    heat = rs.heatmap(tracer, "cells", (20, 20), 8)
    inside = np.tril(half, -1)
    assert (heat.counts[inside] == 3).all()
    assert not heat.counts[~half].any()
    edge = heat.counts[half & ~inside]
    assert ((edge > 0) & (edge < 3)).all()
    assert heat.costs["cells"].total == heat.counts.sum() * 8
    vis = rs.render(tracer, "vis", (20, 20), 8).pixels[..., 0]
    np.testing.assert_array_equal(heat.counts > 0, vis > 0)  # the same rays


def test_bands_do_not_show(triangle, monkeypatch):
    tracer = CountingTracer(triangle, counters=True)
    whole = rs.heatmap(tracer, "steps", (20, 20), 3)
    monkeypatch.setattr(module, "_RAYS_PER_BAND", 45)
    seen = []
    bands = rs.heatmap(tracer, "steps", (20, 20), 3, progress=lambda *a: seen.append(a))
    np.testing.assert_array_equal(bands.counts, whole.counts)
    assert bands.costs == whole.costs
    assert seen == sorted(seen)
    assert seen[-1] == (1200, 1200)


def test_scene_is_traced_by_a_tracer_that_counts(triangle, monkeypatch):
    made = []

    class Noted(CountingTracer):
        def __init__(self, *arguments, **options):
            made.append((arguments[1:], options))
            super().__init__(*arguments, **options)

    monkeypatch.setattr("raystream.render.arguments.Tracer", Noted)
    rs.heatmap(triangle, "steps", (4, 3), structure="kdtree", machine="multipass")
    assert made == [(("kdtree", "cpu"), {"counters": True, "machine": "multipass"})]


def test_files_and_other_scales(triangle, tmp_path):
    heat = rs.heatmap(CountingTracer(triangle, counters=True), "steps", (20, 20), maximum=14)
    heat.save(tmp_path / "x.png")
    with PillowImage.open(tmp_path / "x.png") as read:
        np.testing.assert_array_equal(np.asarray(read), heat.image.to_bytes())
    again = dataclasses.replace(heat, maximum=None)
    assert again.counts is heat.counts
    assert again.image.pixels[19, 0].min() > heat.image.pixels[19, 0].min()
    assert heat._repr_png_().startswith(b"\x89PNG")


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"what": "warmth"}, "what: expected one of 'cells', 'tests', 'steps', got 'warmth'"),
        ({"size": (0, 5)}, "size"),
        ({"size": (5,)}, "size"),
        ({"samples": 0}, "samples"),
        ({"maximum": 0}, "maximum"),
        ({"maximum": np.inf}, "maximum"),
        ({"structure": "grid"}, "has its own"),
        ({"counters": True}, "has its own"),
    ],
)
def test_bad_arguments_are_refused(triangle, options, words):
    with pytest.raises(ValueError, match=words):
        rs.heatmap(CountingTracer(triangle, counters=True), **options)


def test_what_cannot_be_traced_is_refused(triangle):
    with pytest.raises(ValueError, match="counters=True"):
        rs.heatmap(CountingTracer(triangle), size=(4, 3))
    with pytest.raises(TypeError, match="scene: expected a Scene"):
        rs.heatmap("cornell")
    with pytest.raises(TypeError, match="camera"):
        rs.heatmap(CountingTracer(triangle, counters=True), camera=5)

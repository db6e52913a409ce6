"""Heat maps: the ramp, the scale, and the counted quantities."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from PIL import Image as PillowImage
from PIL import ImageFont

import raystream as rs
from raystream.rendering import heatmap as module
from raystream.rendering import scale_bar
from raystream.rendering.color import decode_srgb
from raystream.rendering.false_colors import _ANCHORS, color_ramp, draw_counts
from raystream.rendering.heatmap import RayCost
from raystream.rendering.integrator import camera_paths
from raystream.rendering.sampling.sampler import Sampler

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
    """Colours as dichromats see them, in linear RGB (Viénot, Brettel and Mollon 1999)."""
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
    """Nothing is written on the outermost pixels; wider images have larger text."""
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

STRUCTURES = ("bvh", "kdtree", "grid", "brute")
SIZE = (20, 15)


@pytest.fixture
def triangle():
    """Seen from above, the lower left half of the image."""
    camera = rs.Camera((0, 0, 1), (0, 0, 0), (0, 1, 0), 90)
    mesh = rs.Mesh([[-1, -1, 0], [1, -1, 0], [-1, 1, 0]], [[0, 1, 2]])
    return rs.Scene([mesh], camera=camera)


@pytest.fixture(scope="module")
def robots():
    return rs.load("robots", triangles=3000)


def counted(counters):
    """The quantities that a heat map can show."""
    return {"cells": counters.cells, "tests": counters.tests, "steps": counters.all_steps}


@pytest.mark.parametrize("what", ["cells", "tests", "steps"])
@pytest.mark.parametrize("structure", STRUCTURES)
def test_counts_are_those_of_each_pixels_ray(robots, structure, what):
    tracer = rs.Tracer(robots, structure, counters=True)
    heat = rs.heatmap(tracer, what, SIZE)
    tracer.first_hit(*robots.camera_for(SIZE[0] / SIZE[1]).rays(*SIZE))
    counts = counted(tracer.counters)
    assert heat.counts.dtype == np.float32
    np.testing.assert_array_equal(heat.counts, counts[what])
    assert heat.costs == {
        name: RayCost(many.mean(), many.max(), many.sum()) for name, many in counts.items()
    }
    assert heat.image.size[0] == SIZE[0]
    assert heat.image.size[1] > SIZE[1]
    np.testing.assert_array_equal(heat.image.pixels[: SIZE[1]], draw_counts(heat.counts)[:15])


def test_brute_tests_every_triangle(triangle):
    heat = rs.heatmap(triangle, "tests", SIZE, structure="brute")
    assert (heat.counts == 1).all()
    assert heat.title == "triangles tested per ray, mean 1, most 1"
    assert repr(heat) == f"Heatmap(20x15, {heat.title})"


def test_steps_are_those_down_and_those_back_up(robots):
    heat = rs.heatmap(robots, "steps", SIZE, structure="kdtree", traversal="backtrack")
    tracer = rs.Tracer(robots, "kdtree", traversal="backtrack", counters=True)
    tracer.first_hit(*robots.camera_for(SIZE[0] / SIZE[1]).rays(*SIZE))
    assert tracer.counters.backtrack_steps.any()
    steps = tracer.counters.steps + tracer.counters.backtrack_steps
    np.testing.assert_array_equal(heat.counts, steps)


@pytest.mark.parametrize(
    ("structure", "title"),
    [
        ("grid", "cells visited"),
        ("kdtree", "leaves visited"),
        ("bvh", "leaves visited"),
        ("brute", "leaves visited"),
    ],
)
def test_title_names_the_cells_of_a_tree_leaves(triangle, structure, title):
    heat = rs.heatmap(triangle, "cells", SIZE, structure=structure)
    assert heat.structure == structure
    assert heat.title.startswith(f"{title} per ray, mean ")


@pytest.mark.parametrize("structure", STRUCTURES)
def test_machines_draw_the_same(robots, structure):
    options = {"what": "tests", "size": SIZE, "samples": 2, "structure": structure}
    branching = rs.heatmap(robots, **options)
    stepping = rs.heatmap(robots, **options, machine="multipass", scheduler="most-work")
    np.testing.assert_array_equal(stepping.counts, branching.counts)
    assert stepping.costs == branching.costs
    np.testing.assert_array_equal(stepping.image.pixels, branching.image.pixels)
    assert branching.passes is None
    assert stepping.passes.count >= stepping.passes.optimal_count > 0


def test_passes_of_all_bands_are_added_up(robots, monkeypatch):
    tracer = rs.Tracer(robots, "grid", machine="multipass", counters=True)
    origins, directions = robots.camera_for(SIZE[0] / SIZE[1]).rays(*SIZE)
    count = optimal = 0
    for band in (slice(0, 7), slice(7, 14), slice(14, 15)):
        tracer.first_hit(origins[band], directions[band])
        count += len(tracer.counters.passes)
        optimal += tracer.counters.passes.optimal_count
    monkeypatch.setattr(module, "_RAYS_PER_BAND", 7 * SIZE[0])
    assert rs.heatmap(tracer, "steps", SIZE).passes == module.PassCost(count, optimal)


def test_samples_are_averaged(triangle):
    """A grid of one cell: rays that meet the scene's box test the triangle, others nothing."""
    tracer = rs.Tracer(triangle, "grid", resolution=1, counters=True)
    camera = rs.Camera((0, 0, 2), (0, 0, 0), (0, 1, 0), 90)
    heat = rs.heatmap(tracer, "tests", (19, 19), 8, camera=camera)
    assert (heat.counts[5:14, 5:14] == 1).all()  # the box is 9.5 pixels wide
    assert not heat.counts[:4].any()
    assert not heat.counts[:, 15:].any()
    edge = heat.counts[4, 5:14]
    assert ((edge > 0) & (edge < 1)).any()
    assert heat.costs["tests"].total == heat.counts.sum(dtype=np.float64) * 8
    vis = rs.render(tracer, "vis", (19, 19), 8, camera=camera).pixels[..., 0]
    assert (heat.counts[vis > 0] > 0).all()  # the same rays


def test_samples_count_as_their_rays_do(robots):
    tracer = rs.Tracer(robots, "kdtree", counters=True)
    camera, (width, height) = robots.camera_for(SIZE[0] / SIZE[1]), SIZE
    heat = rs.heatmap(tracer, "steps", SIZE, 3, seed=5)
    counts = []
    for sample in range(3):
        stream = camera_paths(
            camera, (width, height), Sampler.of("sobol", 5, 3), range(height), sample
        )
        np.testing.assert_array_equal(stream.pixels, np.arange(width * height))
        tracer.first_hit(stream.origins, stream.directions)
        counts.append(tracer.counters.all_steps.reshape(height, width))
    np.testing.assert_array_equal(heat.counts, np.mean(counts, axis=0).astype(np.float32))
    assert heat.costs["steps"].most == np.max(counts)


def test_bands_do_not_show(robots, monkeypatch):
    tracer = rs.Tracer(robots, "kdtree", counters=True)
    whole = rs.heatmap(tracer, "steps", SIZE, 3)
    monkeypatch.setattr(module, "_RAYS_PER_BAND", 45)
    seen = []
    bands = rs.heatmap(tracer, "steps", SIZE, 3, progress=lambda *a: seen.append(a))
    np.testing.assert_array_equal(bands.counts, whole.counts)
    assert bands.costs == whole.costs
    assert seen == sorted(seen)
    assert seen[-1] == (900, 900)


def test_tracing_a_scene_is_tracing_by_a_tracer_that_counts(robots):
    tracer = rs.Tracer(robots, "kdtree", max_leaf_size=2, counters=True)
    by_tracer = rs.heatmap(tracer, "cells", SIZE)
    by_scene = rs.heatmap(robots, "cells", SIZE, structure="kdtree", max_leaf_size=2)
    np.testing.assert_array_equal(by_tracer.counts, by_scene.counts)


def test_files_and_other_scales(robots, tmp_path):
    tracer = rs.Tracer(robots, "grid", counters=True)
    heat = rs.heatmap(tracer, "steps", SIZE, maximum=1000)
    heat.save(tmp_path / "x.png")
    with PillowImage.open(tmp_path / "x.png") as read:
        np.testing.assert_array_equal(np.asarray(read), heat.image.to_bytes())
    again = dataclasses.replace(heat, maximum=None)
    assert again.counts is heat.counts
    assert again.image.pixels[:15].sum() > heat.image.pixels[:15].sum()
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
        rs.heatmap(rs.Tracer(triangle, counters=True), **options)


def test_what_cannot_be_traced_is_refused(triangle):
    with pytest.raises(TypeError, match="scene: expected a Scene"):
        rs.heatmap("cornell")
    with pytest.raises(TypeError, match="camera"):
        rs.heatmap(rs.Tracer(triangle, counters=True), camera=5)


def test_tracer_that_does_not_count_is_refused_before_it_traces(triangle, monkeypatch):
    monkeypatch.setattr(rs.Tracer, "first_hit", lambda *_, **__: pytest.fail("traced"))
    for scene, options in ((rs.Tracer(triangle), {}), (triangle, {"counters": False})):
        with pytest.raises(ValueError, match="counters=True"):
            rs.heatmap(scene, size=(4, 3), **options)

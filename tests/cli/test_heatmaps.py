"""``raystream render --heatmap``."""

from __future__ import annotations

import re

import numpy as np
import pytest
from PIL import Image

import raystream as rs
from counting import CountingTracer
from raystream.render.false_colors import color_ramp


@pytest.fixture(autouse=True)
def counting(monkeypatch):
    """Tracers count by a simple rule."""
    monkeypatch.setattr("raystream.tracer.Tracer", CountingTracer)


VIEW = "eye=0.5,0.5,2 look_at=0.5,0.5,0 fov=53.13"
PICTURE = ("-o", "heat.png", "--size", "40x40", "--camera", VIEW)


def pixels(path):
    with Image.open(path) as image:
        return np.asarray(image)


def test_picture_shows_what_rays_cost(run, square):
    """Seen from above, the square fills the middle half."""
    result = run("render", square, *PICTURE, "--heatmap", "cells", "--structure", "kdtree")
    assert (result.code, result.err) == (0, "")
    expected = np.zeros((40, 40, 3), int)
    expected[10:30, 10:30] = rs.Image(color_ramp(2)[None]).to_bytes()[0, 1]
    picture = pixels("heat.png")
    np.testing.assert_array_equal(picture[:40], expected)
    assert picture.shape[0] > 50  # the scale


def test_closing_line_says_mean_and_most(run, square):
    out = run("render", square, *PICTURE, "--heatmap", "steps").out
    assert re.fullmatch(
        r"heat\.png: 40x40, 2 triangles; traversal steps per ray, mean 2\.5, most 7; load .*\n", out
    )


def test_figures_as_json(run, square):
    figures = run("render", square, *PICTURE, "--heatmap", "tests", "--json").figures
    assert figures["heatmap"] == "tests"
    assert "mode" not in figures
    assert (figures["width"], figures["height"], figures["rays"]) == (40, 40, 1600)
    assert set(figures["counts"]) == {"cells", "tests", "steps"}
    assert figures["counts"]["cells"] == {"mean": 0.75, "most": 3, "total": 1200}
    assert figures["counts"]["steps"] == {"mean": 2.5, "most": 7, "total": 4000}


def test_maximum_is_the_top_of_the_scale(run, square):
    for top in ("6", "12"):
        arguments = (*PICTURE, "-o", f"{top}.png", "--heatmap", "cells", "--maximum", top)
        assert run("render", square, *arguments).code == 0
    assert pixels("6.png")[20, 20].sum() > pixels("12.png")[20, 20].sum() > 0


def test_a_heat_map_and_a_machine(run, square, monkeypatch):
    asked = []
    init = CountingTracer.__init__

    def note(self, *arguments, **options):
        init(self, *arguments, **options)
        asked.append((self.asked, self.does_count))

    monkeypatch.setattr(CountingTracer, "__init__", note)
    machine = ("--machine", "multipass", "--scheduler", "naive")
    assert run("render", square, *PICTURE, "--heatmap", "cells", *machine).code == 0
    assert asked == [({"machine": "multipass", "scheduler": "naive"}, True)]


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (["--heatmap", "warmth"], "expected cells or tests or steps, got 'warmth'"),
        (["--heatmap", "cells", "--mode", "vis"], "--mode: not with --heatmap"),
        (["--heatmap", "cells", "--mode", "raycast"], "--mode: not with --heatmap"),
        (["--heatmap", "cells", "--exposure", "1"], "--exposure: not with --heatmap"),
        (["--heatmap", "cells", "--option", "counters=false"], "--heatmap needs counters"),
        (["--heatmap", "cells", "--maximum", "0"], "--maximum"),
        (["--heatmap", "cells", "--maximum", "nan"], "--maximum"),
        (["--maximum", "5"], "--maximum: only with --heatmap"),
    ],
)
def test_contradictions_are_refused_in_one_line(run, square, arguments, complaint):
    assert complaint in run("render", square, *arguments).complaint


def test_saved_structure_counts_nothing(run, square):
    rs.Tracer(rs.load(square)).save("saved.npz")
    complaint = run("render", "saved.npz", "--heatmap", "cells").complaint
    assert complaint.startswith("saved.npz: --heatmap needs a scene")

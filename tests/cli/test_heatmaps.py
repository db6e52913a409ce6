"""``raystream render --heatmap``."""

from __future__ import annotations

import dataclasses
import re

import numpy as np
import pytest
from PIL import Image

import raystream as rs
from conftest import tier

VIEW = ("--eye", 0.5, 0.5, 2, "--look-at", 0.5, 0.5, 0, "--fov", 53.13)
PICTURE = ("-o", "heat.png", "--size", "40x40", *VIEW)


def pixels(path):
    with Image.open(path) as image:
        return np.asarray(image)


def expected(square, what, **options):
    """The library's heat map of the same view."""
    camera = rs.Camera((0.5, 0.5, 2), (0.5, 0.5, 0), (0, 1, 0), 53.13)
    return rs.heatmap(rs.load(square), what, (40, 40), camera=camera, **options)


@pytest.mark.parametrize("what", ["cells", "tests", "steps"])
@pytest.mark.parametrize(
    "structure",
    [
        pytest.param(name, marks=tier(is_everyday=name == "bvh"))
        for name in ("bvh", "kdtree", "grid", "brute")
    ],
)
def test_picture_is_the_librarys(run, square, structure, what):
    result = run("render", square, *PICTURE, "--heatmap", what, "--structure", structure)
    assert (result.code, result.err) == (0, "")
    heat = expected(square, what, structure=structure)
    np.testing.assert_array_equal(pixels("heat.png"), heat.image.to_bytes())


def test_closing_line_says_mean_and_most(run, square):
    """Seen from above, the square fills the middle half, and is one block of two triangles."""
    out = run("render", square, *PICTURE, "--heatmap", "tests").out
    line = r"heat\.png: 40x40, 2 triangles; triangles tested per ray, mean 0\.5, most 2; load .*\n"
    assert re.fullmatch(line, out)


def test_figures_as_json(run, square):
    figures = run("render", square, *PICTURE, "--heatmap", "tests", "--json").figures
    assert figures["heatmap"] == "tests"
    assert "mode" not in figures
    assert "passes" not in figures
    assert (figures["width"], figures["height"], figures["rays"]) == (40, 40, 1600)
    costs = expected(square, "tests").costs
    assert figures["counts"] == {name: dataclasses.asdict(cost) for name, cost in costs.items()}
    assert figures["counts"]["tests"] == {"mean": 0.5, "most": 2, "total": 800}


def test_maximum_is_the_top_of_the_scale(run, square):
    for top in ("6", "12"):
        arguments = (*PICTURE, "-o", f"{top}.png", "--heatmap", "cells", "--maximum", top)
        assert run("render", square, *arguments).code == 0
    assert pixels("6.png")[20, 20].sum() > pixels("12.png")[20, 20].sum() > 0


@pytest.mark.ci
def test_machines_draw_the_same_and_count_passes(run, square):
    pictures = []
    for machine in ("branching", "multipass"):
        asked = ("--structure", "grid", "--machine", machine, "--json")
        figures = run("render", square, *PICTURE, "--heatmap", "cells", *asked).figures
        pictures.append(pixels("heat.png"))
    np.testing.assert_array_equal(*pictures)
    passes = expected(square, "cells", structure="grid", machine="multipass").passes
    assert figures["passes"] == {"count": passes.count, "optimal_count": passes.optimal_count}
    assert figures["scheduler"] == "threshold"


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (["--heatmap", "warmth"], "expected cells or tests or steps, got 'warmth'"),
        (["--heatmap", "cells", "--mode", "vis"], "--mode: cannot be combined with --heatmap"),
        (["--heatmap", "cells", "--mode", "raycast"], "--mode: cannot be combined with --heatmap"),
        (
            ["--heatmap", "cells", "--exposure", "1"],
            "--exposure: cannot be combined with --heatmap",
        ),
        (["--heatmap", "cells", "--option", "counters=false"], "--heatmap needs counters"),
        (["--heatmap", "cells", "--maximum", "0"], "--maximum"),
        (["--heatmap", "cells", "--maximum", "nan"], "--maximum"),
        (["--maximum", "5"], "--maximum: only with --heatmap"),
    ],
)
def test_contradictions_are_refused_in_one_line(run, square, arguments, complaint):
    assert complaint in run("render", square, *arguments).complaint


@pytest.mark.ci
@pytest.mark.parametrize("machine", ["branching", "multipass"])
def test_saved_structure_counts_as_a_new_one_does(run, square, machine):
    rs.Tracer(rs.load(square), "kdtree").save("saved.npz")
    asked = ("--heatmap", "steps", "--machine", machine)
    assert run("render", "saved.npz", *PICTURE, *asked).code == 0
    heat = expected(square, "steps", structure="kdtree")
    np.testing.assert_array_equal(pixels("heat.png"), heat.image.to_bytes())

"""Sampled modes of ``raystream render``: their options, and reports about samples."""

from __future__ import annotations

import re

import numpy as np
import pytest
from PIL import Image

import raystream as rs
from raystream.cli import options
from raystream.cli.sampling import MAX_SAMPLES
from raystream.rendering.integrator import MOST_SAMPLES

SIZE = ("--size", "16x12")


def pixels(path) -> np.ndarray:
    with Image.open(path) as image:
        return np.asarray(image.convert("RGB"))


@pytest.mark.parametrize(
    ("arguments", "wanted"),
    [
        (["--mode", "path", "--max-bounces", 1], {"mode": "path", "max_bounces": 1}),
        (["--mode", "kajiya", "--option", "max_bounces=0"], {"mode": "kajiya", "max_bounces": 0}),
        (
            ["--mode", "path", "--option", "light_samples=false"],
            {"mode": "path", "light_samples": False},
        ),
        (
            ["--mode", "ao", "--option", "rays=2", "--option", "distance=90"],
            {"mode": "ao", "rays": 2, "distance": 90.0},
        ),
        (["--mode", "path", "--preset", "arnold"], {"mode": "path", "preset": "arnold"}),
        (["--mode", "whitted", "--option", "shadows=false"], {"mode": "whitted", "shadows": False}),
        (["--mode", "path", "--sampler", "random"], {"mode": "path", "sampler": "random"}),
        (["--mode", "path", "--seed", 3], {"mode": "path", "seed": 3}),
        (["--mode", "vis", "--seed", 3], {"mode": "vis", "seed": 3}),
        (["--mode", "raycast", "--sampler", "random"], {"mode": "raycast", "sampler": "random"}),
    ],
)
def test_options_reach_the_renderer(run, arguments, wanted):
    """The image is the library's with them, and another without."""
    scene = rs.load("cornell")
    result = run("render", "cornell", *SIZE, "--samples", 2, *arguments)
    assert (result.code, result.err) == (0, "")
    image = rs.render(scene, size=(16, 12), samples=2, **wanted)
    np.testing.assert_array_equal(pixels("cornell.png"), image.to_bytes())
    without = rs.render(scene, wanted["mode"], size=(16, 12), samples=2)
    assert (without.pixels != image.pixels).any()


@pytest.mark.parametrize(
    ("mode", "says"), [("path", "expected 'arnold'"), ("ao", "expected none, in mode 'ao'")]
)
def test_unknown_presets_are_refused(run, mode, says):
    complaint = run("render", "cornell", *SIZE, "--mode", mode, "--preset", "renderman").complaint
    assert complaint.startswith("--preset: ")
    assert says in complaint


def test_options_of_the_tracer_go_with_those_of_the_mode(run):
    chosen = ("--option", "rays=2", "--option", "resolution=3", "--structure", "grid")
    figures = run("render", "cornell", *SIZE, "--mode", "ao", *chosen, "--json").figures
    assert figures["structure"] == "grid"
    image = rs.render(rs.load("cornell"), "ao", (16, 12), 4, rays=2)
    np.testing.assert_array_equal(pixels("cornell.png"), image.to_bytes())


def test_seed_moves_the_rays_of_a_heat_map(run):
    for seed in (0, 1):
        named = ("--seed", seed, "-o", f"{seed}.png")
        assert (
            run("render", "cornell", *SIZE, "--heatmap", "steps", "--samples", 2, *named).code == 0
        )
    assert (pixels("0.png") != pixels("1.png")).any()


def test_figures_count_paths_and_tell_the_error(run):
    asked = ("--mode", "path", "--samples", 8)
    figures = run("render", "cornell", *SIZE, *asked, "--json").figures
    image = rs.render(rs.load("cornell"), "path", (16, 12), 8)
    assert (figures["samples"], figures["samples_taken"], figures["samples_before"]) == (8, 8, 0)
    assert figures["rays"] == 16 * 12 * 8
    assert figures["error"] == image.figures["error"]
    line = run("render", "cornell", *SIZE, *asked).out
    assert re.search(r"; 8 samples, error [\d.]+%; .* Mpaths/s\n$", line)


def test_error_of_one_sample_is_not_known(run):
    one = ("render", "cornell", *SIZE, "--samples", 1)
    assert run(*one, "--json").figures["error"] is None
    assert "; 1 sample; " in run(*one).out


def test_noise_ends_a_picture(run):
    figures = run("render", "cornell", *SIZE, "--mode", "ao", "--noise", 0.05, "--json").figures
    assert figures["error"] <= 0.05
    assert 8 <= figures["samples_taken"] < figures["samples"] == MAX_SAMPLES
    assert figures["rays"] == 16 * 12 * figures["samples_taken"]


def test_time_ends_a_picture(run):
    asked = ("--mode", "path", "--time-limit", 0.05, "--json")
    figures = run("render", "cornell", *SIZE, *asked).figures
    assert 1 <= figures["samples_taken"] < MAX_SAMPLES


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (["--mode", "vis", "--max-bounces", "3"], "--max-bounces: only with --mode whitted or"),
        (
            ["--mode", "ao", "--max-bounces", "3"],
            "--max-bounces: only with --mode whitted or",
        ),
        (["--option", "rays=3"], "--option: rays: only with --mode ao"),
        (["--mode", "path", "--option", "rays=3"], "--option: rays: only with --mode ao"),
        (["--heatmap", "cells", "--noise", "1"], "--noise: cannot be combined with --heatmap"),
        (
            ["--heatmap", "cells", "--time-limit", "1"],
            "--time-limit: cannot be combined with --heatmap",
        ),
        (
            ["--heatmap", "cells", "--max-bounces", "1"],
            "--max-bounces: cannot be combined with --heatmap",
        ),
        (
            ["--heatmap", "cells", "--sampler", "random"],
            "--sampler: cannot be combined with --heatmap",
        ),
        (["--heatmap", "cells", "--resume"], "--resume: cannot be combined with --heatmap"),
        (["--mode", "path", "--noise", "0"], "--noise"),
        (["--mode", "path", "--noise", "nan"], "--noise"),
        (["--mode", "path", "--time-limit", "-1"], "--time-limit"),
        (["--mode", "path", "--time-limit", "inf"], "--time-limit"),
        (["--mode", "path", "--sampler", "halton"], "sobol or stratified or random"),
        (["--mode", "path", "--seed", "-1"], "--seed"),
        (["--mode", "path", "--seed", "4294967296"], "--seed"),
        (["--mode", "path", "--samples", "16777217"], "--samples: expected 1 to 16,777,216"),
        (["--mode", "path", "--sampler", "stratified", "--noise", "1"], "needs --samples"),
        (["--mode", "path", "--max-bounces", "-1"], "--max-bounces"),
        (["--mode", "path", "--max-bounces", "1001"], "--max-bounces: expected 0 to 1000"),
        (
            ["--mode", "path", "--max-bounces", "2", "--option", "max_bounces=3"],
            "max_bounces differs",
        ),
        (["--mode", "path", "--option", "max_bounces=1001"], "--option: max_bounces: expected 0"),
        (["--mode", "path", "--option", "max_bounces=2.5"], "max_bounces: expected an integer"),
        (["--mode", "path", "--option", "max_bounces=true"], "max_bounces: expected an integer"),
        (["--mode", "path", "--option", "light_samples=1"], "light_samples: expected true or"),
        (["--mode", "ao", "--option", "distance=far"], "distance: expected a number"),
        (["--mode", "xray", "--option", "nested=3"], "nested: expected a name"),
        (["--mode", "xray", "--option", "nested=x"], "nested: expected 'both' or 'inner'"),
        (["--mode", "ao", "--option", "distance=NaN"], "--option: distance: expected"),
        (["--mode", "ao", "--option", f"distance=1{'0' * 400}"], "distance: is too large"),
        (["--mode", "ao", "--option", "rays=0"], "--option: rays: expected 1"),
        (["--mode", "ao", "--option", "cells=5"], "has no option 'cells'"),
    ],
)
def test_what_a_mode_has_no_use_for_is_refused_in_one_line(run, tmp_path, arguments, complaint):
    assert complaint in run("render", "cornell", *SIZE, *arguments).complaint
    assert not list(tmp_path.iterdir())


def test_names_are_those_of_the_library():
    from raystream.rendering.sampling.sampler import KINDS

    assert options.SAMPLERS == KINDS
    assert MAX_SAMPLES == MOST_SAMPLES

"""``raystream render --layers`` and ``--denoise``."""

from __future__ import annotations

import numpy as np
import pytest
from PIL import Image as Picture

import raystream as rs
from extras import need
from raystream.cli.layers import GUIDES, NAMES, LayerSelection
from raystream.rendering import progressive
from raystream.rendering.image import Image
from raystream.rendering.layers import LAYERS

REPORT_DENOISER = LayerSelection.report_denoiser

ASKED = ("render", "cornell", "--mode", "path", "--size", "16x12", "--samples", 4)
SUMS = {"variance", "samples"}


def library(**options) -> Image:
    return rs.render(rs.load("cornell"), "path", (16, 12), 4, **options)


@pytest.fixture
def exr():
    need("OpenEXR")


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        ([], {*NAMES}),
        (["--layers", "none"], set()),
        (["--layers", "prim_id, depth"], {"depth", "prim_id"}),
    ],
)
def test_exr_has_the_layers_that_are_asked_for(run, exr, given, expected):
    assert run(*ASKED, "-o", "a.exr", *given).code == 0
    found, wanted = Image.load("a.exr"), library(layers="all")
    assert set(found.layers) == expected | SUMS
    np.testing.assert_array_equal(found.pixels, wanted.pixels)
    for name in found.layers:
        np.testing.assert_array_equal(found.layers[name], wanted.layers[name])
        assert found.layers[name].dtype == wanted.layers[name].dtype


def test_resumed_exr_has_the_same_bytes(run, exr, monkeypatch):
    """Three samples lie beside it, with sums of their layers."""
    monkeypatch.setattr(progressive, "SAMPLES_SECONDS", 0.0)  # one at a time

    def stop(done, total):
        if done > 3 * 16 * 12:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        library(layers="all", checkpoint="a.exr.samples.npz", progress=stop)
    assert run(*ASKED, "-o", "a.exr", "--resume").err == "a.exr: resumed from 3 samples\n"
    assert run(*ASKED, "-o", "b.exr").code == 0
    with open("a.exr", "rb") as a, open("b.exr", "rb") as b:
        assert a.read() == b.read()


def test_denoised_png_is_the_librarys(run):
    result = run(*ASKED, "--denoise", "--json")
    steps = [step for step in result.figures["seconds"] if step != "compile"]
    assert steps == ["load", "build", "trace", "denoise", "save"]
    smooth = library(layers=GUIDES).denoise()
    with Picture.open("cornell.png") as picture:
        np.testing.assert_array_equal(np.asarray(picture), smooth.to_bytes())


def test_missing_denoiser_is_named_once(run, monkeypatch):
    monkeypatch.setattr(LayerSelection, "report_denoiser", REPORT_DENOISER)
    for module in ("oidn", "denoise"):
        monkeypatch.setattr(f"raystream.rendering.{module}.has_oidn", lambda: False)
    result = run(*ASKED, "--denoise")
    assert result.err.count("pip install 'raystream[denoise]'") == 1
    assert "denoise" not in run(*ASKED).err


def test_denoised_exr_has_no_layers_beyond_those_asked_for(run, exr):
    assert run(*ASKED, "-o", "a.exr", "--denoise", "--layers", "prim_id").code == 0
    assert set(Image.load("a.exr").layers) == {"prim_id", "samples"}


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (["--layers", "depth"], "--layers: only with an .exr --output"),
        (["--layers", "none"], "--layers: only with an .exr --output"),
        (["-o", "a.exr", "--layers", "depth,color"], "or none, got 'color'"),
        (["-o", "a.exr", "--layers", ""], "or none, got ''"),
        (["-o", "a.exr", "--layers", "depth,none"], "got 'none'"),
        (
            ["-o", "a.exr", "--heatmap", "cells", "--layers", "depth"],
            "--layers: cannot be combined with",
        ),
        (["--heatmap", "cells", "--denoise"], "--denoise: cannot be combined with --heatmap"),
    ],
)
def test_bad_layers_are_refused_in_one_line(run, exr, tmp_path, arguments, complaint):
    assert complaint in run("render", "cornell", "--size", "8x6", *arguments).complaint
    assert not list(tmp_path.iterdir())


def test_names_are_those_of_the_library():
    assert tuple(LAYERS) == NAMES

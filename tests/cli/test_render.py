"""``raystream render``."""

from __future__ import annotations

import io
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import raystream as rs
from extras import need
from raystream.cli.render import DEFAULT_SCENE
from raystream.cli.sampling import QUALITIES

FIGURES = {
    "output",
    "scene",
    "mode",
    "width",
    "height",
    "samples",
    "samples_taken",
    "samples_before",
    "error",
    "exposure",
    "structure",
    "machine",
    "device",
    "triangles",
    "rays",
    "seconds",
    "mrays_per_second",
}


def pixels(path) -> np.ndarray:
    with Image.open(path) as image:
        return np.asarray(image.convert("RGB"))


def test_picture_shows_the_model(run, square):
    """Seen from above, the square fills the middle half: red there, black around."""
    view = ("--eye", 0.5, 0.5, 2, "--look-at", 0.5, 0.5, 0, "--fov", 53.13)
    plain = ("--size", "40x40", "--mode", "raycast", "--samples", 1)
    result = run("render", square, "-o", "seen.png", *plain, *view)
    assert result.code == 0
    assert result.err == ""
    picture = pixels("seen.png").astype(int)
    assert picture.shape == (40, 40, 3)
    inside = np.zeros((40, 40), bool)
    inside[10:30, 10:30] = True
    assert ((picture[..., 0] > picture[..., 1] + 30) == inside).all()
    assert picture[~inside].max() == 0


def test_picture_is_the_librarys(run):
    run("render", "cornell", "-o", "a.png", "--size", "32x24", "--mode", "vis", "--samples", 2)
    image = rs.render(rs.load("cornell"), mode="vis", size=(32, 24), samples=2)
    np.testing.assert_array_equal(pixels("a.png"), image.to_bytes())


def test_one_line_of_figures(run):
    result = run("render", "cornell", "--size", "32x24", "--samples", 1)
    number = r"[\d.e+-]+"
    assert re.fullmatch(
        rf"cornell\.png: 32x24, 36 triangles; 1 sample; load {number} s, build {number} s, "
        rf"trace {number} s, save {number} s; {number} Mpaths/s\n",
        re.sub(rf"compile {number} s, |, compile {number} s", "", result.out),
    )
    assert Path("cornell.png").exists()


def test_figures_as_json(run):
    figures = run("render", "cornell", "--size", "32x24", "--samples", 3, "--json").figures
    assert set(figures) == FIGURES
    assert set(figures["seconds"]) - {"compile"} == {"load", "build", "trace", "save"}
    assert figures["rays"] == 32 * 24 * 3
    assert (figures["width"], figures["height"], figures["samples"]) == (32, 24, 3)
    assert (figures["structure"], figures["mode"]) == ("bvh", "path")
    assert (figures["output"], figures["triangles"]) == ("cornell.png", 36)
    assert figures["mrays_per_second"] == pytest.approx(
        32 * 24 * 3 / figures["seconds"]["trace"] / 1e6, rel=1e-2
    )


def test_without_scene_a_built_in_one(run):
    figures = run("render", "--size", "16x12", "--triangles", 1000, "--json").figures
    assert figures["scene"] == DEFAULT_SCENE
    assert 500 < figures["triangles"] < 1500
    assert pixels(f"{DEFAULT_SCENE}.png").std() > 10


@pytest.mark.ci
@pytest.mark.parametrize(
    ("structure", "options"),
    [
        ("bvh", ["--option", "quality=fast", "--option", "max_leaf_size=8"]),
        ("grid", ["--option", "resolution=[3, 2, 4]"]),
        ("kdtree", ["--traversal", "restart"]),
        ("kdtree", ["--traversal", "backtrack", "--option", "layout=foley"]),
    ],
)
def test_structures_give_one_picture(run, structure, options):
    for name, more in ((structure, options), ("brute", [])):
        result = run(
            *("render", "cornell", "--size", "32x24", "--structure", name, "--json"),
            *("-o", f"{name}.png", "--threads", 1, "--samples", 1),
            *more,
        )
        assert result.figures["structure"] == name
    np.testing.assert_array_equal(pixels(f"{structure}.png"), pixels("brute.png"))


def test_the_exposure_is_told(run, square):
    size = ("--size", "16x12", "--samples", 1)
    assert "exposure" not in run("render", "cornell", "-o", "a.png", *size).out
    assert ", exposure 4;" in run("render", "cornell", "-o", "a.png", *size, "--exposure", 4).out
    assert "exposure" not in run("render", "cornell", "-o", "a.exr", *size).out
    found = run("render", square, "-o", "a.png", *size, "--json").figures["exposure"]
    said = run("render", square, "-o", "a.png", *size).out
    assert f", exposure {found:.3g};" in said


def test_exposure_brightens_a_png(run):
    run("render", "cornell", "-o", "a.png", "--size", "16x12", "--samples", 4)
    run("render", "cornell", "-o", "b.png", "--size", "16x12", "--samples", 4, "--exposure", 4)
    assert pixels("b.png").mean() > pixels("a.png").mean() + 10


def test_tone_curve_is_the_librarys(run):
    options = ("--size", "16x12", "--samples", 4, "--exposure", 4, "--tone", "aces")
    run("render", "cornell", "-o", "a.png", *options)
    image = rs.render(rs.load("cornell"), size=(16, 12), samples=4)
    np.testing.assert_array_equal(pixels("a.png"), image.to_bytes(4.0, "aces"))


def test_exr_keeps_linear_colours(run):
    need("OpenEXR")
    import OpenEXR

    assert run("render", "cornell", "-o", "a.exr", "--size", "16x12", "--samples", 4).code == 0
    with OpenEXR.File("a.exr") as file:
        found = file.channels()["RGB"].pixels
    expected = rs.render(rs.load("cornell"), size=(16, 12), samples=4).pixels
    np.testing.assert_array_equal(found, expected)


def test_hdr_keeps_linear_colours(run):
    bright = ("--exposure", "4", "--tone", "aces", "--samples", 4)
    assert run("render", "cornell", "--size", "16x12", "-o", "a.hdr", *bright).code == 0
    wanted = rs.render(rs.load("cornell"), size=(16, 12), samples=4).pixels
    found = rs.Image.load("a.hdr").pixels
    assert (np.abs(found - wanted) <= wanted.max(axis=2, keepdims=True) / 255).all()
    assert run("compare", "a.hdr", "a.hdr").code == 0


def test_camera_replaces_only_the_parts_given(run):
    """A narrower view of the same point shows the middle of the image, larger."""
    run("render", "cornell", "-o", "wide.png", "--size", "90x90", "--mode", "vis")
    # 39.3 degrees is the scene's; a third of the tangent of its half.
    run(
        *("render", "cornell", "-o", "narrow.png", "--size", "30x30", "--mode", "vis"),
        *("--fov", 13.57697),
    )
    middle = pixels("wide.png")[30:60, 30:60]
    assert np.mean(np.abs(pixels("narrow.png").astype(int) - middle) > 2) < 0.02


def test_camera_takes_projections_and_lenses(run):
    size = ("--size", "24x16", "--mode", "vis")
    parts = ("--eye", 278, 273, -800, "--projection", "orthographic", "--view-height", 550)
    assert run("render", "cornell", *size, "--samples", 1, *parts).code == 0
    camera = rs.Camera(
        (278, 273, -800), (278, 273, 0), fov=39.3, projection="orthographic", height=550
    )
    seen = rs.render(rs.load("cornell"), "vis", (24, 16), 1, camera=camera).pixels.any(axis=2)
    np.testing.assert_array_equal(pixels("cornell.png").any(axis=2), seen)
    assert seen.any()
    assert not seen.all()
    lens = ("--aperture", 90, "--focus", 900)
    assert run("render", "cornell", *size, "--samples", "3", *lens).code == 0
    lensed = pixels("cornell.png")
    assert run("render", "cornell", *size, "--samples", "3").code == 0
    assert (pixels("cornell.png") != lensed).any()


def test_scene_with_nothing_to_hit_is_legal(run, tmp_path):
    (tmp_path / "flat.obj").write_text("v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n")
    assert run("render", "flat.obj", "--size", "8x8", "--mode", "raycast").code == 0
    assert pixels("flat.png").max() == 0


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (["--mode", "radiosity"], "--mode"),
        (["--size", "640"], "--size"),
        (["--size", "0x10"], "--size"),
        (["--size", "-1x10"], "--size"),
        (["--size", "99999x99999"], "--size"),
        (["--samples", "0"], "--samples"),
        (["--exposure", "nan"], "--exposure"),
        (["--exposure", "0"], "--exposure"),
        (["--tone", "filmic"], "--tone"),
        (["--heatmap", "cells", "--tone", "aces"], "--tone"),
        (["--camera", "left door"], "--camera: no camera 'left door'"),
        (["--eye", "1", "2"], "--eye"),
        (["--eye", "1", "2", "inf"], "expected three finite numbers"),
        (["--eye", "1", "2", "x"], "invalid value for '--eye'"),
        (["--fov", "180"], "--fov: expected degrees between 0 and 180"),
        (["--fov", "nan"], "--fov"),
        (["--projection", "fisheye"], "'--projection': expected perspective or"),
        (
            ["--projection", "orthographic", "--view-height", "0"],
            "--view-height: expected a finite",
        ),
        (["--aperture", "-1"], "--aperture: expected"),
        (["--aperture", "1", "--focus", "0"], "--focus: expected"),
        (["--aperture", "1", "--projection", "orthographic"], "only a perspective camera"),
        (["--eye", "1", "2", "3", "--look-at", "1", "2", "3"], "--look-at: must differ from eye"),
        (["--up", "0", "0", "1"], "--up: must not be zero"),
        (["--quality", "best"], "'--quality': expected preview or good or final"),
        (["--quality", "good", "--samples", "3"], "--quality: cannot be combined with --samples"),
        (["--quality", "final", "--noise", "0.1"], "--quality: cannot be combined with --noise"),
        (["-o", "-", "--json"], "--json: cannot be combined with --output -"),
        (["--traversal", "diagonal"], "--traversal"),
        (["--traversal", "stack"], "bvh: has no option 'traversal'"),
        (["--option", "quality"], "KEY=VALUE"),
        (["--option", "quality=best"], "quality"),
        (["--option", "structure=grid"], "--structure"),
        (["--structure", "grid", "--option", "resolution=0"], "resolution"),
        (["--structure", "grid", "--option", "cells=5"], "has no option 'cells'"),
        (["-o", "out.jpg"], "out.jpg"),
        (["-o", "out"], "out"),
        (["-o", "nowhere/out.png"], "nowhere"),
        (["-o", "folder.png"], "folder.png"),
    ],
)
def test_bad_option_is_refused_in_one_line(run, tmp_path, arguments, named):
    (tmp_path / "folder.png").mkdir()
    assert named in run("render", "cornell", *arguments).complaint


def test_output_is_checked_before_the_work(run):
    """The scene is bad as well, and would be found first otherwise."""
    assert run("render", "nosuch.obj", "-o", "out.bmp").complaint.startswith("out.bmp: ")


def test_folder_that_is_not_writable(run, tmp_path, monkeypatch):
    monkeypatch.setattr("os.access", lambda path, mode: False)
    assert "not writable" in run("render", "cornell").complaint


def test_exr_without_openexr_is_refused_before_the_work(run, monkeypatch):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    assert "raystream[exr]" in run("render", "nosuch.obj", "-o", "out.exr").complaint


def test_disk_that_fills_up_leaves_the_old_picture(run, tmp_path, monkeypatch):
    from raystream.rendering.image import Image as Picture

    def fill_up(*_, **__):
        raise OSError(28, "No space left on device")

    (tmp_path / "cornell.png").write_bytes(b"the old one")
    monkeypatch.setattr(Picture, "save", fill_up)
    result = run("render", "cornell", "--size", "8x8", "--force")
    assert result.complaint == "cornell.png: No space left on device"
    assert (tmp_path / "cornell.png").read_bytes() == b"the old one"


def test_a_model_without_a_camera_fits_a_picture_of_any_shape(run, square):
    for size in ("80x240", "240x80"):
        assert run("render", square, "-o", "fit.png", "--size", size, "--mode", "vis").code == 0
        seen = pixels("fit.png").any(axis=2)
        assert seen.any()
        assert not seen[[0, -1]].any()
        assert not seen[:, [0, -1]].any()


@pytest.mark.ci
def test_the_image_goes_to_stdout(run, environment):
    """Its figures go to stderr."""
    wanted = ("render", "cornell", "--size", "16x12", "--samples", "2")
    assert run(*wanted, "-o", "a.png").code == 0
    command = [sys.executable, "-m", "raystream", *wanted, "-o", "-"]
    result = subprocess.run(command, env=environment, capture_output=True, check=True, timeout=120)
    np.testing.assert_array_equal(pixels(io.BytesIO(result.stdout)), pixels("a.png"))
    assert result.stderr.startswith(b"-: 16x12, 36 triangles; 2 samples")


def test_quality_sets_samples_limits_and_denoising(run):
    size = ("--size", "16x12")
    figures = run("render", "cornell", *size, "--json").figures
    assert figures["samples"] == QUALITIES["preview"].samples == 64
    assert 8 <= figures["samples_taken"] <= 64
    assert "denoise" in figures["seconds"]
    noisy = run("render", "cornell", *size, "--no-denoise", "--json").figures
    assert "denoise" not in noisy["seconds"]
    good = run("render", "cornell", *size, "--quality", "good", "--json").figures
    assert good["error"] < 0.01 or good["samples_taken"] == 1024
    assert "denoise" in good["seconds"]
    sharp = run("render", "cornell", *size, "--quality", "good", "--mode", "vis", "--json").figures
    assert (sharp["samples_taken"], "denoise" in sharp["seconds"]) == (16, False)
    exact = run("render", "cornell", *size, "--samples", 3, "--json").figures
    assert (exact["samples_taken"], "denoise" in exact["seconds"]) == (3, False)


def test_exposure_is_automatic_for_scenes_without_lights(run, square):
    """The square is lit by what is added; the Cornell box has a lamp."""
    for scene, is_lit in ((square, False), ("cornell", True)):
        wanted = ("render", scene, "--size", "16x12", "--mode", "raycast", "--samples", 1)
        wanted += ("-o", "out.png")
        assert run(*wanted).code == 0
        usual = pixels("out.png")
        for asked, is_equal in (("auto", not is_lit), (1, is_lit)):
            assert run(*wanted, "--exposure", asked).code == 0
            assert (pixels("out.png") == usual).all() == is_equal
    assert "expected 'auto' or a number above 0" in run(*wanted, "--exposure", "full").err


@pytest.mark.parametrize(
    ("arguments", "note"),
    [
        (["--eye", 0, 0, 5, "--look-at", 0, 0, 9], "the camera sees no surface: --eye and"),
        (
            ["--lights", "file"],
            "the image is black: the scene has no lights; --lights auto adds some",
        ),
        (["--exposure", "1e9"], "the image is white: it is overexposed; --exposure auto"),
        (["--exposure", "1e-9"], "the image is black: there is too little light; --exposure auto"),
        (["--mode", "vis", "--exposure", "1e9"], ""),
        ([], ""),
    ],
)
def test_black_and_white_images_are_reported(run, square, arguments, note):
    view = ["--eye", 0.7, 0.3, 0.2, "--look-at", 0.7, 0.3, 0]
    view += [] if "vis" in arguments else ["--mode", "whitted"]
    if "--eye" in arguments:
        view = []
    result = run("render", square, "--size", "16x12", *view, *arguments)
    assert result.code == 0
    assert result.err.startswith(note)
    assert bool(result.err) == bool(note)


def test_lights_that_do_not_reach_the_view_are_reported(run):
    behind = ["--eye", 278, 273, 1500, "--look-at", 278, 273, 500, "--fov", 10]
    result = run(
        "render", "cornell", "--size", "16x12", "--samples", 4, *behind, "--lights", "file"
    )
    expected = "the image is black: the scene's own lights do not reach what the camera sees"
    assert result.err.startswith(expected)

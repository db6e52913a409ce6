"""``raystream compare``."""

from __future__ import annotations

import dataclasses
import subprocess
import sys

import numpy as np
import pytest

import raystream as rs
from extras import need


@pytest.fixture
def pictures(run):
    """Two images of one size in the current folder, and one of another."""
    rng = np.random.default_rng(4)
    a, b = (rs.Image(rng.random((6, 80, 3))) for _ in range(2))
    a.save("a.png")
    b.save("b.png")
    rs.Image(np.zeros((6, 81, 3))).save("wide.png")
    return rs.Image.load("a.png"), rs.Image.load("b.png")


def test_figures_are_the_librarys(run, pictures):
    figures = run("compare", "a.png", "b.png", "--json").figures
    expected = dataclasses.asdict(pictures[0].compare(pictures[1]))
    expected["max_error_at"] = list(expected["max_error_at"])
    files = {"image": "a.png", "reference": "b.png", "output": None, "width": 80, "height": 6}
    assert figures == expected | files


def test_figures_for_people(run, pictures):
    result = run("compare", "a.png", "b.png")
    assert result.code == 0
    assert result.err == ""
    assert f"{pictures[0].compare(pictures[1]).rmse:.6g}" in result.out
    column, row = pictures[0].compare(pictures[1]).max_error_at
    assert f"in column {column}, row {row}" in result.out


def test_same_pictures(run, pictures):
    figures = run("compare", "a.png", "a.png", "--json").figures
    assert figures["psnr"] is None
    assert figures["rmse"] == figures["bias"] == 0.0
    assert "no difference" in run("compare", "a.png", "a.png").out


def test_difference_is_drawn(run, pictures):
    assert run("compare", "a.png", "b.png", "-o", "d.png", "--maximum", 0.5).code == 0
    expected = pictures[0].draw_difference(pictures[1], 0.5)
    np.testing.assert_array_equal(rs.Image.load("d.png").to_bytes(), expected.to_bytes())


def test_layers_of_an_exr_do_no_harm(run, pictures):
    need("OpenEXR")
    rs.Image(pictures[0].pixels, {"depth": np.zeros((6, 80))}).save("a.exr")
    assert run("compare", "a.exr", "a.png", "--json").figures["rmse"] == 0.0


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (["a.png", "wide.png"], "80x6 and 81x6"),
        (["a.png", "missing.png"], "missing.png: no such file"),
        (["text.png", "a.png"], "text.png: is not a complete .png file"),
        (["a.jpg", "a.png"], "a.jpg: file extension must be"),
        (["a.png", "b.png", "-o", "a.png"], "overwritten"),
        (["a.png", "b.png", "-o", "d.gif"], "d.gif"),
        (["a.png", "b.png", "--maximum", "2"], "--maximum: only with --output"),
        (["a.png", "b.png", "-o", "d.png", "--maximum", "0"], "--maximum"),
    ],
)
def test_bad_input_is_refused_in_one_line(run, pictures, tmp_path, arguments, named):
    (tmp_path / "text.png").write_text("none")
    assert named in run("compare", *arguments).complaint
    assert not (tmp_path / "d.png").exists()


def test_damaged_exr_is_one_line_whatever_openexr_prints(environment, tmp_path):
    """In a separate process: the C library bypasses Python's streams."""
    need("OpenEXR")
    path = tmp_path / "cut.exr"
    rs.Image(np.random.default_rng(1).random((64, 64, 3))).save(path)
    path.write_bytes(path.read_bytes()[:9000])
    result = subprocess.run(
        [sys.executable, "-m", "raystream", "compare", "cut.exr", "cut.exr"],
        env=environment,
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert result.returncode == 2
    assert result.stdout == ""
    assert result.stderr == "raystream: cut.exr: is not a complete .exr file\n"


def test_exr_without_openexr_is_refused(run, monkeypatch):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    assert "reading .exr needs OpenEXR" in run("compare", "a.exr", "b.exr").complaint

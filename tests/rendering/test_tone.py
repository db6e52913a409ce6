"""Tone curves."""

from __future__ import annotations

import numpy as np
import pytest

import raystream as rs
from extras import need
from raystream.rendering.tone import TONES, apply_tone


def grey(values):
    return np.repeat(np.asarray(values, np.float32)[:, None], 3, axis=1)


@pytest.mark.parametrize("tone", TONES)
def test_curves_rise_from_black(tone):
    values = np.concatenate([[0.0], np.geomspace(1e-6, 1e4, 400)])
    shown = apply_tone(grey(values), tone)
    assert shown.dtype == np.float32
    assert (shown[0] == 0.0).all()
    assert (np.diff(shown[:, 0]) >= 0.0).all()
    assert (np.diff(shown[values < 5.0, 0]) > 0.0).all()
    np.testing.assert_array_equal(shown[:, 0], shown[:, 2])
    if tone != "linear":
        assert shown.max() <= 1.0 + 1e-6


@pytest.mark.parametrize("tone", TONES)
def test_numbers_that_are_none_stay_in_range(tone):
    most = np.finfo(np.float32).max
    shown = apply_tone(grey([np.nan, -1.0, -np.inf, 0.5, np.inf, most]), tone)
    assert np.isfinite(shown).all()
    assert (shown[:3] == 0.0).all()
    assert (shown[3] > 0.0).all()
    assert (shown[4] == shown[5]).all()


def test_reinhard_by_hand():
    """White is the largest luminance: L (1 + L / 16) / (1 + L) for an image up to 4."""
    shown = apply_tone(grey([0.0, 1.0, 4.0]), "reinhard")
    np.testing.assert_allclose(shown[:, 0], [0.0, (1 + 1 / 16) / 2, 1.0], rtol=1e-6)


def test_reinhard_keeps_hues_and_pictures_that_fit():
    colors = np.array([[4.0, 2.0, 1.0], [0.4, 0.2, 0.1]], np.float32)
    shown = apply_tone(colors, "reinhard")
    np.testing.assert_allclose(shown[:, :2] / shown[:, 2:], [[4, 2], [4, 2]], rtol=1e-6)
    np.testing.assert_allclose(apply_tone(colors[1:], "reinhard"), colors[1:], rtol=1e-6)


def test_aces_at_points_of_the_fit():
    shown = apply_tone(grey([0.18, 1.0, 100.0]), "aces")[:, 0]
    np.testing.assert_allclose(shown, [0.26689, 0.80380, 1.0], atol=1e-4)


def test_curve_comes_after_the_exposure():
    pixels = np.linspace(0, 3, 30).reshape(2, 5, 3).astype(np.float32)
    image, brighter = rs.Image(pixels), rs.Image(pixels * 2)
    for tone in TONES:
        np.testing.assert_array_equal(image.to_bytes(2.0, tone), brighter.to_bytes(1.0, tone))
    assert (image.to_bytes(1.0, "aces") != image.to_bytes()).any()


def test_file_is_toned_if_it_is_for_screens(tmp_path):
    image = rs.Image(np.full((2, 2, 3), 3.0))
    image.save(tmp_path / "x.png", tone="aces")
    shown = rs.Image.load(tmp_path / "x.png")
    np.testing.assert_array_equal(shown.to_bytes(), image.to_bytes(tone="aces"))
    need("OpenEXR")
    image.save(tmp_path / "x.exr", tone="aces")
    assert (rs.Image.load(tmp_path / "x.exr").pixels == 3.0).all()


def test_unknown_curve_is_refused(tmp_path):
    with pytest.raises(ValueError, match="tone: expected one of 'linear'"):
        rs.Image(np.zeros((2, 2, 3))).save(tmp_path / "x.png", tone="filmic")
    assert not list(tmp_path.iterdir())

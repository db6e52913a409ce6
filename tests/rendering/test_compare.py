"""Errors between images, and drawings of them."""

from __future__ import annotations

import math

import numpy as np
import pytest

import raystream as rs
from raystream.rendering.compare import _COLD, _INVALID, _WARM
from raystream.rendering.false_colors import color_ramp


def flat(value, height=4, width=90):
    return rs.Image(np.full((height, width, 3), value, np.float32))


def test_figures_by_hand():
    image, reference = flat(0.5), flat(0.5)
    image.pixels[2, 7, 1] = 1.5
    reference.pixels[3, 1] = 0.25
    numbers = image.pixels.size
    found = image.compare(reference)
    assert found.rmse == pytest.approx(math.sqrt((1 + 3 * 0.25**2) / numbers))
    relative = (1 / 0.51 + 3 * 0.25 / 0.26) / numbers
    assert found.mean_relative_error == pytest.approx(relative)
    squares = (1 / 0.26 + 3 * 0.25**2 / (0.25**2 + 0.01)) / numbers
    assert found.relative_mse == pytest.approx(squares)
    assert (found.max_error, found.max_error_at) == (1.0, (7, 2))
    assert found.mean == pytest.approx(0.5 + 1 / numbers)
    assert found.reference_mean == pytest.approx(0.5 - 0.75 / numbers)
    assert found.bias == pytest.approx(1.75 / numbers)
    assert found.invalid_count == 0


def test_same_pictures_have_no_error():
    found = flat(0.3).compare(flat(0.3))
    assert (found.rmse, found.relative_mse, found.max_error, found.bias) == (0, 0, 0, 0)
    assert found.psnr == math.inf


def test_psnr_is_of_bytes():
    """Black against white is the peak itself; values above white show no difference."""
    assert flat(0.0).compare(flat(1.0)).psnr == pytest.approx(0.0)
    assert flat(2.0).compare(flat(1.0)).psnr == math.inf


def test_larger_noise_has_larger_errors():
    noise = np.random.default_rng(1).normal(size=(20, 30, 3))
    reference = flat(0.5, 20, 30)
    found = [rs.Image(reference.pixels + s * noise).compare(reference) for s in (0.01, 0.1)]
    assert found[1].rmse == pytest.approx(10 * found[0].rmse, rel=1e-3)
    assert found[1].relative_mse > 50 * found[0].relative_mse
    assert found[1].psnr < found[0].psnr - 15


def test_pixels_that_are_not_finite_are_left_out():
    image, reference = flat(0.5), flat(0.25)
    image.pixels[0, 0, 2], reference.pixels[1, 1, 0] = np.nan, np.inf
    found = image.compare(reference)
    assert found.invalid_count == 2
    assert found.rmse == 0.25
    assert found.max_error_at == (1, 0)
    drawn = image.draw_difference(reference).pixels
    for row, column in ((0, 0), (1, 1)):
        np.testing.assert_allclose(drawn[row, column], _INVALID)
    with pytest.raises(ValueError, match="no pixel is finite"):
        flat(np.nan).compare(reference)


def test_sizes_are_compared():
    for method in (rs.Image.compare, rs.Image.draw_difference):
        with pytest.raises(ValueError, match="equal size, got 90x4 and 91x4"):
            method(flat(1), flat(1, width=91))


def test_drawing_tells_brighter_from_darker():
    reference = flat(0.5)
    image = flat(0.5)
    image.pixels[0] += 0.25
    image.pixels[1] -= 0.25
    image.pixels[2] -= 0.125
    drawn = image.draw_difference(reference)
    assert drawn.size[0] == 90
    assert drawn.size[1] > 4 + 2 * 13
    brighter, darker, half, same = drawn.pixels[:4, 5]
    np.testing.assert_array_equal(brighter, color_ramp(anchors=_WARM)[-1])
    np.testing.assert_array_equal(darker, color_ramp(anchors=_COLD)[-1])
    assert brighter[0] > brighter[2]
    assert darker[2] > darker[0]
    assert 0 < half.sum() < darker.sum()
    assert (same == 0.0).all()


def test_maximum_is_the_top_of_the_scale():
    image, reference = flat(0.75), flat(0.5)
    cut = image.draw_difference(reference, 0.125).pixels[:4]
    half = image.draw_difference(reference, 0.5).pixels[:4]
    np.testing.assert_array_equal(cut, image.draw_difference(reference).pixels[:4])
    assert half.max() < cut.max()
    with pytest.raises(ValueError, match="maximum"):
        image.draw_difference(reference, -1.0)


@pytest.mark.parametrize("anchors", [_WARM, _COLD])
def test_ramps_grow_lighter(anchors):
    ramp = color_ramp(200, anchors)
    assert (ramp[0] == 0.0).all()
    assert (np.diff(ramp @ np.array([0.2126, 0.7152, 0.0722])) > 0).all()

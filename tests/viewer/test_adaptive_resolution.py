"""Adaptive resolution: the size of images follows their cost, and settles."""

from __future__ import annotations

import math

import numpy as np
import pytest

from raystream.viewer.adaptive_resolution import (
    SCALES,
    AdaptiveResolution,
    Cost,
    FrameRate,
    slice_rows,
    update_interval,
)

CANVAS = 1024, 768
TARGET = 0.05


def run(resolution, pixel_seconds, frames, rng=None, overhead=0.004):
    """Render this many frames; returns their scales, and the time of the last one."""
    scales, seconds = [], math.nan
    for _ in range(frames):
        width, height = resolution.size(*CANVAS)
        seconds = overhead + width * height * pixel_seconds
        if rng is not None:
            seconds *= rng.uniform(0.85, 1.15)
        scales.append(resolution.scale)
        resolution.record(*CANVAS, width * height, seconds)
    return scales, seconds


@pytest.mark.parametrize("full_seconds", [0.01, 0.04, 0.09, 0.3, 1.0, 2.0])
def test_frames_take_about_what_they_should(full_seconds):
    resolution = AdaptiveResolution(TARGET)
    pixel_seconds = full_seconds / (CANVAS[0] * CANVAS[1])
    scales, seconds = run(resolution, pixel_seconds, 40)
    assert seconds < 1.2 * TARGET
    # No smaller than needed: two steps up would be too slow.
    if scales[-1] < 1.0:
        larger = SCALES[max(SCALES.index(scales[-1]) - 2, 0)]
        assert full_seconds * larger**2 > 0.85 * TARGET


@pytest.mark.parametrize("full_seconds", np.geomspace(0.02, 2.0, 12))
def test_a_resolution_that_was_found_is_kept(full_seconds):
    """Measurements scatter by 15 percent: images do not change their size back and forth."""
    resolution, rng = AdaptiveResolution(TARGET), np.random.default_rng(3)
    pixel_seconds = full_seconds / (CANVAS[0] * CANVAS[1])
    run(resolution, pixel_seconds, 40, rng)
    scales, _ = run(resolution, pixel_seconds, 200, rng)
    changes = np.count_nonzero(np.diff(scales))
    assert changes <= 4
    steps = [SCALES.index(scale) for scale in scales]
    assert max(steps) - min(steps) <= 1


def test_it_is_lowered_at_once_and_raised_step_by_step():
    resolution = AdaptiveResolution(TARGET)
    run(resolution, 1e-8, 5)
    assert resolution.scale == 1.0
    slow = run(resolution, 1e-6, 3)[0]
    assert slow[1] < 0.3
    scales, _ = run(resolution, 1e-8, 20)
    steps = [SCALES.index(scale) for scale in scales]
    assert scales[-1] == 1.0
    assert np.diff(steps).min() == -1


def test_the_smallest_picture_still_shows_something():
    resolution = AdaptiveResolution(TARGET)
    run(resolution, 1.0, 3)
    assert resolution.scale == SCALES[-1]
    assert resolution.size(64, 20) == (16, 16)
    assert resolution.size(16, 4096) == (16, 512)


def test_what_pixels_cost_is_heeded_before_the_first_frame():
    resolution, cost = AdaptiveResolution(TARGET), Cost()
    resolution.apply_cost(*CANVAS, cost)  # nothing is known
    assert resolution.scale == 1.0
    cost.record(1000, 1e-3)
    resolution.apply_cost(*CANVAS, cost)
    width, height = resolution.size(*CANVAS)
    assert width * height * 1e-6 <= TARGET
    quick = Cost()
    quick.record(1000, 1e-6)
    resolution.apply_cost(*CANVAS, quick)  # frames took longer than that
    assert resolution.size(*CANVAS) == (width, height)


def test_a_cost_is_learned_slowly_but_believed_when_it_is_another():
    cost = Cost()
    assert not cost.is_known
    assert math.isnan(cost.expected(5))
    cost.record(100, 1.0)
    assert cost.expected(200) == pytest.approx(2.0)
    cost.record(100, 1.1)
    assert 1.0 < cost.expected(100) < 1.05
    cost.record(100, 9.0)
    assert cost.expected(100) == pytest.approx(9.0)
    cost.record(100, 0.0)
    assert 0.0 < cost.expected(100) < 1e-3


def test_slices_share_the_rows_evenly():
    assert slice_rows(768, 1e-4, 0.1) == 768
    rows, left = [], 768
    while left:
        rows.append(slice_rows(left, 1e-3, 0.1))
        left -= rows[-1]
    assert 0.08 <= min(rows) * 1e-3 <= max(rows) * 1e-3 <= 0.12
    assert slice_rows(5, 10.0, 0.1) == 1
    assert slice_rows(768, math.nan, 0.1) == 1


def test_pauses_grow():
    assert update_interval(0.0) == 0.1
    assert update_interval(4.0) == pytest.approx(0.6)
    assert update_interval(1e6) == 2.0


def test_the_frame_rate_is_that_of_the_last_second():
    rate = FrameRate()
    assert rate.now(0.0) == 0.0
    for k in range(30):
        rate.record(k / 20)
    assert rate.now(1.5) == pytest.approx(20.0)
    assert rate.now(9.0) == 0.0

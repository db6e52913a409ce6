"""Progressive images: the same bits as `raystream.render`, in slices of bounded time."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
import pytest

import raystream as rs
from raystream.rendering.contexts import make_context
from raystream.rendering.render import RENDERERS
from raystream.rendering.sampling.sampler import Sampler
from raystream.viewer.adaptive_resolution import Cost
from raystream.viewer.heatmap_image import HeatmapImage, ramp
from raystream.viewer.progressive_images import (
    Drawing,
    ProgressiveImage,
    SampledImage,
    WorkCancelledError,
    centered,
    with_samples,
)
from raystream.viewer.settings import DisplaySettings

SIZE = 32, 24
LOOK = DisplaySettings(1.0, "linear", None)


def always() -> bool:
    return True


@pytest.fixture(scope="module")
def scene():
    return rs.load("cornell")


@pytest.fixture(scope="module")
def context(scene):
    tracer = rs.Tracer(scene)
    return make_context(tracer, scene.camera, SIZE, Sampler.of("sobol"), {})


def finish(picture, seconds=1.0):
    slices = 0
    while not picture.is_done:
        picture.advance(seconds, always)
        slices += 1
    return slices


@pytest.mark.parametrize("mode", ["raycast", "path"])
def test_the_last_picture_is_the_one_that_render_makes(scene, context, mode):
    renderer = RENDERERS[mode]
    context = replace(context, options=renderer.check(renderer.options))
    for samples in (1, 3):
        picture = SampledImage(renderer, with_samples(context, samples), Cost())
        finish(picture)
        shown = picture.draw(LOOK)().pixels
        expected = rs.render(scene, mode, SIZE, samples).pixels
        assert shown.tobytes() == expected.tobytes()
    assert picture.noise() == pytest.approx(rs.render(scene, mode, SIZE, 3).figures["error"])


def test_slices_of_a_row_give_the_same_bits(scene, context):
    cost = Cost()
    cost.record(1, 1e9)  # as if each pixel took forever
    picture = SampledImage(RENDERERS["raycast"], with_samples(context, 2), cost)
    assert picture.advance(0.1, always) is False
    assert finish(picture, 1e-9) > 20
    expected = rs.render(scene, "raycast", SIZE, 2).pixels
    assert picture.draw(LOOK)().pixels.tobytes() == expected.tobytes()


def test_one_sample_goes_through_the_centres(scene, context):
    picture = SampledImage(RENDERERS["raycast"], centered(with_samples(context, 9)), Cost())
    finish(picture)
    expected = rs.render(scene, "raycast", SIZE)
    assert picture.draw(LOOK)().pixels.tobytes() == expected.pixels.tobytes()
    assert picture.noise() is None


@pytest.mark.parametrize("what", ["steps", "tests", "cells"])
def test_a_heat_map_is_the_one_that_heatmap_makes(scene, context, what):
    tracer = rs.Tracer(scene, "grid", counters=True)
    cost = Cost()
    cost.record(SIZE[0], 1.0)
    picture = HeatmapImage(centered(replace(context, tracer=tracer)), what, cost)
    assert finish(picture, 5.0) > 1
    expected = rs.heatmap(tracer, what, SIZE)
    whole = picture.draw_whole(LOOK)().pixels
    assert whole.tobytes() == expected.image.pixels.tobytes()
    assert picture.draw(LOOK)().pixels.tobytes() == whole[: SIZE[1]].tobytes()
    facts = picture.facts(LOOK)
    assert facts["legend"]["most"] == expected.costs[what].most
    assert facts["legend"]["maximum"] == expected.counts.max()
    assert facts["counters"]["tests"] == pytest.approx(expected.costs["tests"].mean, abs=1e-4)
    assert picture.facts(LOOK._replace(maximum=50.0))["legend"]["maximum"] == 50.0


def test_the_ramp_goes_from_black_to_nearly_white():
    assert ramp()[0] == "#000000"
    assert int(ramp()[-1][1:3], 16) > 240
    assert len(set(ramp())) == len(ramp())


class _Slow(ProgressiveImage):
    """Takes a given time for each row, and reports progress."""

    def __init__(self, row_seconds, cost):
        super().__init__((10, 40), 1, cost)
        self.row_seconds = row_seconds
        self.traced = []

    def _trace(self, rows, sample, progress):
        del sample
        for done in range(1, len(rows) + 1):
            end = time.perf_counter() + self.row_seconds
            while time.perf_counter() < end:
                pass
            progress(done, len(rows))
        self.traced += rows

    def draw(self, display):
        return lambda: Drawing(np.zeros((self.height, self.width, 3), np.float32), display)


def test_a_slice_that_takes_too_long_is_tried_with_fewer_rows():
    cost = Cost()
    cost.record(1000, 1e-6)  # far too good
    picture = _Slow(0.002, cost)
    assert picture.advance(0.004, always) is False
    assert picture.traced == []
    assert cost.seconds > 1e-5
    slices = finish(picture, 0.004)
    assert picture.traced == list(range(40))
    assert slices > 5
    assert picture.seconds > 0.08


def test_work_that_nobody_wants_ends():
    cost = Cost()
    cost.record(1000, 1e-6)
    asked = []

    def is_wanted():
        asked.append(True)
        return len(asked) < 3

    picture = _Slow(0.0005, cost)
    with pytest.raises(WorkCancelledError):
        picture.advance(1.0, is_wanted)
    assert len(asked) == 3
    assert picture.traced == []

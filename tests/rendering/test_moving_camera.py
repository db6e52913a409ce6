"""Images during which the camera moves: the scene seen from another pose in each row."""

from __future__ import annotations

import numpy as np
import pytest

import raystream as rs
from raystream.rendering.contexts import make_context, seen_by
from raystream.rendering.render import RENDERERS
from raystream.rendering.sample_bands import trace_sample
from raystream.rendering.sampling.sampler import Sampler

ONE = Sampler.of("sobol", 0, 1)


@pytest.fixture(scope="module")
def tracer() -> rs.Tracer:
    return rs.Tracer(rs.load("cornell"))


@pytest.mark.parametrize("mode", ["raycast", "whitted"])
def test_setting_seen_by_another_camera_gives_its_picture(tracer, mode):
    renderer = RENDERERS[mode]
    options = renderer.check(renderer.options)
    near = tracer.scene.camera
    far = rs.Camera((100.0, 400.0, -900.0), near.look_at, near.up, 50.0)
    moved = seen_by(make_context(tracer, near, (24, 16), ONE, options), far, (32, 20))
    light, _ = trace_sample(renderer, moved, 0)
    expected = rs.render(tracer, mode, (32, 20), camera=far).pixels
    assert np.array_equal(light.reshape(20, 32, 3), expected)


def test_rows_of_a_sample_are_those_of_the_whole(tracer):
    renderer = RENDERERS["raycast"]
    context = make_context(tracer, tracer.scene.camera, (20, 16), ONE, {}, ("depth",))
    whole, seen = trace_sample(renderer, context, 0)
    part, seen_part = trace_sample(renderer, context, 0, rows=range(5, 12))
    assert np.array_equal(part, whole[5 * 20 : 12 * 20])
    assert seen is not None
    assert seen_part is not None
    assert np.array_equal(seen_part.depth, seen.depth[5 * 20 : 12 * 20])

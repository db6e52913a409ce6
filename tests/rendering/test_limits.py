"""Limits of noise and time: equal samples for all pixels, with the same bits in all ways."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

import raystream as rs
from conftest import assert_same_bits
from raystream.core.errors import FileFormatError
from raystream.jit.threads import set_thread_count
from raystream.rendering import progressive, sample_bands
from raystream.rendering.contexts import make_context
from raystream.rendering.film import Film
from raystream.rendering.limits import FIRST_SAMPLES
from raystream.rendering.render import RENDERERS
from raystream.rendering.sample_bands import trace_sample
from raystream.rendering.sampling.sampler import Sampler

SIZE = WIDTH, HEIGHT = 16, 12
PIXELS = WIDTH * HEIGHT
NOISE = 0.65


@pytest.fixture(scope="module")
def tracer():
    return rs.Tracer(rs.load("cornell"))


def render(tracer, **options):
    return rs.render(tracer, "path", SIZE, **{"samples": 4096, "layers": "all", **options})


def assert_same_image(found, expected):
    assert_same_bits(found.pixels, expected.pixels)
    assert found.layers.keys() == expected.layers.keys()
    for name, layer in expected.layers.items():
        assert_same_bits(found.layers[name], layer)
    assert found.figures == expected.figures


@pytest.fixture(scope="module")
def whole(tracer):
    return render(tracer, noise=NOISE)


def test_noise_ends_an_image_with_the_first_sample_that_is_enough(tracer, whole):
    taken = whole.figures["samples"]
    assert isinstance(taken, int)
    assert FIRST_SAMPLES + 5 < taken < 4096
    assert (whole.layers["samples"] == taken).all()
    assert whole.figures["error"] <= NOISE
    assert_same_image(render(tracer, samples=taken), whole)
    assert render(tracer, samples=taken - 1).figures["error"] > NOISE


def test_noise_is_not_tested_before_it_means_something(tracer):
    assert render(tracer, noise=1e9).figures["samples"] == FIRST_SAMPLES
    assert render(tracer, noise=1e9, samples=3).figures["samples"] == 3


def test_limits_that_are_not_reached_change_no_bit(tracer):
    """The samples of the whole image are added one by one."""
    mode = RENDERERS["path"]
    camera = tracer.scene.camera_for(WIDTH / HEIGHT)
    sampler = Sampler.of("sobol", 0, 20)
    context = make_context(tracer, camera, SIZE, sampler, mode.check(mode.complete({})))
    film = Film(*SIZE)
    for sample in range(20):
        film.add_samples(0, trace_sample(mode, context, sample)[0])
    expected = film.image({"samples": 20, "error": film.error()})
    for limit in ({}, {"noise": 1e-9}, {"time_limit": 1e9}):
        assert_same_image(render(tracer, samples=20, layers=None, **limit), expected)


@pytest.mark.parametrize("threads", [1, 3])
def test_threads_and_bands_change_no_bit(tracer, whole, threads, monkeypatch):
    monkeypatch.setattr(sample_bands, "LEAST_BAND", 64)
    set_thread_count(threads)
    try:
        assert_same_image(render(tracer, noise=NOISE), whole)
    finally:
        set_thread_count(None)


def test_layers_change_no_bit_of_the_light(tracer, whole):
    bare = render(tracer, noise=NOISE, layers=None)
    assert_same_bits(bare.pixels, whole.pixels)
    assert bare.figures == whole.figures


def test_samples_traced_beyond_the_noise_limit_are_dropped(tracer, whole, monkeypatch):
    traced, trace_samples = [], progressive.trace_samples

    def trace(renderer, context, samples, progress):
        traced.extend(samples)
        return trace_samples(renderer, context, samples, progress)

    monkeypatch.setattr(progressive, "trace_samples", trace)
    monkeypatch.setattr(progressive, "_passes_at_once", lambda *_: whole.figures["samples"] + 50)
    assert_same_image(render(tracer, noise=NOISE), whole)
    assert traced == [*range(FIRST_SAMPLES + whole.figures["samples"] + 50)]
    traced.clear()
    render(tracer, noise=1e9)
    assert traced == [*range(FIRST_SAMPLES)]  # whether more are needed is known after these


@pytest.mark.parametrize("taken", [1, FIRST_SAMPLES, FIRST_SAMPLES + 4])
@pytest.mark.parametrize("at_once", [1, pytest.param(1000, marks=pytest.mark.ci)])
def test_image_resumed_after_any_sample_is_the_same(
    tracer, whole, tmp_path, monkeypatch, taken, at_once
):
    checkpoint, calls, add = tmp_path / "a.npz", itertools.count(), progressive._add
    monkeypatch.setattr(progressive, "_passes_at_once", lambda *_: at_once)

    def stop(*arguments):
        if next(calls) == taken:
            raise KeyboardInterrupt
        add(*arguments)

    with monkeypatch.context() as patch:
        patch.setattr(progressive, "_add", stop)
        with pytest.raises(KeyboardInterrupt):
            render(tracer, noise=NOISE, checkpoint=checkpoint)
    with np.load(checkpoint) as file:
        assert (file["counts"] == taken).all()
    assert_same_image(render(tracer, noise=NOISE, checkpoint=checkpoint), whole)


def test_checkpoint_with_enough_samples_is_the_image(tracer, whole, tmp_path):
    asked = {"checkpoint": tmp_path / "a.npz"}
    assert_same_image(render(tracer, noise=NOISE, **asked), whole)
    assert_same_image(render(tracer, samples=10, **asked), whole)
    assert_same_image(render(tracer, time_limit=1e-9, **asked), whole)


@pytest.mark.parametrize("fault", ["counts", "size"])
def test_checkpoint_of_unequal_samples_is_refused(tracer, tmp_path, fault):
    checkpoint = tmp_path / "a.npz"
    render(tracer, samples=2, layers=None, checkpoint=checkpoint)
    with np.load(checkpoint) as file:
        arrays = dict(file)
    if fault == "counts":
        arrays["counts"][:40] += 1
    else:
        arrays["size"] = arrays["size"][::-1].copy()
    np.savez(checkpoint, **arrays)
    with pytest.raises(FileFormatError, match=r"a\.npz: does not hold the same number of samples"):
        render(tracer, samples=4, layers=None, checkpoint=checkpoint)

"""Properties of every sampler, and arguments that `Sampler` refuses."""

from __future__ import annotations

import numpy as np
import pytest

from chi_square import assert_uniform
from conftest import assert_same_bits
from raystream.jit.cpu import kernel
from raystream.jit.threads import set_thread_count
from raystream.rendering.sampling.sampler import KINDS, MAX_SAMPLES, Sampler, draw, draw_pair
from raystream.streams import INDEX, Kernel, Stream

PIXELS = np.arange(1 << 16)
LAST = (1 << 32) - 1


@pytest.fixture(params=KINDS)
def name(request):
    return request.param


def correlation(a, b):
    return np.corrcoef(np.asarray(a, float), np.asarray(b, float))[0, 1]


@pytest.mark.parametrize("samples", [1, 7, 64])
@pytest.mark.parametrize("dimension", [0, 1, 2, 3, 6, 4097])
def test_one_sample_of_many_pixels_is_uniform(name, samples, dimension):
    """Of each pixel one sample is taken: the even ones are then independent, too."""
    sampler = Sampler.of(name, 5, samples)
    for sample in {0, samples - 1}:
        assert_uniform(sampler.numbers(PIXELS, sample, dimension), 256)
        assert_uniform(sampler.numbers(PIXELS, sample, dimension, 2), 256)


def test_pairs_of_pairs_are_uniform(name):
    sampler = Sampler.of(name, 6, 16)
    assert_uniform(sampler.numbers(PIXELS, 9, 0, 4), 256)
    assert_uniform(sampler.numbers(PIXELS, 9, 2, 4), 256)


def test_seeds_and_dimensions_are_uniform(name):
    seeds = [Sampler.of(name, seed, 4).numbers(3, 2, 0, 2)[0] for seed in range(4096)]
    assert_uniform(seeds, 64)
    assert_uniform(Sampler.of(name, 1, 4).numbers(3, 2, 0, 1 << 16).reshape(-1, 2), 256)


@pytest.mark.parametrize("sample", [0, 1, 13])
def test_pixels_and_dimensions_are_independent(name, sample):
    """No correlation over 2**16 pixels is more than 5.5 of its standard deviations of 2**-8."""
    numbers = Sampler.of(name, 2, 16).numbers(PIXELS, sample, 0, 12)
    size = numbers.shape[1]
    across = np.corrcoef(numbers.T.astype(float)) - np.eye(size)
    assert np.abs(across).max() < 5.5 / 256
    for step in (1, 2, 1024):  # neighbours in a row, and in a column
        for k in range(size):
            assert abs(correlation(numbers[:-step, k], numbers[step:, k])) < 5.5 / 256


def test_samples_of_two_pixels_or_pairs_are_independent(name):
    """Sample by sample over 4096: 5.5 standard deviations are 5.5 / 64."""
    sampler = Sampler.of(name, 2, 4096)
    samples = np.arange(4096)
    here, there = sampler.numbers(10, samples, 0, 12), sampler.numbers(11, samples, 0, 12)
    other = Sampler.of(name, 3, 4096).numbers(10, samples, 0, 12)
    for k in range(12):
        assert abs(correlation(here[:, k], there[:, k])) < 5.5 / 64
        assert abs(correlation(here[:, k], other[:, k])) < 5.5 / 64
    assert np.abs(np.corrcoef(here.T.astype(float)) - np.eye(12)).max() < 5.5 / 64


def test_a_number_depends_on_nothing_else(name, rng):
    """Not on the order, the neighbours, the threads, nor on how many are drawn together."""
    sampler = Sampler.of(name, 9, 50)
    count = 20_000
    pixels, samples = rng.integers(0, 1 << 30, count), rng.integers(0, 200, count)
    numbers = sampler.numbers(pixels, samples, 3, 6)
    order = rng.permutation(count)
    assert_same_bits(sampler.numbers(pixels[order], samples[order], 3, 6), numbers[order])
    for k in range(6):
        assert_same_bits(sampler.numbers(pixels, samples, 3 + k)[:, 0], numbers[:, k])
    try:
        set_thread_count(1)
        assert_same_bits(sampler.numbers(pixels, samples, 3, 6), numbers)
    finally:
        set_thread_count(None)
    single = sampler.numbers(int(pixels[5]), int(samples[5]), 3, 6)
    assert_same_bits(single[0], numbers[5])


def test_other_seeds_pixels_samples_and_dimensions_give_other_numbers(name):
    own = Sampler.of(name, 1, 64).numbers(2, np.arange(64), 4)
    for other in (
        Sampler.of(name, 2, 64).numbers(2, np.arange(64), 4),
        Sampler.of(name, 1, 64).numbers(1, np.arange(64), 4),
        Sampler.of(name, 1, 64).numbers(2, np.arange(64, 128), 4),
        Sampler.of(name, 1, 64).numbers(2, np.arange(64), 5),
        Sampler.of(name, 1, 64).numbers(2, np.arange(64), 8),
    ):
        assert (own != other).mean() > 0.95


@kernel
def draw_both(sampler, pixel, dimension, out):
    for sample in range(len(out)):
        out[sample, 0] = draw(sampler, pixel, sample, dimension)
        out[sample, 1] = draw(sampler, pixel, sample, dimension + 1)
        if not dimension & 1:
            pair = draw_pair(sampler, pixel, sample, dimension)
            out[sample, 2], out[sample, 3] = pair


@pytest.mark.parametrize("dimension", [0, 1, 2, 3, 5001])
def test_a_pair_is_two_numbers(name, dimension):
    out = np.empty((200, 4), np.float32)
    sampler = Sampler.of(name, 4, 100)
    draw_both(sampler, 77, dimension, out)
    if dimension % 2 == 0:
        assert_same_bits(out[:, :2], out[:, 2:])
    assert_same_bits(sampler.numbers(77, np.arange(200), dimension, 2), out[:, :2])


def test_the_ends_of_all_ranges(name):
    sampler = Sampler.of(name, LAST, MAX_SAMPLES)
    numbers = sampler.numbers([0, LAST], [LAST, LAST], LAST, 1)
    assert ((numbers >= 0) & (numbers < 1)).all()
    samples = np.append(np.arange(1 << 16), MAX_SAMPLES - 1 - np.arange(1 << 16))
    assert sampler.numbers(0, samples, 0, 2).max() < 1
    last = Sampler.of(name, 0, 3).numbers(np.arange(1 << 20), 2, 0, 2)
    assert last.max() < 1
    assert last.max() > 1 - 1e-4
    # 131,072 numbers of 24 bits are nearly all different, if the bits are used.
    assert len(np.unique(sampler.numbers(0, samples, 0))) > 130_000


def test_a_stream_kernel_draws():
    out = Stream(np.zeros(64, np.float32))

    def fill(pixel, sampler):
        return draw(sampler, pixel, 3, 1)

    sampler = Sampler.of("sobol", 8)
    Kernel(fill, inputs={"pixel": INDEX}, outputs=out, constants={"sampler": sampler}).execute()
    assert_same_bits(out.array, sampler.numbers(np.arange(64), 3, 1)[:, 0])


def test_shapes_of_numbers():
    sampler = Sampler.of("random")
    assert sampler.numbers(0, 0).shape == (1, 1)
    assert sampler.numbers(0, np.arange(5), count=3).shape == (5, 3)
    assert sampler.numbers(np.arange(5, dtype=np.uint8), 0, count=3).shape == (5, 3)
    assert sampler.numbers([], [], count=3).shape == (0, 3)
    assert sampler.numbers([1, 2], 0, count=0).shape == (2, 0)
    assert sampler.numbers(0, 0).dtype == np.float32


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [
        (("halton",), ValueError, "name: expected one of sobol, stratified, random"),
        (("sobol", -1), ValueError, "seed: expected 0 to"),
        (("sobol", 1 << 32), ValueError, "seed: expected 0 to"),
        (("sobol", 0.5), TypeError, "seed: expected an integer, got float"),
        (("sobol", 0, 0), ValueError, "samples: expected 1 to"),
        (("sobol", 0, MAX_SAMPLES + 1), ValueError, "samples: expected 1 to"),
        (("sobol", 0, "4"), TypeError, "samples: expected an integer, got str"),
    ],
)
def test_bad_samplers_are_refused(arguments, error, message):
    with pytest.raises(error, match=message):
        Sampler.of(*arguments)


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [
        (([0, 1], [0, 1, 2]), ValueError, "pixels, samples: expected equal lengths, got 2 and 3"),
        (([-1], 0), ValueError, "pixels: expected 0 to .* got -1"),
        ((0, [1 << 32]), ValueError, "samples: expected 0 to .* got 4,294,967,296"),
        ((0.5, 0), TypeError, "pixels: expected integers, got dtype float64"),
        ((0, [[1]]), ValueError, "samples: expected one dimension"),
        ((0, 0, -1), ValueError, "dimension: expected 0 to"),
        ((0, 0, 1.5), TypeError, "dimension: expected an integer"),
        ((0, 0, LAST, 2), ValueError, "count: expected 0 to 1, got 2"),
        ((np.arange(1 << 20), 0, 0, 1 << 31), MemoryError, "numbers would take"),
    ],
)
def test_bad_numbers_are_refused(arguments, error, message):
    with pytest.raises(error, match=message):
        Sampler.of("sobol").numbers(*arguments)

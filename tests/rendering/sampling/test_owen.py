"""The Sobol numbers: nets, four dimensions together, and errors that fall quickly."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

from raystream.rendering.sampling.quad_matrix import byte_tables, quad_matrix
from raystream.rendering.sampling.sampler import Sampler


def compositions(total, parts):
    """All ordered ways to write a number as a sum of this many terms."""
    if parts == 1:
        yield (total,)
        return
    for first in range(total + 1):
        for rest in compositions(total - first, parts - 1):
            yield (first, *rest)


def is_net(points, k, base=2):
    """Whether each box of volume base**-k with sides of powers of 1 / base has one point."""
    assert len(points) == base**k
    for exponents in compositions(k, points.shape[1]):
        cells = (points.astype(np.float64) * float(base) ** np.array(exponents)).astype(int)
        if len(np.unique(cells, axis=0)) < len(points):
            return False
    return True


def test_the_oracle_knows_nets():
    i = np.arange(16)
    van_der_corput = np.array([int(f"{n:04b}"[::-1], 2) for n in i]) / 16
    hammersley = np.stack([i / 16, van_der_corput], 1)
    assert is_net(hammersley, 4)
    assert not is_net(np.roll(hammersley, 1, axis=1)[:, ::-1] * [1, 0.5], 4)
    assert not is_net(np.stack([i / 16, i / 16], 1), 4)


@pytest.mark.parametrize("dimension", [0, 2, 4, 6, 30, 1000, 9998])
@pytest.mark.parametrize("pixel", [0, 1, 640, (1 << 30) - 1])
def test_each_pair_is_a_net_at_every_power_of_two(pixel, dimension):
    points = Sampler.of("sobol", 11).numbers(pixel, np.arange(256), dimension, 2)
    for k in range(9):
        assert is_net(points[: 1 << k], k)


def test_later_blocks_are_nets_too():
    """A render that is resumed gets the rest of the sequence."""
    samples = np.arange(4096)
    for dimension in (0, 2):
        points = Sampler.of("sobol", 3).numbers(5, samples, dimension, 2)
        for begin in range(0, 4096, 256):
            assert is_net(points[begin : begin + 256], 8)


def test_large_nets():
    points = Sampler.of("sobol", 3).numbers(5, np.arange(1 << 14), 2, 2)
    assert is_net(points, 14)


def test_other_pairs_are_not_nets():
    """Dimensions of two groups are independent."""
    numbers = Sampler.of("sobol", 3).numbers(5, np.arange(256), 0, 8)
    assert not is_net(numbers[:, [3, 4]], 8)
    assert not is_net(numbers[:, [0, 4]], 8)


@pytest.mark.parametrize("dimension", [0, 4, 4000])
@pytest.mark.parametrize("pixel", [0, 99])
def test_four_dimensions_are_a_net_in_base_4(pixel, dimension):
    """256 samples: one in each cell of a grid of 4 x 4 x 4 x 4, of one of 16 x 16 and so on."""
    points = Sampler.of("sobol", 21).numbers(pixel, np.arange(256), dimension, 4)
    for k in range(1, 5):
        assert is_net(points[: 4**k], k, base=4)


def test_groups_are_not_in_step():
    """If two groups had their samples in one order, points of both would lie on few lines."""
    numbers = Sampler.of("sobol", 3).numbers(5, np.arange(256), 0, 64)[:, ::4]
    cells = (numbers * 16).astype(int)
    for a, b in itertools.combinations(range(16), 2):
        # 256 points at random fill 0.63 of 256 cells; in step they fill all, or 16.
        assert 0.45 < len(np.unique(cells[:, [a, b]], axis=0)) / 256 < 0.85


def scrambled_squares(name, samples, runs=256):
    """Errors of the integral of a smooth function over two dimensions, root of mean square."""
    points = Sampler.of(name, 7, samples).numbers(
        np.repeat(np.arange(runs), samples), np.tile(np.arange(samples), runs), 2, 2
    )
    values = np.exp(points.astype(np.float64).sum(axis=1)).reshape(runs, samples)
    return math.sqrt(((values.mean(axis=1) - (math.e - 1) ** 2) ** 2).mean())


def test_errors_of_smooth_functions_fall_faster_than_chance():
    """Owen's nets have a variance of N**-3 for these, times a logarithm; chance has N**-1.

    Over a factor of 64 in N the root of the mean square falls to 1 / 8 by chance, and to
    about 1 / 512 here. Of 256 runs it is known to 5 %.
    """
    chance = scrambled_squares("random", 16) / scrambled_squares("random", 1024)
    assert 6 < chance < 10.7
    even = scrambled_squares("sobol", 16) / scrambled_squares("sobol", 1024)
    assert even > 150
    strata = scrambled_squares("stratified", 16) / scrambled_squares("stratified", 1024)
    assert strata > 40  # N**-2


def test_edges_are_found_better_than_by_chance():
    """The area of a disk, in each pair of a group: 256 samples, 256 pixels."""
    for dimension in (0, 2):
        errors = {}
        for name in ("sobol", "random"):
            points = Sampler.of(name, 7, 256).numbers(
                np.repeat(np.arange(256), 256), np.tile(np.arange(256), 256), dimension, 2
            )
            inside = (points**2).sum(axis=1).reshape(256, 256) < 1
            errors[name] = np.sqrt(((inside.mean(axis=1) - math.pi / 4) ** 2).mean())
        assert errors["sobol"] < errors["random"] / 3


def test_the_mean_over_pixels_is_unbiased():
    """Of 65,536 pixels with 4 samples each: within 5.5 standard errors of the integral."""
    points = Sampler.of("sobol", 7).numbers(
        np.repeat(np.arange(1 << 16), 4), np.tile(np.arange(4), 1 << 16), 0, 4
    )
    values = np.exp(points.astype(np.float64).sum(axis=1)).reshape(-1, 4).mean(axis=1)
    error = values.std() / 256
    assert abs(values.mean() - (math.e - 1) ** 4) < 5.5 * error


def test_the_scramble_flips_bits_independently():
    """First samples of many pixels: which half, quarter and eighth they are in is one in eight.

    And the flips of a bit for different upper bits are independent, as Owen's: with four
    samples the lower bits of the two numbers in each half are compared.
    """
    count = 1 << 16
    numbers = Sampler.of("sobol", 1).numbers(
        np.repeat(np.arange(count), 8), np.tile(np.arange(8), count), 0
    )
    eighths = np.sort(numbers.reshape(count, 8), axis=1) * 8
    assert (eighths.astype(int) == np.arange(8)).all()
    lower = (eighths * 2).astype(int) & 1  # the half of its eighth that each number is in
    correlations = np.corrcoef(lower.T) - np.eye(8)
    assert np.abs(correlations).max() < 5.5 / 256
    assert np.abs(lower.mean(axis=0) - 0.5).max() < 5.5 / 512


def test_the_matrix_keeps_blocks_together():
    columns = quad_matrix()
    assert (columns >> np.arange(32, dtype=np.uint32) == 1).all()


def test_tables_multiply_as_columns_do(rng):
    columns = rng.integers(0, 1 << 32, 32, dtype=np.uint32)
    tables = byte_tables(columns)
    for x in rng.integers(0, 1 << 32, 50).tolist():
        expected = 0
        for j in range(32):
            expected ^= int(columns[j]) * (x >> j & 1)
        found = 0
        for byte in range(4):
            found ^= int(tables[byte, x >> 8 * byte & 255])
        assert found == expected

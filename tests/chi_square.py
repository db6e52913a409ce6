"""The chi-square test, for samplers and for maps of samples."""

from __future__ import annotations

from statistics import NormalDist

import numpy as np

#: How likely it is that a run of all tests fails by chance, and how many tests share it.
ERROR = 1e-6
TESTS = 300


def assert_follows(counts, expected) -> None:
    """Fail where counts differ from expected ones by more than chance allows.

    Cells that expect fewer than 10 become one. The limit is Wilson and Hilferty's (1931), which
    has less than 1 % of error for 30 degrees of freedom or more.
    """
    counts, expected = np.ravel(counts).astype(float), np.ravel(expected).astype(float)
    assert abs(counts.sum() - expected.sum()) < 1e-3 * counts.sum()
    expected *= counts.sum() / expected.sum()
    is_small = expected < 10
    if is_small.any():
        counts = np.append(counts[~is_small], counts[is_small].sum())
        expected = np.append(expected[~is_small], expected[is_small].sum())
        if expected[-1] == 0:  # where no sample may be
            assert counts[-1] == 0
            counts, expected = counts[:-1], expected[:-1]
    degrees = len(counts) - 1
    assert degrees >= 30
    z = NormalDist().inv_cdf(1 - ERROR / TESTS)
    limit = degrees * (1 - 2 / (9 * degrees) + z * (2 / (9 * degrees)) ** 0.5) ** 3
    statistic = ((counts - expected) ** 2 / expected).sum()
    assert statistic < limit, f"chi-square is {statistic:.0f}; chance allows {limit:.0f}"


def assert_uniform(points, cells: int) -> None:
    """Test numbers of shape (N,) or points (N, D), in [0, 1), on a grid of this many cells."""
    points = np.asarray(points, np.float64)
    points = points.reshape(len(points), -1)
    assert (points >= 0).all()
    assert (points < 1).all()
    side = round(cells ** (1 / points.shape[1]))
    index = (points * side).astype(int) @ side ** np.arange(points.shape[1])
    cell_count = side ** points.shape[1]
    counts = np.bincount(index, minlength=cell_count)
    assert_follows(counts, np.full(cell_count, len(points) / cell_count))

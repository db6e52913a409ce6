"""Z-tests of images that are sums of random samples: their means, and the variance of these."""

from __future__ import annotations

from statistics import NormalDist

import numpy as np

#: How likely it is that a run of all tests fails by chance, and how many comparisons share it
#: (Bonferroni): each channel of each mean counts.
ERROR = 1e-6
TESTS = 2000

#: Standard errors by which a mean may be off: 6.1.
LIMIT = NormalDist().inv_cdf(1 - ERROR / TESTS / 2)

#: Radiance is a product of some ten float32 numbers, and is added up in float32: relative.
ROUNDING = 1e-5


def mean_of(image, blocks: int = 1):
    """Means over blocks x blocks parts of an image, and the variances of these means.

    Pixels are drawn independently of each other. Where a pixel's samples are spread evenly,
    the variance is estimated too large, and tests with it are milder than `ERROR` says.
    """
    height, width, channels = image.pixels.shape
    assert height % blocks == 0
    assert width % blocks == 0
    shape = blocks, height // blocks, blocks, width // blocks, channels
    count = height * width / blocks**2
    mean = image.pixels.astype(np.float64).reshape(shape).mean(axis=(1, 3))
    variance = image.layers["variance"].astype(np.float64).reshape(shape).mean(axis=(1, 3))
    return mean.reshape(-1, channels), variance.reshape(-1, channels) / count


def assert_mean(image, expected) -> None:
    """Fail where an image's mean differs from the expected one by more than chance allows."""
    mean, variance = mean_of(image)
    expected = np.broadcast_to(np.asarray(expected, np.float64), mean.shape)
    assert_zero(mean - expected, variance, expected)


def assert_equal_means(image, other, blocks: int = 1) -> None:
    """Fail where two independent images differ by more than chance allows, part by part."""
    mean, variance = mean_of(image, blocks)
    other_mean, other_variance = mean_of(other, blocks)
    assert_zero(mean - other_mean, variance + other_variance, other_mean)


def assert_at_most(image, bound: float) -> None:
    """Fail where an image's mean is above a bound by more than chance allows."""
    mean, variance = mean_of(image)
    assert_zero(np.maximum(mean - bound, 0.0), variance, np.full(3, bound))


def assert_zero(difference, variance, scale) -> None:
    """Fail where differences of these variances are too many standard errors from 0."""
    assert np.isfinite(variance).all()
    allowed = LIMIT * np.sqrt(variance) + ROUNDING * np.abs(scale)
    worst = np.unravel_index(np.argmax(np.abs(difference) - allowed), difference.shape)
    assert (np.abs(difference) <= allowed).all(), (
        f"off by {difference[worst]:.3g}; chance allows {allowed[worst]:.3g}"
    )


def spread_limits(degrees: int) -> tuple[float, float]:
    """Limits of a chi-square variable with this many degrees of freedom, except by chance.

    By Wilson and Hilferty (1931), good for 30 degrees or more.
    """
    assert degrees >= 30
    part = 2 / (9 * degrees)
    low, high = (degrees * (1 - part + z * part**0.5) ** 3 for z in (-LIMIT, LIMIT))
    return low, high

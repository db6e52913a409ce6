"""Balanced view factors: reciprocity and sums of 1, by the smallest changes that give them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

#: Rounds that fix negative factors at zero.
_ROUNDS = 20

#: Up to this many equations the least squares of a singular matrix take less than a second.
_FEW = 1000


class Shares(NamedTuple):
    """Shares of each patch's rays, with standard errors.

    Attributes
    ----------
    factors, errors : ndarray of shape (N, N), float64
    sinks, sink_errors : ndarray of shape (N, 2), float64
        Shares that meet nothing, and that meet no patch.
    """

    factors: NDArray[np.float64]
    errors: NDArray[np.float64]
    sinks: NDArray[np.float64]
    sink_errors: NDArray[np.float64]


def balanced(shares: Shares, areas: NDArray[np.float64]) -> Shares:
    """Make ``areas[i] * factors[i, j]`` symmetric and each row's sum 1.

    Parameters
    ----------
    shares : Shares
    areas : ndarray of shape (N,), float64

    Returns
    -------
    Shares
        Those nearest to the estimates, each difference in units of its standard error, that are
        not negative. What was 0 from both sides stays 0.

    Notes
    -----
    The two estimates of an exchange ``areas[i] * factors[i, j]`` are averaged, weighted by their
    inverse variances. The rows' sums then give N linear equations for N Lagrange multipliers.
    Exchanges that become negative are fixed at 0, and the equations solved again.
    """
    areas = areas / areas.mean()
    exchange = shares.factors * areas[:, None]
    variance = (shares.errors * areas[:, None]) ** 2
    weight, total = 1.0 / variance, 1.0 / variance + 1.0 / variance.T
    mean = (exchange * weight + exchange.T * weight.T) / total
    variance = 1.0 / total
    diagonal = np.diag_indices(len(areas))
    mean[diagonal], variance[diagonal] = exchange[diagonal], 1.0 / weight[diagonal]
    sinks = shares.sinks * areas[:, None]
    sink_variance = (shares.sink_errors * areas[:, None]) ** 2
    errors = np.sqrt(variance) / areas[:, None]

    free, free_sinks = mean > 0.0, sinks > 0.0
    for _ in range(_ROUNDS):
        spread, sink_spread = variance * free, sink_variance * free_sinks
        matrix = spread + np.diag(spread.sum(axis=1) - spread[diagonal] + sink_spread.sum(axis=1))
        lacking = areas - (mean * free).sum(axis=1) - (sinks * free_sinks).sum(axis=1)
        scale = max(float(np.abs(matrix).max(initial=0.0)), np.finfo(float).tiny)
        multiplier = _solution(matrix / scale, lacking / scale)
        change = spread * (multiplier[:, None] + multiplier)
        change[diagonal] = spread[diagonal] * multiplier
        result = (mean + change) * free
        result_sinks = (sinks + sink_spread * multiplier[:, None]) * free_sinks
        negative, negative_sinks = result < 0.0, result_sinks < 0.0
        if not (negative.any() or negative_sinks.any()):
            break
        free &= ~negative
        free_sinks &= ~negative_sinks
    result, result_sinks = np.maximum(result, 0.0), np.maximum(result_sinks, 0.0)
    return Shares(
        result / areas[:, None], errors, result_sinks / areas[:, None], shares.sink_errors
    )


def _solution(matrix: NDArray[np.float64], right: NDArray[np.float64]) -> NDArray[np.float64]:
    """Solve symmetric equations; the shortest solution where there are several."""
    if len(right) > _FEW:
        try:
            found = np.asarray(np.linalg.solve(matrix, right), np.float64)
            if np.allclose(matrix @ found, right, rtol=1e-9, atol=1e-12):
                return found
        except np.linalg.LinAlgError:
            pass
    return np.asarray(np.linalg.lstsq(matrix, right, rcond=None)[0], np.float64)

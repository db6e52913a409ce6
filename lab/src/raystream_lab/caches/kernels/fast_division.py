"""Exact uint64 division by a fixed divisor: one multiplication and two shifts."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from raystream.jit.cpu import device
from raystream.jit.intrinsics import high_product


class Divisor(NamedTuple):
    """A prepared divisor for `quotient`; all are uint64.

    Attributes
    ----------
    number
        The divisor.
    factor, first_shift, second_shift
        m', sh1 and sh2 of Granlund and Montgomery.
    """

    number: np.uint64
    factor: np.uint64
    first_shift: np.uint64
    second_shift: np.uint64


def divisor(number: int) -> Divisor:
    """Prepare a divisor from 1 to 2**64 - 1.

    References
    ----------
    Granlund and Montgomery, "Division by Invariant Integers using Multiplication", PLDI 1994,
    figure 4.1.
    """
    bits = (number - 1).bit_length()
    factor = (((1 << bits) - number) << 64) // number + 1
    shifts = min(bits, 1), max(bits - 1, 0)
    return Divisor(np.uint64(number), np.uint64(factor), *(np.uint64(shift) for shift in shifts))


@device
def quotient(dividend, by):
    """Divide a uint64 by a `Divisor`, rounding down; exact for every dividend."""
    high = high_product(dividend, by.factor)
    return (high + ((dividend - high) >> by.first_shift)) >> by.second_shift

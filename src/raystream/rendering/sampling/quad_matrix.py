"""The bit matrix that stratifies two pairs of dimensions jointly, in four dimensions."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

_BITS = 32

#: A root w of x**2 + x + 1 over GF(2), as the matrix that multiplies a pair of bits by it.
_ROOT = np.array([[0, 1], [1, 1]], np.uint32)


def quad_matrix() -> NDArray[np.uint32]:
    """Pascal's triangle over GF(4), times powers of w: entry (i, j) is C(j, i) w**(j - i).

    Returns
    -------
    ndarray of shape (32,), uint32
        The columns: the bits that bit j of an index flips. Bits 2i and 2i + 1 are a base-4 digit.

    Notes
    -----
    The matrices C(j, i) a**(j - i) for the four a of GF(4), which belong to the polynomials
    x - a, generate a (0, 4)-sequence in base 4 [1]_: each block of 4**k samples has one in every
    box of volume 4**-k whose sides are powers of 1/4. Those for 0 and 1 are Sobol's first two,
    up to a permutation of digits. Since the matrix for a times that for b is that for a + b,
    this one turns them into the other two. It is upper triangular with a unit diagonal, since
    w**0 = 1: blocks of 2**k indices stay together.

    References
    ----------
    .. [1] Niederreiter, "Point Sets and Sequences with Small Discrepancy", Monatshefte für
       Mathematik 104, 1987.
    """
    powers = [np.eye(2, dtype=np.uint32), _ROOT, _ROOT @ _ROOT % 2]
    matrix = np.zeros((_BITS, _BITS), np.uint32)
    for j in range(_BITS // 2):
        for i in range(j + 1):
            if i & j == i:  # C(j, i) is odd (Lucas)
                matrix[2 * i : 2 * i + 2, 2 * j : 2 * j + 2] = powers[(j - i) % 3]
    shifts = np.arange(_BITS, dtype=np.uint32)
    return np.bitwise_or.reduce(matrix << shifts[:, None], axis=0)


def byte_tables(columns: NDArray[np.uint32]) -> NDArray[np.uint32]:
    """The bits that each value of each byte of an index flips: four lookups replace 32 columns.

    Parameters
    ----------
    columns : ndarray of shape (32,), uint32

    Returns
    -------
    ndarray of shape (4, 256), uint32
    """
    tables = np.zeros((4, 256), np.uint32)
    for byte in range(4):
        for bit in range(8):
            half = 1 << bit
            tables[byte, half : 2 * half] = tables[byte, :half] ^ columns[8 * byte + bit]
    return tables

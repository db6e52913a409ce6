"""Morton codes: the bits of numbers along three axes in turn, so that neighbours are near.

References
----------
Morton, "A computer oriented geodetic data base and a new technique in file sequencing", IBM 1966.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from raystream.jit.cpu import device


def spread_numbers(numbers: Any) -> Any:
    """Insert two zero bits before each of the lowest 21 bits of uint64 numbers below 2**21."""
    numbers = (numbers | (numbers << np.uint64(32))) & np.uint64(0x001F00000000FFFF)
    numbers = (numbers | (numbers << np.uint64(16))) & np.uint64(0x001F0000FF0000FF)
    numbers = (numbers | (numbers << np.uint64(8))) & np.uint64(0x100F00F00F00F00F)
    numbers = (numbers | (numbers << np.uint64(4))) & np.uint64(0x10C30C30C30C30C3)
    return (numbers | (numbers << np.uint64(2))) & np.uint64(0x1249249249249249)


#: The same, for kernels.
spread_bits = device(spread_numbers)

"""Parts of the cache simulator."""

from __future__ import annotations

import numpy as np

from extras import need

need("raystream_lab")

from raystream.jit.cpu import kernel
from raystream_lab.caches.kernels.fast_division import divisor, quotient


def test_quotients_are_exact(rng):
    @kernel
    def divide(a, by):
        return quotient(a, by)

    numbers = [1, 2, 3, 4, 7, 48, 64, 1365, 2**32 - 1, 2**32, 2**63, 2**63 + 1, 2**64 - 1]
    numbers += (2 ** rng.random(20) * 2.0 ** rng.integers(0, 62, 20)).astype(int).tolist()
    for number in numbers:
        by = divisor(number)
        near = {k * number + d for k in (0, 1, 2, (2**64 - 1) // number) for d in (-1, 0, 1)}
        for dividend in near | {0, 2**63, 2**64 - 1, int(rng.integers(0, 2**63))}:
            if 0 <= dividend < 2**64:
                assert divide(np.uint64(dividend), by) == dividend // number

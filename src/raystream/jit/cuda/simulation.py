"""Numba's CUDA simulator, which runs kernels on the CPU."""

from __future__ import annotations

import threading

from numba.cuda.core import config

#: Held while a kernel runs: the simulator runs one at a time.
simulating = threading.Lock()


def is_simulated() -> bool:
    """Whether kernels run in Numba's simulator: ``NUMBA_ENABLE_CUDASIM=1``."""
    return bool(config.ENABLE_CUDASIM)

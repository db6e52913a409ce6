"""Whether CUDA is simulated on the CPU."""

from __future__ import annotations

import threading

from numba.cuda.core import config

__all__ = ["is_simulated", "simulating"]

#: The simulator runs one kernel at a time: whoever runs one holds this.
simulating = threading.Lock()


def is_simulated() -> bool:
    """Whether kernels run in Numba's simulator: ``NUMBA_ENABLE_CUDASIM=1``."""
    return bool(config.ENABLE_CUDASIM)

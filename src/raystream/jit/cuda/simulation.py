"""Whether CUDA is simulated on the CPU."""

from __future__ import annotations

from numba.cuda.core import config

__all__ = ["is_simulated"]


def is_simulated() -> bool:
    """Whether kernels run in Numba's simulator: ``NUMBA_ENABLE_CUDASIM=1``."""
    return bool(config.ENABLE_CUDASIM)

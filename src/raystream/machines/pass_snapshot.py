"""PassSnapshot: the rays of a multipass machine between two passes, for observers."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.kernels.hits import HitArrays
from raystream.machines.steps.base import StepKernel


class PassSnapshot(NamedTuple):
    """The rays between two passes: views of the machine's arrays, which the next pass changes.

    Attributes
    ----------
    kernel : StepKernel or None
        The kernel that ran; None before the first pass.
    streams : dict of str to ndarray of shape (N,)
        ``ray``, ``wanted``, ``found``, ``place`` and ``state``: see `records`, and `PLACE` in the
        structure's module of `steps`. The field ``number`` of ``wanted`` is the ray's index. In a
        renderer's loop also ``pixel`` and ``span``.
    stacks : ndarray of shape (R, B), uint8
        Each ray's stack, by its index; B is 0 for stackless traversals. A kd-tree's
        stack is in the first ``top`` bytes: node (uint32) and end of its interval (float32).
        Empty in a renderer's loop.
    hits : HitArrays or None
        Hits so far, if they are kept, with t in the local frame.
    tallies : ndarray of shape (R, 8), uint32, or None
        Counters so far, if any; see `kernels.tally`.
    """

    kernel: StepKernel | None
    streams: dict[str, NDArray[Any]]
    stacks: NDArray[np.uint8]
    hits: HitArrays | None
    tallies: NDArray[np.uint32] | None


#: Called before the first pass and after each one. It must not change the arrays.
Observer = Callable[[PassSnapshot], None]

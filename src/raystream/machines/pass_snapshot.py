"""Observing: what a multipass machine shows of its rays after each pass, to whoever asks."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.kernels.hits import HitArrays
from raystream.machines.steps.base import StepKernel

__all__ = ["Observer", "PassSnapshot"]


class PassSnapshot(NamedTuple):
    """The rays between two passes: the machine's own arrays, which the next pass changes.

    Attributes
    ----------
    kernel : StepKernel or None
        The one that ran; None before the first pass.
    streams : dict of str to ndarray of shape (N,)
        ``ray``, ``wanted``, ``found``, ``place`` and ``state``: see `records`, and `PLACE` in the
        structure's module of `steps`. The field ``number`` of ``wanted`` says which ray a record
        is of.
    stacks : ndarray of shape (R, B), uint8
        Each ray's own memory, by its number; B is 0 where a traversal needs none. A kd-tree's
        stack is in the first ``top`` bytes: node (uint32) and end of its interval (float32).
    hits : HitArrays or None
        What has been found so far, if it is kept, with t in the local frame.
    tallies : ndarray of shape (R, 8), uint32, or None
        What has been counted so far, if it is; see `kernels.tally`.
    """

    kernel: StepKernel | None
    streams: dict[str, NDArray[Any]]
    stacks: NDArray[np.uint8]
    hits: HitArrays | None
    tallies: NDArray[np.uint32] | None


#: Called before the first pass and after each one. It changes nothing.
Observer = Callable[[PassSnapshot], None]

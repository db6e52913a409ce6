"""Termination codes: how shaders report the end of each ray's search."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from raystream.graphics.adapters import OpenDevice
from raystream.graphics.errors import GraphicsError
from raystream.graphics.structures import ShaderStructure

__all__ = ["ENDLESS", "hit_counts"]

#: Codes of rays that were not traced, that exceeded the budget, and whose loops a driver ended;
#: any other code is one more than the ray's hits. See termination.wgsl and loop_limit.wgsl.
_NOT_RUN = np.uint32(0)
ENDLESS = np.uint32(2**32 - 1)
_CUT_SHORT = np.uint32(2**32 - 2)


def hit_counts(
    endings: NDArray[np.uint32], shaders: ShaderStructure, opened: OpenDevice
) -> NDArray[np.uint32]:
    """The number of hits of each ray, if all searches ended normally.

    Parameters
    ----------
    endings : ndarray of shape (N,), uint32
        A code for each ray.
    shaders : ShaderStructure
    opened : OpenDevice

    Raises
    ------
    GraphicsError
        If one did not.
    """
    for ending, what in (
        (_NOT_RUN, "were not traced: the device may be lost"),
        (ENDLESS, f"took more than {shaders.budget:,} steps and tests"),
        (_CUT_SHORT, "were cut short by a driver that ends long loops; take another structure"),
    ):
        count = int((endings == ending).sum())
        if count:
            raise GraphicsError(
                f"device 'graphics': {count:,} of {len(endings):,} rays in {shaders.name!r} {what} "
                f"({opened.adapter})"
            )
    return endings - np.uint32(1)

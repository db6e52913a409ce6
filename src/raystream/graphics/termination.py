"""Termination codes: how shaders report the end of each ray's search."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from raystream.graphics.adapters import OpenDevice
from raystream.graphics.errors import GraphicsError
from raystream.graphics.structures import ShaderStructure

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
    codes = _NOT_RUN, ENDLESS, _CUT_SHORT
    check_endings([int((endings == one).sum()) for one in codes], len(endings), shaders, opened)
    return endings - np.uint32(1)


def check_endings(
    failed: Sequence[int], ray_count: int, shaders: ShaderStructure, opened: OpenDevice
) -> None:
    """Raise `GraphicsError` if searches did not end normally.

    Parameters
    ----------
    failed : sequence of three int
        Rays that were not traced, that were endless, and that a driver cut short.
    ray_count : int
    shaders : ShaderStructure
    opened : OpenDevice
    """
    for count, what in zip(
        failed,
        (
            "were not traced: the device may be lost",
            f"took more than {shaders.budget:,} steps and tests",
            "were cut short by a driver that ends long loops; use another structure",
        ),
        strict=True,
    ):
        if count:
            raise GraphicsError(
                f"device 'graphics': {count:,} of {ray_count:,} rays in {shaders.name!r} {what} "
                f"({opened.adapter})"
            )

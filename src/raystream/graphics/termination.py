"""Endings: how the search of each ray ended, as machines read it back."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from raystream.graphics.adapters import OpenDevice
from raystream.graphics.errors import GraphicsError
from raystream.graphics.forms import Form
from raystream.graphics.records import CUT_SHORT, ENDLESS, NOT_RUN

__all__ = ["hit_counts"]


def hit_counts(endings: NDArray[np.uint32], form: Form, opened: OpenDevice) -> NDArray[np.uint32]:
    """Hits of each ray, if all searches ended as they should.

    Parameters
    ----------
    endings : ndarray of shape (N,), uint32
        `NOT_RUN`, `ENDLESS`, `CUT_SHORT`, or one more than the hits; see ending.wgsl.
    form : Form
    opened : OpenDevice

    Raises
    ------
    GraphicsError
        If they did not.
    """
    for ending, what in (
        (NOT_RUN, "were not traced: the device may be lost"),
        (ENDLESS, f"took more than {form.budget:,} steps and tests"),
        (CUT_SHORT, "were cut short by a driver that ends long loops; take another structure"),
    ):
        count = int((endings == ending).sum())
        if count:
            raise GraphicsError(
                f"device 'graphics': {count:,} of {len(endings):,} rays in {form.name!r} {what} "
                f"({opened.adapter})"
            )
    return endings - np.uint32(1)

"""Decisions: what a program at a hit returns."""

from __future__ import annotations

import enum

__all__ = ["Decision"]


class Decision(enum.IntEnum):
    """What becomes of a ray after a hit.

    Attributes
    ----------
    CONTINUE
        It goes on: the same as to return nothing.
    STOP
        It ends here: no later hit of the ray is given to the program.
    IGNORE
        It goes on, and for a query the hit does not exist.
    """

    CONTINUE = 0
    STOP = 1
    IGNORE = 2

"""Decision: the result of a program at a hit."""

from __future__ import annotations

import enum


class Decision(enum.IntEnum):
    """How a ray continues after a hit.

    Attributes
    ----------
    CONTINUE
        The ray continues; the same as returning None.
    STOP
        The ray ends: the program receives no later hits of it.
    IGNORE
        The ray continues, and the query ignores the hit.
    """

    CONTINUE = 0
    STOP = 1
    IGNORE = 2

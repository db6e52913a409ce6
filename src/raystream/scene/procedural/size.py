"""Size: limits on the triangle count of a built-in scene."""

from __future__ import annotations

import operator

__all__ = ["MAX_TRIANGLES", "MIN_TRIANGLES", "check_triangles"]

#: Below this a scene would be unrecognisable.
MIN_TRIANGLES = 24

#: Above this a scene needs more than a few tens of gigabytes.
MAX_TRIANGLES = 500_000_000


def check_triangles(triangles: int) -> int:
    """Return the target count as an int.

    Raises
    ------
    TypeError
        If it is not an integer.
    ValueError
        If it lies outside [`MIN_TRIANGLES`, `MAX_TRIANGLES`].
    """
    if isinstance(triangles, bool):
        raise TypeError("triangles: expected an integer, got bool")
    try:
        count = operator.index(triangles)
    except TypeError:
        kind = type(triangles).__name__
        raise TypeError(f"triangles: expected an integer, got {kind}") from None
    if not MIN_TRIANGLES <= count <= MAX_TRIANGLES:
        raise ValueError(
            f"triangles: expected {MIN_TRIANGLES:,} to {MAX_TRIANGLES:,}, got {count:,}"
        )
    return count

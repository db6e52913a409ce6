"""Size: the triangle count of a built-in scene, its limits and how to come close to it."""

from __future__ import annotations

import math
import operator
from collections.abc import Callable

#: Below this a scene would be unrecognisable.
MIN_TRIANGLES = 24

#: Above this a scene needs more than a few tens of gigabytes.
MAX_TRIANGLES = 500_000_000

#: Above this a scene has more triangles in its instances than can be numbered, or nearly so.
MAX_INSTANCED_TRIANGLES = 2_000_000_000


def check_triangles(triangles: int, most: int = MAX_TRIANGLES) -> int:
    """Return the target count as an int.

    Raises
    ------
    TypeError
        If it is not an integer.
    ValueError
        If it lies outside [`MIN_TRIANGLES`, `most`].
    """
    if isinstance(triangles, bool):
        raise TypeError("triangles: expected an integer, got bool")
    try:
        count = operator.index(triangles)
    except TypeError:
        kind = type(triangles).__name__
        raise TypeError(f"triangles: expected an integer, got {kind}") from None
    if not MIN_TRIANGLES <= count <= most:
        raise ValueError(f"triangles: expected {MIN_TRIANGLES:,} to {most:,}, got {count:,}")
    return count


def closest_divisions(triangles: int, count: Callable[[int, int], int]) -> tuple[int, int]:
    """Choose cells across and along each face for the closest count to the target.

    Parameters
    ----------
    triangles : int
        Target count.
    count : callable
        ``count(across, along)`` returns the triangles of the scene.
    """
    middle = math.isqrt(triangles // count(1, 1))
    pairs = [
        (across, along)
        for across in range(max(1, middle - 2), middle + 2)
        for along in range(across, across + max(4, across // 4) + 1)
    ]
    return min(pairs, key=lambda pair: abs(count(*pair) - triangles))

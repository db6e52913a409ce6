"""Rays for the teaching scene: a fan, and instructive cases."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

__all__ = ["FAN_ORIGIN", "NamedRay", "fan", "teaching_rays"]

#: Origin of the teaching scene's fan, in the empty middle.
FAN_ORIGIN = (9.3, 6.4)


class NamedRay(NamedTuple):
    """A ray in the plan.

    Attributes
    ----------
    name : str
    note : str
        What to look for.
    origin, direction : tuple of two float
    """

    name: str
    note: str
    origin: tuple[float, float]
    direction: tuple[float, float]


def fan(origin: tuple[float, float], count: int) -> list[NamedRay]:
    """Rays from one point in evenly spaced directions."""
    return [
        NamedRay(
            f"Fan, {round(360 * k / count)} degrees",
            "One of a fan of directions from the same point.",
            origin,
            (math.cos(2.0 * math.pi * k / count), math.sin(2.0 * math.pi * k / count)),
        )
        for k in range(count)
    ]


def _towards(
    name: str, note: str, origin: tuple[float, float], target: tuple[float, float]
) -> NamedRay:
    x, y = target[0] - origin[0], target[1] - origin[1]
    length = math.hypot(x, y)
    return NamedRay(name, note, origin, (x / length, y / length))


def teaching_rays() -> Sequence[NamedRay]:
    """The rays of the page."""
    return [
        _towards(
            "Across the field to the teapot",
            "Empty space first, then the crowded corner: the grid tests what the tree never "
            "visits.",
            (2.2, 5.1),
            (12.05, 4.25),
        ),
        _towards(
            "A long path through empty space",
            "In at one gate and out at the other: what is the cost of empty space?",
            (-0.6, 5.9),
            (16.6, 6.1),
        ),
        _towards(
            "A near miss of the teapot",
            "Through crowded cells without a hit, then to the wall behind them.",
            (7.9, 5.41),
            (12.05, 4.73),
        ),
        _towards(
            "Out of the teapot's handle",
            "The hit is close; the grid tests the whole teapot anyway.",
            (11.36, 4.06),
            (11.6, 4.2),
        ),
        _towards(
            "The hit lies behind the cell",
            "A long wall is listed in every cell that it crosses; its hit counts in one of them.",
            (3.2, 8.35),
            (6.79, 9.34),
        ),
        _towards(
            "Straight along an axis",
            "One component is zero: the ray crosses no plane of that axis.",
            (12.3, 9.4),
            (12.3, 1.0),
        ),
        _towards(
            "Misses everything",
            "The ray never enters the scene's box: every structure stops after set-up.",
            (-0.8, 11.95),
            (3.0, 12.6),
        ),
        *fan(FAN_ORIGIN, 6),
    ]

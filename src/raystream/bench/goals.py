"""Goals: how much faster than the best peer each ray set is to be, and whether it is."""

from __future__ import annotations

import statistics
from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple

from raystream.bench.results import BenchResult


class Goal(NamedTuple):
    """A goal for the scenes' ratios to the best peer.

    Parameters
    ----------
    median, least : float
    """

    median: float
    least: float


#: By ray set, over the default scenes; of points, over those of docs/decisions/0049.
GOALS: Mapping[str, Goal] = MappingProxyType(
    {
        "primary": Goal(2.0, 1.3),
        "image": Goal(2.0, 1.5),
        "shadow": Goal(1.5, 1.2),
        "ao": Goal(1.75, 1.2),
        "bounce": Goal(1.75, 1.2),
        "random": Goal(1.5, 1.1),
        "multi": Goal(10.0, 6.0),
        "closest": Goal(2.0, 2.0),
        "closest_near": Goal(2.0, 2.0),
        "closest_grid": Goal(2.0, 2.0),
    }
)


class Verdict(NamedTuple):
    """The ratios of a ray set to the best peer, and its goal.

    Parameters
    ----------
    name : str
    ratios : dict of str to float
        By scene.
    median, least, most : float
    worst_scene : str
    goal : Goal or None
    """

    name: str
    ratios: dict[str, float]
    median: float
    least: float
    most: float
    worst_scene: str
    goal: Goal | None

    @property
    def meets_median(self) -> bool:
        """Whether the median reaches its goal, or has none."""
        return self.goal is None or self.median >= self.goal.median

    @property
    def meets_least(self) -> bool:
        """Whether all scenes reach the least ratio, or there is none."""
        return self.goal is None or self.least >= self.goal.least


def judge(result: BenchResult, *, watertight: bool = False) -> list[Verdict]:
    """Compare the ratios of each set with its goal, over all scenes of a result.

    Parameters
    ----------
    result : BenchResult
    watertight : bool
        Whether to compare with the best of the watertight peers, not of all.

    Returns
    -------
    list of Verdict
        One for each set with a ratio, in the order of the result.
    """
    ratios: dict[str, dict[str, float]] = {}
    for scene in result.scenes:
        for rays in scene.sets:
            ratio = result.ratio(rays, watertight=watertight)
            if ratio is not None:
                ratios.setdefault(rays.name, {})[scene.scene] = ratio
    return [_verdict(name, one) for name, one in ratios.items()]


def _verdict(name: str, ratios: dict[str, float]) -> Verdict:
    worst = min(ratios, key=lambda scene: ratios[scene])
    values = ratios.values()
    return Verdict(
        name,
        ratios,
        statistics.median(values),
        ratios[worst],
        max(values),
        worst,
        GOALS.get(name),
    )

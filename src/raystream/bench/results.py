"""Results: a benchmark's measurements, and figures derived from them."""

from __future__ import annotations

import statistics
from dataclasses import asdict, dataclass, field
from typing import Any

from raystream.bench.agreement import Agreement
from raystream.bench.contenders.base import Query
from raystream.bench.memory import Memory

__all__ = [
    "AGREEMENT_LIMIT",
    "NO_QUERY",
    "BenchResult",
    "BuildResult",
    "SceneResult",
    "SetResult",
]

#: Reason for skipping a contender that lacks a query.
NO_QUERY = "does not support this query"

#: Larger shares of differing rays are flagged.
AGREEMENT_LIMIT = 1e-3


@dataclass
class BuildResult:
    """Build times and memory of a contender.

    Attributes
    ----------
    seconds : list of float
        From the user's arrays until the first ray can be traced, one per build.
    memory : Memory or None
        None if not measured.
    """

    seconds: list[float] = field(default_factory=list)
    memory: Memory | None = None

    @property
    def median(self) -> float:
        """Median of the seconds."""
        return statistics.median(self.seconds)


@dataclass
class SetResult:
    """Times and agreement of all contenders on one ray set.

    Attributes
    ----------
    name : str
    query : {"first", "any", "multi"}
    ray_count : int
    hit_count : int
        raystream's number of hits.
    seconds : dict of str to dict of str to list of float
        By contender and mode, one per round after the warm-up.
    agreement : dict of str to Agreement
        By contender, with raystream; the worst over all modes.
    failures : dict of str to str
        By contender: why it was skipped.
    """

    name: str
    query: Query
    ray_count: int
    hit_count: int = 0
    seconds: dict[str, dict[str, list[float]]] = field(default_factory=dict)
    agreement: dict[str, Agreement] = field(default_factory=dict)
    failures: dict[str, str] = field(default_factory=dict)

    def speed(self, label: str) -> float | None:
        """Millions of rays per second, by the median of the faster mode; None without figures."""
        medians = [statistics.median(times) for times in self.seconds.get(label, {}).values()]
        return self.ray_count / min(medians) / 1e6 if medians and min(medians) > 0.0 else None

    def best_mode(self, label: str) -> str:
        """The mode with the best median."""
        modes = self.seconds[label]
        return min(modes, key=lambda mode: statistics.median(modes[mode]))

    def best_peer(self, peers: list[str]) -> str | None:
        """The fastest of these contenders; None if none of them took part."""
        speeds = {label: speed for label in peers if (speed := self.speed(label)) is not None}
        return max(speeds, key=lambda label: speeds[label]) if speeds else None

    def ratio(self, label: str, other: str | None) -> float | None:
        """Speed relative to another contender; None if either did not take part."""
        if other is None or (own := self.speed(label)) is None:
            return None
        theirs = self.speed(other)
        return None if theirs is None else own / theirs

    @property
    def worst(self) -> Agreement | None:
        """The agreement with the contender that differs most."""
        return max(self.agreement.values(), default=None)


@dataclass
class SceneResult:
    """Results of one scene.

    Attributes
    ----------
    scene : str
        Its name as requested.
    triangle_count : int
    builds : dict of str to BuildResult
        By contender.
    sets : list of SetResult
    failures : dict of str to str
        By contender: why its build failed.
    """

    scene: str
    triangle_count: int
    builds: dict[str, BuildResult] = field(default_factory=dict)
    sets: list[SetResult] = field(default_factory=list)
    failures: dict[str, str] = field(default_factory=dict)


@dataclass
class BenchResult:
    """A benchmark's results, possibly partial if interrupted.

    Attributes
    ----------
    machine : dict
        See `describe_machine`.
    size : (int, int)
        Image width and height.
    repeats : int
        Rounds after the warm-up.
    own, peers : list of str
        Contenders that took part, in column order: raystream's configurations, the first of
        which is the numerator of ratios; and the peers.
    versions, notes : dict of str to str
        By contender.
    absent : dict of str to str
        By peer: why it is unavailable, and what to do.
    skipped : dict of str to str
        By scene: why it could not be loaded.
    scenes : list of SceneResult
    """

    machine: dict[str, Any]
    size: tuple[int, int]
    repeats: int
    own: list[str] = field(default_factory=list)
    peers: list[str] = field(default_factory=list)
    versions: dict[str, str] = field(default_factory=dict)
    notes: dict[str, str] = field(default_factory=dict)
    absent: dict[str, str] = field(default_factory=dict)
    skipped: dict[str, str] = field(default_factory=dict)
    scenes: list[SceneResult] = field(default_factory=list)

    @property
    def labels(self) -> list[str]:
        """All contenders that took part."""
        return [*self.own, *self.peers]

    def as_json(self) -> dict[str, Any]:
        """All raw measurements, and the figures derived from them."""
        raw = asdict(self)
        raw["size"] = list(self.size)
        raw["scenes"] = [self._scene_as_json(scene) for scene in self.scenes]
        return raw

    def _scene_as_json(self, scene: SceneResult) -> dict[str, Any]:
        return {
            "scene": scene.scene,
            "triangles": scene.triangle_count,
            "builds": {
                label: {
                    "seconds": build.seconds,
                    "median_seconds": build.median,
                    "memory": None if build.memory is None else build.memory._asdict(),
                }
                for label, build in scene.builds.items()
                if build.seconds
            },
            "failures": scene.failures,
            "sets": [self._set_as_json(rays) for rays in scene.sets],
        }

    def _set_as_json(self, rays: SetResult) -> dict[str, Any]:
        best = rays.best_peer(self.peers)
        return {
            "set": rays.name,
            "query": rays.query,
            "rays": rays.ray_count,
            "hits": rays.hit_count,
            "seconds": rays.seconds,
            "mrays_per_second": {label: rays.speed(label) for label in rays.seconds},
            "mode": {label: rays.best_mode(label) for label in rays.seconds},
            "best_peer": best,
            "ratio_to_best_peer": {label: rays.ratio(label, best) for label in self.own},
            "ratio_to_open3d": {label: rays.ratio(label, "open3d") for label in self.own},
            "agreement": {
                label: {**agreement._asdict(), "flagged": agreement.differing > AGREEMENT_LIMIT}
                for label, agreement in rays.agreement.items()
            },
            "failures": rays.failures,
        }

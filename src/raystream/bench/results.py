"""Results: a benchmark's measurements, and figures derived from them."""

from __future__ import annotations

import json
import statistics
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from raystream.bench.agreement import Agreement
from raystream.bench.contenders.base import Query
from raystream.bench.memory import Memory
from raystream.bench.roofline import Counts, Peaks, most_rays
from raystream.core.atomic_write import atomic_write

#: Version of the stored form; files of another version are refused.
SCHEMA = 1

#: Reason for skipping a contender that lacks a query.
NO_QUERY = "does not support this query"

#: Larger shares of differing rays are flagged.
AGREEMENT_LIMIT = 1e-3


@dataclass
class BuildResult:
    """Build times and memory of a contender.

    Attributes
    ----------
    start_seconds : float
        Before: import, a small build, and some rays.
    seconds : list of float
        From the user's arrays until the first ray can be traced, one per build.
    memory : Memory or None
        None if not measured.
    """

    start_seconds: float = 0.0
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
    query : {"first", "any", "multi", "closest"}
    ray_count : int
        Of rays or points.
    hit_count : int
        raystream's number of hits.
    counts : Counts or None
        Tests per ray; None if not counted.
    warm_up : dict of str to dict of str to float
        By contender and mode: seconds of the first call, which does not count.
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
    counts: Counts | None = None
    warm_up: dict[str, dict[str, float]] = field(default_factory=dict)
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
        """Agreement with the contender that differs most."""
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
        By contender: why it took no part, or no longer.
    is_complete : bool
        False while it is measured, or if that was interrupted.
    wall_seconds : float
        Duration of the whole scene.
    """

    scene: str
    triangle_count: int
    builds: dict[str, BuildResult] = field(default_factory=dict)
    sets: list[SetResult] = field(default_factory=list)
    failures: dict[str, str] = field(default_factory=dict)
    is_complete: bool = False
    wall_seconds: float = 0.0


@dataclass
class BenchResult:
    """A benchmark's results, possibly partial if interrupted.

    Attributes
    ----------
    machine : dict
        See `describe_machine`.
    date : str
        ISO date of the first measurement.
    settings : dict
        ``size`` (image width and height), ``sets``, ``repeats`` (rounds that count),
        ``warm_up_rounds``, ``seed``, and ``entries``: the label, name and options of each
        contender.
    peaks : Peaks or None
        None if not measured.
    own, peers : list of str
        Contenders that took part, in column order: raystream's configurations, the first of
        which is the numerator of ratios; and the peers.
    versions, notes : dict of str to str
        By contender.
    watertight : list of str
        Contenders that let no ray through the edge between two triangles.
    absent : dict of str to str
        By peer: why it is unavailable, and what to do.
    skipped : dict of str to str
        By scene: why it could not be loaded.
    scenes : list of SceneResult
    """

    machine: dict[str, Any]
    date: str
    settings: dict[str, Any]
    peaks: Peaks | None = None
    own: list[str] = field(default_factory=list)
    peers: list[str] = field(default_factory=list)
    versions: dict[str, str] = field(default_factory=dict)
    notes: dict[str, str] = field(default_factory=dict)
    watertight: list[str] = field(default_factory=list)
    absent: dict[str, str] = field(default_factory=dict)
    skipped: dict[str, str] = field(default_factory=dict)
    scenes: list[SceneResult] = field(default_factory=list)

    @property
    def labels(self) -> list[str]:
        """All contenders that took part."""
        return [*self.own, *self.peers]

    def ratio(self, rays: SetResult, *, watertight: bool = False) -> float | None:
        """Speed of raystream relative to the best peer's on a set, or the best watertight one's."""
        peers = [one for one in self.peers if not watertight or one in self.watertight]
        return rays.ratio(self.own[0], rays.best_peer(peers)) if self.own else None

    def share(self, rays: SetResult) -> float | None:
        """Speed of raystream relative to the set's roofline; None without figures or tests."""
        speed = rays.speed(self.own[0]) if self.own else None
        if speed is None or rays.counts is None or self.peaks is None:
            return None
        most = most_rays(self.peaks, rays.counts)
        return None if most is None else speed * 1e6 / most

    def as_json(self) -> dict[str, Any]:
        """All measurements, and under ``figures`` of each set those derived from them."""
        raw = {"schema": SCHEMA, **asdict(self)}
        raw["peaks"] = _fields(self.peaks)
        for scene, kept in zip(self.scenes, raw["scenes"], strict=True):
            for label, build in scene.builds.items():
                kept["builds"][label]["memory"] = _fields(build.memory)
            for rays, one in zip(scene.sets, kept["sets"], strict=True):
                one["counts"] = _fields(rays.counts)
                one["agreement"] = {name: a._asdict() for name, a in rays.agreement.items()}
                one["figures"] = self._figures(rays)
        return raw

    def _figures(self, rays: SetResult) -> dict[str, Any]:
        best = rays.best_peer(self.peers)
        return {
            "mrays_per_second": {label: rays.speed(label) for label in rays.seconds},
            "mode": {label: rays.best_mode(label) for label in rays.seconds},
            "best_peer": best,
            "ratio_to_best_peer": {label: rays.ratio(label, best) for label in self.own},
            "ratio_to_best_watertight_peer": self.ratio(rays, watertight=True),
            "share_of_roofline": self.share(rays),
        }

    @classmethod
    def from_json(cls, content: Any) -> BenchResult:
        """The result that was stored.

        Raises
        ------
        ValueError
            If it is no result of this `SCHEMA`.
        """
        if not isinstance(content, Mapping) or content.get("schema") != SCHEMA:
            raise ValueError(f"not a benchmark result of schema {SCHEMA}")
        try:
            raw = {key: value for key, value in content.items() if key != "schema"}
            peaks = None if raw["peaks"] is None else Peaks(**raw["peaks"])
            scenes = [_scene(one) for one in raw["scenes"]]
            return cls(**{**raw, "peaks": peaks, "scenes": scenes})
        except (KeyError, TypeError, AttributeError) as error:
            raise ValueError(f"a damaged benchmark result: {error}") from error


def write_result(path: Path, result: BenchResult) -> None:
    """Write a result as JSON; the file is complete or stays as it was.

    Raises
    ------
    OSError
        If the file cannot be written.
    """
    text = json.dumps(result.as_json(), indent=1, allow_nan=False)
    with atomic_write(path) as part:
        part.write_text(text + "\n", encoding="utf-8")


def read_result(path: Path) -> BenchResult:
    """Read a result.

    Raises
    ------
    OSError
        If the file cannot be read.
    ValueError
        If it holds no result.
    """
    return BenchResult.from_json(json.loads(path.read_text(encoding="utf-8")))


def _fields(one: Memory | Counts | Peaks | None) -> dict[str, Any] | None:
    return None if one is None else one._asdict()


def _scene(raw: Mapping[str, Any]) -> SceneResult:
    builds = {label: _build(one) for label, one in raw["builds"].items()}
    return SceneResult(**{**raw, "builds": builds, "sets": [_set(one) for one in raw["sets"]]})


def _build(raw: Mapping[str, Any]) -> BuildResult:
    memory = None if raw["memory"] is None else Memory(**raw["memory"])
    return BuildResult(**{**raw, "memory": memory})


def _set(raw: Mapping[str, Any]) -> SetResult:
    raw = {key: value for key, value in raw.items() if key != "figures"}
    counts = None if raw["counts"] is None else Counts(**raw["counts"])
    agreement = {label: Agreement(**one) for label, one in raw["agreement"].items()}
    return SetResult(**{**raw, "counts": counts, "agreement": agreement})

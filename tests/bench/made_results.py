"""Results of a benchmark, made by hand."""

from __future__ import annotations

from raystream.bench.agreement import Agreement
from raystream.bench.memory import Memory
from raystream.bench.results import BenchResult, BuildResult, SceneResult, SetResult
from raystream.bench.roofline import Counts, Peaks


def made(**ratios: dict[str, float]) -> BenchResult:
    """A result with these ratios to the best peer, by scene and set."""
    settings = {"size": [8, 6], "sets": [], "repeats": 1, "warm_up_rounds": 1, "seed": 0}
    result = BenchResult({"cpu": "abacus", "threads": 2}, "2026-01-02", settings)
    result.own, result.peers = ["raystream"], ["best", "worst"]
    result.watertight = ["raystream", "worst"]
    result.peaks = Peaks(1e9, 5e8, 1e8)
    for name, sets in ratios.items():
        scene = SceneResult(name, 12, is_complete=True)
        scene.builds["raystream"] = BuildResult(0.5, [0.25, 0.5, 0.75], Memory(100, 200))
        scene.builds["best"] = BuildResult(0.1, [0.5])
        for kind, ratio in sets.items():
            seconds = {"raystream": {"": [1.0]}, "best": {"": [ratio]}, "worst": {"": [9 * ratio]}}
            rays = SetResult(kind, "first", 1_000_000, 500_000, seconds=seconds)
            rays.agreement["best"] = Agreement(0.25, 400_000)
            rays.counts = Counts(5.0, 2.0, 0.5)
            scene.sets.append(rays)
        result.scenes.append(scene)
    return result

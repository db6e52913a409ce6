"""Table 1: milliseconds for the primary rays of four scenes, and their counts."""

from __future__ import annotations

import statistics
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from raystream.core.query import Kind, Query
from raystream.core.rays import RayBatch
from raystream.kernels.local_frame import LocalRays
from raystream.machines import Branching, MultipassBackend
from raystream.structures import Structure
from raystream_lab.as_published.brute_force import BruteForce
from raystream_lab.foley.other_views import (
    ViewCosts,
    kernel_runs,
    other_views,
    other_views_table,
)
from raystream_lab.foley.paper_figures import brute_prices
from raystream_lab.foley.scenes import (
    PATIENCE,
    SCENES,
    SIZE,
    available_views,
    foley_structures,
    mean_counts,
    trace_counters,
)
from raystream_lab.foley.time_claims import time_claims
from raystream_lab.kernels.snapshots import local_rays
from raystream_lab.published import published
from raystream_lab.results import (
    NOT_EXPLAINED,
    Cell,
    Plot,
    Result,
    Series,
    Table,
    comparison,
    is_near,
)
from raystream_lab.runner import Runner
from raystream_lab.timing import time_in_turn
from raystream_lab.views import View

#: The structures of Table 1; a stack and a BVH for reference.
STRUCTURES = ("brute", "grid", "restart", "backtrack", "stack", "bvh")

#: Divisor of the image size for brute force, which tests every triangle for every ray.
_BRUTE_SHARE = 8

#: Warmed up with a few rays only.
_SLOW = ("brute", "grid")

#: Scenes of at most this many triangles are traced by brute force on the multipass machine.
_FEW_TRIANGLES = 100

#: Structures traced by the multipass machine.
_MULTIPASS = ("grid", "restart", "backtrack")

#: Times and counts of a scene, by structure.
Found = dict[str, dict[str, Any]]


def structure_times(runner: Runner) -> Result:
    """Table 1 on both machines, and by counts."""
    result = Result()
    times: Found = {}
    multipass: Found = {}
    counts: Found = {}
    triangles: dict[str, int] = {}
    views: dict[str, ViewCosts] = {}
    for name, view in available_views(runner, tuple(SCENES)[: 3 if runner.quick else None], result):
        scene = _Scene(runner, name, view)
        times[name] = runner.measure(f"{name}, branching, {scene.size} x {scene.size}", scene.times)
        counts[name] = runner.measure(f"{name}, counts, {scene.size} x {scene.size}", scene.counts)
        key = f"{name}, multipass, {scene.size} x {scene.size}"
        multipass[name] = runner.measure(key, scene.multipass)
        triangles[name] = view.scene.triangle_count
        if name != "cornell":
            views[name] = other_views(runner, name, view)
    if not times:
        return result
    both = {"branching": times, "multipass": multipass}
    result.tables = [
        _scene_table(triangles, runner.size(SIZE)),
        _table_1(both, runner.size(SIZE)),
        _relative_table(both, counts, views),
        _count_table(counts),
    ]
    if views:
        result.tables.append(other_views_table(views))
    if runner.quick:
        result.notes.append("Quick: too few rays for meaningful times.")
    result.plots = [_plot(times, counts)]
    result.claims = time_claims(both, counts, triangles)
    return result


class _Scene:
    """A scene with all its structures, built on first use."""

    def __init__(self, runner: Runner, name: str, view: View) -> None:
        self.runner, self.name, self.view = runner, name, view
        self.size = runner.size(SIZE)
        self._built: dict[str, Structure] = {}

    def structures(self) -> dict[str, Structure]:
        """By the names of `STRUCTURES`."""
        if not self._built:
            self._built = foley_structures(self.view.scene, self.name, self.runner.progress)
        return self._built

    def batch(self, structure: str) -> RayBatch:
        """The rays for a structure."""
        share = _BRUTE_SHARE if structure == "brute" else 1
        return RayBatch(*self.view.rays(max(8, self.size // share)), 0.0, np.inf)

    def times(self) -> Found:
        """Times of each structure on the branching machine."""
        calls = {}
        few = RayBatch(*self.view.rays(8), 0.0, np.inf)
        for name, structure in self.structures().items():
            batch = self.batch(name)
            _tracing(structure, few if name in _SLOW else batch)()  # compiles it
            calls[name] = _tracing(structure, batch)
        return self._timed(calls, 2 if self.runner.quick else 5)

    def multipass(self) -> Found:
        """Times on the multipass machine with Foley's scheduler."""
        few = RayBatch(*self.view.rays(8), 0.0, np.inf)
        calls = {}
        for name in _MULTIPASS:
            machine = MultipassBackend(self.structures()[name], scheduler="double")
            _tracing(machine, few)()
            calls[name] = _tracing(machine, self.batch(name))
        if self.view.scene.triangle_count <= _FEW_TRIANGLES:
            calls["brute"] = self._brute_passes()
        return self._timed(calls, 1 if self.runner.quick else 3)

    def _brute_passes(self) -> Callable[[], object]:
        """Brute force in one pass over all rays per triangle, as Foley's."""
        triangles = self.view.scene.triangles
        batch = self.batch("brute")
        rays = local_rays(self.structures()["brute"], batch.origins, batch.directions)
        BruteForce(triangles, LocalRays(*(column[:8] for column in rays))).run()  # compiles it
        return BruteForce(triangles, rays).run

    def _timed(self, calls: Mapping[str, Callable[[], object]], rounds: int) -> Found:
        """``best`` and ``median`` seconds of each structure, its ``rounds`` and ``rays``."""
        return {
            name: {
                "best": min(seconds),
                "median": statistics.median(seconds),
                "rounds": len(seconds),
                "rays": len(self.batch(name)),
            }
            for name, seconds in time_in_turn(calls, rounds, patience=PATIENCE).items()
        }

    def counts(self) -> dict[str, dict[str, float]]:
        """Mean counts per ray."""
        found = {}
        for name, structure in self.structures().items():
            rays = self.view.rays(max(8, self.size // (_BRUTE_SHARE if name == "brute" else 1)))
            found[name] = mean_counts(trace_counters(structure, *rays))
        return found


def _tracing(machine: Structure | MultipassBackend, batch: RayBatch) -> Callable[[], object]:
    backend = Branching(machine) if isinstance(machine, Structure) else machine
    return lambda: backend.answer(Query(Kind.FIRST_HIT), batch)


def _milliseconds(each: Mapping[str, Any], kind: str = "best") -> float:
    """Milliseconds for an image of Foley's size."""
    return float(each[kind]) / each["rays"] * SIZE**2 * 1e3


def _scene_table(triangles: Mapping[str, int], size: int) -> Table:
    theirs = published("foley", "scenes").values
    rows: list[tuple[str, Cell, Cell, str]] = []
    for name, count in triangles.items():
        why = "" if theirs[name]["triangles"] == count else "another model"
        rows.append((f"{name}: triangles", theirs[name]["triangles"], count, why))
    return comparison(
        "foley-scenes",
        f"The scenes: {published('foley', 'scenes').source}",
        rows,
        "Grids have 2 cells along each axis in the Cornell box, 50 elsewhere. Cameras are the "
        f"scenes' own (BART's: the first frame), {size} x {size} rays; the paper's images are not "
        "in our copy.",
    )


def _table_1(both: Mapping[str, Found], size: int) -> Table:
    theirs = published("foley", "table 1").values
    rows: list[Sequence[Cell]] = []
    for name, each in both["branching"].items():
        for structure in STRUCTURES:
            old = theirs[name].get(structure)
            own = _milliseconds(each[structure])
            passes = both["multipass"][name].get(structure)
            slow = None if passes is None else _milliseconds(passes)
            rows.append(
                [name, structure, old, own, None if old is None else own / old]
                + [_milliseconds(each[structure], "median"), each[structure]["rounds"]]
                + [slow, None if old is None or slow is None else slow / old]
            )
    return Table.of(
        "foley-table-1",
        f"Milliseconds to trace primary rays: {published('foley', 'table 1').source}",
        ["scene", "structure", "published", "ours, branching", "ratio", "median", "rounds"]
        + ["ours, multipass", "its ratio"],
        rows,
        f"Times are scaled to 512 x 512 rays; {size} x {size} were traced, by brute force "
        f"{_BRUTE_SHARE} times fewer along each side. They are the best of several rounds in which "
        "structures take turns; the multipass machine, with Foley's scheduler, has up to 3. The "
        "hardware differs, so compare structures with each other, as in the next table.",
        "Brute force on the multipass machine is Foley's: one pass over all rays per triangle, "
        "whose corners are constants of the kernel, with the test of Möller and Trumbore. It is "
        "timed only in the Cornell box.",
    )


def _relative_table(
    both: Mapping[str, Found], counts: Found, views: Mapping[str, ViewCosts]
) -> Table:
    theirs = published("foley", "table 1").values
    prices = brute_prices()
    rows: list[Sequence[Cell]] = []
    for name, each in both["branching"].items():
        for structure in ("brute", "grid", "restart", "stack", "bvh"):
            old = theirs[name].get(structure)
            old = None if old is None else old / theirs[name]["backtrack"]
            own = _milliseconds(each[structure]) / _milliseconds(each["backtrack"])
            work = _work(counts[name][structure]) / _work(counts[name]["backtrack"])
            passes = both["multipass"][name]
            slow = None
            if structure in passes:
                slow = _milliseconds(passes[structure]) / _milliseconds(passes["backtrack"])
            why = f"steps and tests x {work:.3g}, time of each x {own / work:.3g}"
            if structure == "brute":
                why += f"; published x {prices.shortfall(name):.3g} at section 3's rate"
            if structure == "grid" and name in views and old is not None:
                why += f"; {_other_view(views[name], old)}"
            what = f"{structure} / backtrack"
            ratios = [
                None if one is None or old is None else one / old for one in (own, slow, work)
            ]
            rows.append([name, what, old, own, ratios[0], slow, ratios[1], work, ratios[2], why])
    return Table.of(
        "foley-relative",
        "Comparison of structures: times over kd-backtrack's",
        ["scene", "structure", "published", "ours, branching", "ratio", "ours, multipass"]
        + ["its ratio", "ours, by counts", "their ratio", "why they differ"],
        rows,
        "By counts: cells and tests of a grid, or steps down and up and tests of a tree, over the "
        "steps and tests of backtrack. Why they differ: the product of the two factors is the "
        "ratio of times on the branching machine. Other views: the view in which the ratio of "
        "kernel runs to backtrack's is nearest to the published ratio of times.",
    )


def _other_view(views: ViewCosts, published_ratio: float) -> str:
    """Whether another view of a scene has the published ratio of grid and backtrack."""
    ratios = {view: each["grid"] / each["backtrack"] for view, each in views.items()}
    nearest = min(ratios, key=lambda view: abs(ratios[view] - published_ratio))
    told = f"view {nearest} gives x {ratios[nearest]:.3g}"
    if is_near(ratios[nearest], published_ratio):
        return told
    return f"{NOT_EXPLAINED} by {len(ratios)} other views: {told}"


def _work(each: Mapping[str, float]) -> float:
    return each["steps"] + each["tests"]


def _count_table(counts: Found) -> Table:
    rows = [
        [name, structure, one["steps"], one["leaves"], one["tests"], _work(one)]
        + [kernel_runs(structure, one)]
        for name, each in counts.items()
        for structure, one in each.items()
    ]
    return Table.of(
        "foley-counts-per-ray",
        "Work per primary ray",
        ["scene", "structure", "steps", "leaves", "tests", "steps and tests"] + ["kernel runs"],
        rows,
        "Steps: cells of a grid; splits descended and nodes climbed to in a kd-tree; inner nodes "
        "of a BVH. Kernel runs: steps and tests; Foley's kd-trees also run Leaf and Continue per "
        "leaf.",
    )


def _plot(times: Found, counts: Found) -> Plot:
    names = list(times)
    theirs = published("foley", "table 1").values
    grid = [_milliseconds(e["grid"]) / _milliseconds(e["backtrack"]) for e in times.values()]
    work = [_work(e["grid"]) / _work(e["backtrack"]) for e in counts.values()]
    old = [theirs[name]["grid"] / theirs[name]["backtrack"] for name in names]
    return Plot(
        "foley-grid-over-kdtree",
        "The grid over kd-backtrack: below 1 the grid is better",
        "",
        "grid / backtrack",
        [
            Series("published times", list(names), list(old)),
            Series("our times, branching", list(names), list(grid)),
            Series("our counts", list(names), list(work)),
        ],
        kind="bars",
        log_y=True,
        marks={"equal": 1.0},
    )

"""Table 1: milliseconds for the primary rays of four scenes, beside what rays meet."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from raystream.core.query import Kind, Query
from raystream.core.rays import RayBatch
from raystream.lab.foley.claims import time_claims
from raystream.lab.foley.elsewhere import (
    Elsewhere,
    elsewhere,
    elsewhere_table,
    kernel_runs,
    lead,
)
from raystream.lab.foley.scenes import SCENES, SIZE, counted, foley_trees, known_views
from raystream.lab.foley.timing import Timed, timed_in_turn
from raystream.lab.laboratory import Laboratory
from raystream.lab.published import published
from raystream.lab.results import Cell, Plot, Result, Series, Table, comparison
from raystream.lab.views import View
from raystream.machines import Branching, MultipassBackend
from raystream.structures import Structure, build_structure

__all__ = ["structure_times"]

#: Those of Table 1, and for orientation a stack and a BVH.
STRUCTURES = ("brute", "grid", "restart", "backtrack", "stack", "bvh")

#: Brute force takes one test of each triangle for each ray: a picture of so much less width and
#: height takes so much less time.
_BRUTE_SHARE = 8

#: A few rays suffice to warm them up.
_SLOW = ("brute", "grid")

#: What the machine that runs one step at a time traces.
_STEPWISE = ("grid", "restart", "backtrack")

#: Times and counts of a scene, by structure.
Found = dict[str, dict[str, Any]]


def structure_times(lab: Laboratory) -> Result:
    """Table 1 on both machines, and the same by counts."""
    result = Result()
    times: Found = {}
    stepwise: Found = {}
    counts: Found = {}
    triangles: dict[str, int] = {}
    views: dict[str, Elsewhere] = {}
    for name, view in known_views(lab, tuple(SCENES)[: 3 if lab.quick else None], result):
        scene = _Scene(lab, name, view)
        times[name] = lab.measure(f"{name}, branching, {scene.size} x {scene.size}", scene.times)
        counts[name] = lab.measure(f"{name}, counts, {scene.size} x {scene.size}", scene.counts)
        key = f"{name}, multipass, {scene.size} x {scene.size}"
        stepwise[name] = lab.measure(key, scene.stepwise)
        triangles[name] = view.scene.triangle_count
        if name != "cornell":
            views[name] = elsewhere(lab, name, view)
    if not times:
        return result
    both = {"branching": times, "multipass": stepwise}
    result.tables = [
        _scene_table(triangles, lab.size(SIZE)),
        _table_1(both, lab.size(SIZE)),
        _relative_table(both, counts, views),
        _count_table(counts),
    ]
    if views:
        result.tables.append(elsewhere_table(views))
    if lab.quick:
        result.notes.append("Quick: so few rays that times say nothing.")
    result.plots = [_plot(times, counts)]
    result.claims = time_claims(both, counts, triangles)
    return result


class _Scene:
    """A scene with all its structures, built when something is measured."""

    def __init__(self, lab: Laboratory, name: str, view: View) -> None:
        self.lab, self.name, self.view = lab, name, view
        self.size = lab.size(SIZE)
        self._built: dict[str, Structure] = {}

    def structures(self) -> dict[str, Structure]:
        """By the names of `STRUCTURES`."""
        if not self._built:
            scene, progress = self.view.scene, self.lab.progress
            resolution = published("foley", "scenes").values[self.name]["resolution"]
            made = {
                "brute": build_structure("brute", scene.triangles),
                "grid": build_structure("grid", scene.triangles, resolution=resolution),
                "bvh": build_structure("bvh", scene.triangles, progress=progress),
                **foley_trees(scene, progress),
            }
            self._built = {name: made[name] for name in STRUCTURES}
        return self._built

    def batch(self, structure: str) -> RayBatch:
        """The rays that a structure traces."""
        share = _BRUTE_SHARE if structure == "brute" else 1
        return RayBatch(*self.view.rays(max(8, self.size // share)), 0.0, np.inf)

    def times(self) -> dict[str, Timed]:
        """Seconds a ray of each structure."""
        calls = {}
        few = RayBatch(*self.view.rays(8), 0.0, np.inf)
        for name, structure in self.structures().items():
            batch = self.batch(name)
            _tracing(structure, few if name in _SLOW else batch)()  # compiles it
            calls[name] = _tracing(structure, batch)
        found = timed_in_turn(calls, 2 if self.lab.quick else 5)
        for name, each in found.items():
            each["rays"] = len(self.batch(name))
        return found

    def stepwise(self) -> dict[str, Timed]:
        """Seconds that the multipass machine takes, with Foley's scheduler."""
        few = RayBatch(*self.view.rays(8), 0.0, np.inf)
        calls = {}
        for name in _STEPWISE:
            machine = MultipassBackend(self.structures()[name], scheduler="double")
            _tracing(machine, few)()
            calls[name] = _tracing(machine, self.batch(name))
        found = timed_in_turn(calls, 1 if self.lab.quick else 3)
        for name, each in found.items():
            each["rays"] = len(self.batch(name))
        return found

    def counts(self) -> dict[str, dict[str, float]]:
        """What a ray meets on the average."""
        found = {}
        for name, structure in self.structures().items():
            rays = self.view.rays(max(8, self.size // (_BRUTE_SHARE if name == "brute" else 1)))
            counters = counted(structure, *rays)
            total, count = counters.total, counters.steps.size
            found[name] = {
                "steps": (total["steps"] + total["backtrack_steps"]) / count,
                "leaves": total["leaves"] / count,
                "tests": total["tests"] / count,
            }
        return found


def _tracing(machine: Structure | MultipassBackend, batch: RayBatch) -> Callable[[], object]:
    backend = Branching(machine) if isinstance(machine, Structure) else machine
    return lambda: backend.answer(Query(Kind.FIRST_HIT), batch)


def _milliseconds(each: Mapping[str, Any], kind: str = "best") -> float:
    """Of a picture of Foley's size."""
    return float(each[kind]) / each["rays"] * SIZE**2 * 1e3


def _scene_table(triangles: Mapping[str, int], size: int) -> Table:
    theirs = published("foley", "scenes").values
    rows: list[tuple[str, Cell, Cell, str]] = []
    for name, count in triangles.items():
        why = "another model of the same box" if name == "cornell" else "another model"
        same = theirs[name]["triangles"] == count
        rows.append((f"{name}: triangles", theirs[name]["triangles"], count, "" if same else why))
    return comparison(
        "foley-scenes",
        f"The scenes: {published('foley', 'scenes').source}",
        rows,
        f"Grids have 2 cells along each axis of the Cornell box, and 50 elsewhere. Cameras are "
        f"the scenes' own (BART's: the first frame), {size} x {size} rays; the paper's pictures "
        "are not in our copy.",
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
        f"Scaled to 512 x 512 rays; {size} x {size} were traced, by brute force "
        f"{_BRUTE_SHARE} times fewer along each side. Best of the rounds, in which "
        "structures take turns; the multipass machine, with Foley's scheduler, has up to 3. Times "
        "are of different hardware: compare structures with each other, in the next table.",
        "Brute force is left out on the multipass machine: it would take as many passes as "
        "a scene has triangles, each over all rays.",
    )


def _relative_table(
    both: Mapping[str, Found], counts: Found, views: Mapping[str, Elsewhere]
) -> Table:
    theirs = published("foley", "table 1").values
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
            if structure == "grid" and name in views:
                leads = sorted(lead(each) for each in views[name].values())
                why += f"; other views x {leads[0]:.3g} to {leads[-1]:.3g}"
            what = f"{structure} / backtrack"
            ratios = [
                None if one is None or old is None else one / old for one in (own, slow, work)
            ]
            rows.append([name, what, old, own, ratios[0], slow, ratios[1], work, ratios[2], why])
    return Table.of(
        "foley-relative",
        "Times over kd-backtrack's: how structures compare",
        ["scene", "structure", "published", "ours, branching", "ratio", "ours, multipass"]
        + ["its ratio", "ours, by counts", "their ratio", "why they differ"],
        rows,
        "By counts: cells and tests of a grid, or steps down and up and tests of a tree, over "
        "the steps and tests of backtrack. Why: the branching machine's times are the "
        "product. Other views: kernel runs over those of the better kd-tree, see below.",
    )


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
        "foley-counts-a-ray",
        "What a primary ray meets",
        ["scene", "structure", "steps", "leaves", "tests", "steps and tests"] + ["kernel runs"],
        rows,
        "Steps: cells of a grid; splits gone down at and nodes climbed to of a kd-tree; inner "
        "nodes of a BVH. Kernel runs: Foley's kd-trees run Leaf and Continue for each leaf, too.",
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

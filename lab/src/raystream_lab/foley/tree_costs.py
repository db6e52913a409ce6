"""The cost of a step relative to a test in building trees (Foley 2005, section 3.2)."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from raystream.core.query import Kind, Query
from raystream.core.rays import RayBatch
from raystream.machines import Branching, MultipassBackend
from raystream.structures.kdtree.structure import KdTreeStructure
from raystream_lab.foley.scenes import (
    PATIENCE,
    SIZE,
    TRAVERSALS,
    available_views,
    count_states,
    foley_trees,
    trace_counters,
)
from raystream_lab.published import published
from raystream_lab.results import Cell, Claim, Plot, Result, Series, Table, listed
from raystream_lab.runner import Runner
from raystream_lab.timing import time_in_turn
from raystream_lab.views import View

#: Costs of a step; a test costs 1.
COSTS = (0.25, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0)

#: Divisor of the image size: each image is traced dozens of times.
_SHARE = 2

#: A tree is called good if its time is within this share of the best.
_GOOD = 0.1

#: By cost, as text.
Found = dict[str, dict[str, Any]]


def tree_costs(runner: Runner) -> Result:
    """Steps, tests, passes and times of trees built for other costs."""
    result = Result()
    found: dict[str, Found] = {}
    names = ("robots",) if runner.quick else ("bunny", "robots", "kitchen")
    costs = COSTS[::4] + COSTS[5:6] if runner.quick else COSTS
    for name, view in available_views(runner, names, result):
        found[name] = _sweep(runner, name, view, sorted(costs))
    if not found:
        return result
    size = runner.size(SIZE) // _SHARE
    result.tables = [_cost_table(found, size), _best_table(found)]
    if runner.quick:
        result.notes.append("Quick: too few rays for meaningful times.")
    for name, each in found.items():
        result.plots += [_time_plot(name, each), _count_plot(name, each)]
    result.claims = _claims(found)
    return result


def _sweep(runner: Runner, name: str, view: View, costs: Sequence[float]) -> Found:
    size = max(16, runner.size(SIZE) // _SHARE)

    def measure() -> Found:
        trees = {
            f"{c:g}": foley_trees(view.scene, runner.progress, traversal_cost=c) for c in costs
        }
        rays = view.rays(size)
        found = {cost: _counts(each, rays) for cost, each in trees.items()}
        times = _times(trees, RayBatch(*rays, 0.0, np.inf), 2 if runner.quick else 5)
        for cost, each in found.items():
            each["times"] = times[cost]
        return found

    value: Found = runner.measure(f"{name}, {size} x {size}", measure)
    return value


def _counts(trees: Mapping[str, KdTreeStructure], rays: Any) -> dict[str, Any]:
    """Counts per ray, passes, and properties of the tree."""
    sums = count_states(dict(trees), *rays)
    count = sums["stack"]["rays"]
    passes = trace_counters(MultipassBackend(trees["backtrack"], scheduler="double"), *rays).passes
    assert passes is not None
    quality = trees["stack"].quality()
    return {
        "steps": {t: (s["steps"] + s["backtrack_steps"]) / count for t, s in sums.items()},
        "tests": sums["stack"]["tests"] / count,
        "leaves": sums["stack"]["leaves"] / count,
        "passes": len(passes),
        "efficiency": passes.efficiency,
        "depth": quality["depth"],
        "leaf size": quality["references"] / (quality["leaves"] - quality["empty leaves"]),
    }


def _times(
    trees: Mapping[str, Mapping[str, KdTreeStructure]], batch: RayBatch, rounds: int
) -> dict[str, dict[str, float]]:
    """Milliseconds by cost and traversal, timed in turn."""

    def tracing(tree: KdTreeStructure) -> Callable[[], object]:
        backend = Branching(tree)
        return lambda: backend.answer(Query(Kind.FIRST_HIT), batch)

    calls = {
        f"{cost} {traversal}": tracing(tree)
        for cost, each in trees.items()
        for traversal, tree in each.items()
    }
    found = time_in_turn(calls, rounds, patience=PATIENCE)
    return {cost: {t: 1e3 * min(found[f"{cost} {t}"]) for t in TRAVERSALS} for cost in trees}


def _cost_table(found: Mapping[str, Found], size: int) -> Table:
    rows = [
        [name, float(cost), one["depth"], one["leaf size"], *(one["steps"][t] for t in TRAVERSALS)]
        + [one["leaves"], one["tests"], one["passes"], one["efficiency"]]
        + [one["times"][t] for t in TRAVERSALS]
        for name, each in found.items()
        for cost, one in each.items()
    ]
    return Table.of(
        "foley-costs",
        f"Trees built for other costs; {size} x {size} rays",
        ["scene", "cost of a step", "depth", "triangles in a leaf"]
        + [f"steps, {t}" for t in TRAVERSALS]
        + ["leaves", "tests", "passes", "efficiency"]
        + [f"ms, {t}" for t in TRAVERSALS],
        rows,
        "A test costs 1. Steps, leaves and tests per ray; triangles per non-empty leaf; passes and "
        "efficiency of the multipass machine with backtrack and Foley's scheduler; best "
        "milliseconds on the branching machine, with all trees in turn.",
    )


def _best(each: Found, traversal: str) -> str:
    return min(each, key=lambda cost: float(each[cost]["times"][traversal]))


def _best_table(found: Mapping[str, Found]) -> Table:
    theirs = published("foley", "claims").values["traversal_cost"]
    rows: list[Sequence[Cell]] = []
    for name, each in found.items():
        for traversal in TRAVERSALS:
            best = _best(each, traversal)
            here = each[f"{theirs:g}"]["times"][traversal]
            rows.append(
                [name, traversal, theirs, float(best), float(best) / theirs]
                + [here / each[best]["times"][traversal]]
            )
    return Table.of(
        "foley-best-cost",
        "The cost with the best time",
        ["scene", "traversal", "published", "ours", "ratio", "time at the published / best"],
        rows,
        "The cost of a step is given in tests. Times are flat near the optimum, so its position is "
        "less certain than the loss at the published cost.",
    )


def _time_plot(name: str, each: Found) -> Plot:
    x = [float(cost) for cost in each]
    return Plot(
        f"foley-cost-times-{name}",
        f"{name}: time against the tree's cost of a step",
        "cost of a step, in tests",
        "milliseconds",
        [Series(t, x, [one["times"][t] for one in each.values()]) for t in TRAVERSALS],
        log_x=True,
    )


def _count_plot(name: str, each: Found) -> Plot:
    x = [float(cost) for cost in each]
    lines = [Series(f"steps, {t}", x, [e["steps"][t] for e in each.values()]) for t in TRAVERSALS]
    return Plot(
        f"foley-cost-counts-{name}",
        f"{name}: steps and tests per ray",
        "cost of a step, in tests",
        "per ray",
        [*lines, Series("tests", x, [one["tests"] for one in each.values()])],
        log_x=True,
        log_y=True,
    )


def _claims(found: Mapping[str, Found]) -> list[Claim]:
    cost = f"{published('foley', 'claims').values['traversal_cost']:g}"
    lost = {
        f"{name} {t}": each[cost]["times"][t] / each[_best(each, t)]["times"][t] - 1.0
        for name, each in found.items()
        for t in TRAVERSALS
    }
    even = "1" if all("1" in each for each in found.values()) else "0.25"
    flat = {
        f"{name} {what}": (each[cost][what] > each[even][what]) == grows
        for name, each in found.items()
        for what, grows in (("depth", False), ("leaf size", True))
    }
    efficiency = {
        name: (each[even]["efficiency"], each[cost]["efficiency"]) for name, each in found.items()
    }
    source = "Foley 2005, section 3.2"
    return [
        Claim.judged(
            f"A cost of {cost} per step makes good trees: within a tenth of the best time",
            source,
            {case: share <= _GOOD for case, share in lost.items()},
            "slower than the best by " + listed(lost, ".0%"),
        ),
        Claim.judged(
            f"It makes trees shallower and leaves fuller than a cost of {even}",
            source,
            flat,
            "; ".join(
                f"{name}: depth {each[even]['depth']:.0f} and {each[cost]['depth']:.0f}, "
                f"{each[even]['leaf size']:.3g} and {each[cost]['leaf size']:.3g} triangles"
                for name, each in found.items()
            ),
        ),
        Claim.judged(
            f"It makes rays more coherent: passes run on more rays than with a cost of {even}",
            source,
            {name: after > before for name, (before, after) in efficiency.items()},
            "; ".join(f"{name} {a:.1%} and {b:.1%}" for name, (a, b) in efficiency.items()),
        ),
    ]

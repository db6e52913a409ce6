"""Grid resolution: steps against tests, and which grid is cheapest (Purcell 2002, section 4.1)."""

from __future__ import annotations

import itertools
import math
from typing import Any

from raystream_lab.cost_model import cost, prices
from raystream_lab.published import published
from raystream_lab.purcell.image_counts import (
    ImageCounts,
    count_image,
    counts_of,
    grid_of,
    grid_options,
    grid_tracer,
)
from raystream_lab.results import Cell, Claim, Plot, Result, Series, Table
from raystream_lab.runner import Runner
from raystream_lab.views import PURCELL_VIEWS, View

#: Cells along the shortest axis of the scene's box.
RESOLUTIONS = (8, 16, 24, 32, 48, 64, 96, 128, 160)

#: Grids with more cells are skipped: building them takes a gigabyte.
_MAX_CELLS = 140_000_000

_SIZE = 256

#: Counts by the minimum cells along an axis.
Sweep = dict[int, ImageCounts]


def resolution_sweep(runner: Runner, view: View) -> Sweep:
    """Steps and tests of a view on grids from coarse to fine."""
    size = min(_SIZE, runner.size(_SIZE))
    sweep: Sweep = {}
    for least in RESOLUTIONS[:5] if runner.quick else RESOLUTIONS:
        low, high = view.scene.bounds
        extent = high - low
        if math.prod(extent / extent.min() * least) > _MAX_CELLS:
            continue

        def measure(least: int = least) -> ImageCounts:
            tracer = grid_tracer(runner, view, min_resolution=least)
            return {
                **count_image(tracer, view, size),
                "cells": math.prod(grid_of(tracer).lattice.counts),
            }

        name = f"{view.name}, {least} cells, {size} x {size}"
        sweep[least] = runner.measure(name, measure, shared=True)
    return sweep


def grid_resolution(runner: Runner) -> Result:
    """Sweep the resolution of each view's grid."""
    result = Result()
    rows: list[list[Cell]] = []
    monotone: dict[str, bool] = {}
    balanced: dict[str, bool] = {}
    shares = []
    for name, view in result.available(PURCELL_VIEWS, runner.view):
        sweep = resolution_sweep(runner, view)
        costs = {least: _instructions(values) for least, values in sweep.items()}
        best = min(costs, key=lambda least: sum(costs[least]))
        chosen = _paper_resolution(runner, view)
        for least, values in sweep.items():
            steps, tests = costs[least]
            rows.append(
                [
                    name,
                    least,
                    values["cells"],
                    values["v"],
                    values["t"],
                    steps,
                    tests,
                    steps + tests,
                    "cheapest" if least == best else "the paper's" if least == chosen else "",
                ]
            )
        ordered = [sweep[least] for least in sorted(sweep)]
        monotone[name] = all(
            a["v"] <= b["v"] and a["t"] >= b["t"] for a, b in itertools.pairwise(ordered)
        )
        if chosen in costs:
            steps, tests = costs[chosen]
            balanced[name] = 0.5 <= steps / tests <= 2.0
            shares.append(f"{name}: traversal {steps / tests:.2f} of intersection")
        result.plots.append(_plot(name, sweep, costs))
    place = published("purcell", "grids").source
    result.tables = [
        Table.of(
            "purcell-resolution",
            "Grids from coarse to fine; instructions per ray by Table 1 (branching)",
            ["view", "least cells", "cells", "v", "t", "traversal", "intersection", "both", ""],
            rows,
            "Least cells: those along the shortest axis of the scene's box, as in the paper.",
        )
    ]
    result.claims = [
        Claim.judged(
            "A finer grid gives fewer tests and more steps",
            place,
            monotone,
            _listed("not throughout: ", monotone) or f"throughout, in all {len(monotone)} views",
        ),
        Claim.judged(
            "At the paper's resolutions, traversal and intersection take about equal time (here: "
            "instructions, within a factor of two)",
            place,
            balanced,
            "; ".join(shares),
        ),
    ]
    return result


def _paper_resolution(runner: Runner, view: View) -> int:
    options: dict[str, Any] = grid_options(view, runner.quick)
    return int(options.get("min_resolution") or min(options["resolution"]))


def _instructions(values: ImageCounts) -> tuple[float, float]:
    """Instructions of a ray's steps and tests."""
    found = cost(counts_of(values), prices("branching")).instructions
    return found["step"] / values["rays"], found["intersect"] / values["rays"]


def _listed(before: str, cases: dict[str, bool]) -> str:
    missing = [name for name, held in cases.items() if not held]
    return before + ", ".join(missing) if missing else ""


def _plot(name: str, sweep: Sweep, costs: dict[int, tuple[float, float]]) -> Plot:
    x = sorted(sweep)
    return Plot(
        f"purcell-resolution-{name.replace(' ', '-')}",
        f"{name}: instructions per ray, by the grid's resolution",
        "cells along the shortest axis",
        "instructions per ray",
        [
            Series("traversal", list(x), [costs[least][0] for least in x]),
            Series("intersection", list(x), [costs[least][1] for least in x]),
            Series("both", list(x), [sum(costs[least]) for least in x]),
        ],
        log_x=True,
        log_y=True,
    )

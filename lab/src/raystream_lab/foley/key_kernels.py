"""Words, dependent fetches and bandwidth of the key kernels (Foley 2005, Table 3)."""

from __future__ import annotations

from typing import Any

import numpy as np

from raystream.core.errors import RaystreamError
from raystream.machines.steps import Steps
from raystream.scene.procedural.cornell import cornell
from raystream.structures.grid.structure import GridStructure
from raystream.structures.kdtree.structure import KdTreeStructure
from raystream.tracer import Tracer
from raystream_lab.as_published.brute_force import brute_steps
from raystream_lab.as_published.grid_kernels import grid_steps
from raystream_lab.as_published.kdtree_kernels import kdtree_steps
from raystream_lab.foley.sensitivity import is_near
from raystream_lab.foley.settings import PBRT_BONUS
from raystream_lab.kernels.bandwidth import KernelSpeed, copy_bandwidth, kernel_speeds
from raystream_lab.kernels.costs import KernelCost, cost_of, kernel_costs
from raystream_lab.kernels.snapshots import local_rays
from raystream_lab.published import published
from raystream_lab.results import Cell, Claim, Plot, Result, Series, Table, listed
from raystream_lab.runner import Runner

_SIZE = 512

#: Foley's structures; the kitchen's rays, as in section 4.2.
KEY_STRUCTURES: dict[str, dict[str, Any]] = {
    "brute": {},
    "grid": {"resolution": 50},
    "kdtree": {
        "traversal": "backtrack",
        "layout": "foley",
        "traversal_cost": 8.0,
        "empty_bonus": PBRT_BONUS,
    },
}

KERNEL_NAMES = {
    ("brute", "intersect"): "brute intersect",
    ("grid", "traverse"): "grid traverse",
    ("grid", "intersect"): "grid intersect",
    ("kdtree", "down"): "kd down",
    ("kdtree", "up"): "kd up",
    ("kdtree", "intersect"): "kd intersect",
}

_QUICK_RUNS = 20


def key_kernels(runner: Runner) -> Result:
    """Table 3, and which kernels are memory-bound."""
    result = Result()
    rows: list[list[Cell]] = []
    speeds: list[list[Cell]] = []
    bound: dict[str, bool] = {}
    runs = _QUICK_RUNS if runner.quick else published("foley", "claims").values["kernel_runs"]
    size = runner.size(_SIZE)
    for structure, options in KEY_STRUCTURES.items():
        try:
            found = _measure(runner, structure, options, size, runs)
        except RaystreamError as error:
            result.notes.append(f"the kitchen's kernels are omitted: {error}")
            return result
        for kernel, one in found.items():
            name = KERNEL_NAMES[structure, kernel]
            theirs = published("foley", "table 3").values[name]
            rows += _rows(name, theirs, one)
            speeds.append(
                [
                    name,
                    one["nanoseconds"],
                    one["bandwidth"] / 1e9,
                    theirs["gigabytes_per_second"],
                    one["fetch_bandwidth"] / 1e9,
                    one["ratio"],
                    "memory" if one["is_bound"] else "arithmetic",
                    theirs["waits_for"],
                ]
            )
            bound[name] = one["is_bound"] == (theirs["waits_for"] == "memory")
    copying = runner.measure("copying", lambda: copy_bandwidth() / 1e9)
    source = published("foley", "table 3").source
    result.tables = [
        Table.of(
            "foley-table-3",
            f"Reads and writes of a kernel per ray: {source}",
            ["quantity", "published", "ours", "ratio", "why they differ"],
            rows,
            "Floats in: words that a pass reads from the ray's record and from the scene, each "
            "once. The paper gives their sum. Dependent fetches: loads from the scene whose "
            "address depends on an earlier read; the paper counts texture fetches of up to 4 "
            "floats.",
        ),
        _published_table(runner, rows),
        Table.of(
            "foley-bandwidth",
            f"{runs} runs of each kernel on the kitchen's rays, {size} x {size}, interleaved with "
            "fetch-only versions",
            [
                "kernel",
                "ns per ray",
                "GB/s",
                "published GB/s",
                "fetch-only, GB/s",
                "full / fetch-only time",
                "waits for",
                "published: waits for",
            ],
            speeds,
            f"Copying an array reaches {copying:.3g} GB/s here. Foley's rule: a kernel that takes "
            "as long as its fetch-only version waits for memory. Here, up to a quarter longer "
            "counts as equally long.",
            "Each run processes all rays that waited for the kernel in its busiest pass; none is "
            "masked.",
        ),
    ]
    result.claims = [
        Claim.judged(
            "Only the kd-tree's Down waits for arithmetic, all others for memory",
            "Foley 2005, section 4.2",
            bound,
            "full over fetch-only time: " + ", ".join(f"{row[0]} {row[5]:.2f}" for row in speeds),
        ),
        _highest_claim({str(row[0]): float(row[2] or 0.0) for row in speeds}),
    ]
    result.plots = [
        Plot(
            "foley-bandwidth",
            "Bandwidth of the key kernels",
            "",
            "GB/s",
            [
                Series("full", [row[0] for row in speeds], [_number(row[2]) for row in speeds]),
                Series(
                    "fetch-only", [row[0] for row in speeds], [_number(row[4]) for row in speeds]
                ),
            ],
            "bars",
            marks={"copying an array": copying},
        )
    ]
    return result


def _highest_claim(bandwidths: dict[str, float]) -> Claim:
    """Judge that Up reaches the highest bandwidth, against each of the other kernels."""
    up = bandwidths["kd up"]
    return Claim.judged(
        "The kd-tree's Up reaches the highest bandwidth (against each of the others)",
        "Foley 2005, section 4.2 and Table 3",
        {name: up > one for name, one in bandwidths.items() if name != "kd up"},
        "GB/s: " + listed(bandwidths),
    )


def _number(cell: Cell) -> float | None:
    return float(cell) if isinstance(cell, int | float) else None


def _measure(
    runner: Runner, structure: str, options: dict[str, Any], size: int, runs: int
) -> dict[str, dict[str, Any]]:
    """Figures of a structure's key kernels, by kernel."""

    def measure() -> dict[str, dict[str, Any]]:
        view = runner.view("kitchen")
        built = runner.tracer(view, structure, **options).structure
        costs = {one.kernel: one for one in kernel_costs(built)}
        rays = local_rays(built, *view.rays(size))
        return {
            one.kernel: {
                **_figures(one),
                "code": costs[one.kernel].code.total,
                "dependent": costs[one.kernel].dependent_loads,
            }
            for one in kernel_speeds(built, rays, runs=runs)
        }

    name = f"{structure} in the kitchen, {size} x {size}, {runs} runs"
    found: dict[str, dict[str, Any]] = runner.measure(name, measure)
    return found


def _figures(one: KernelSpeed) -> dict[str, Any]:
    return {
        "rays": one.ray_count,
        "in": one.words_in,
        "fetched": one.words_fetched,
        "out": one.words_out,
        "nanoseconds": float(np.median(one.seconds)) / one.ray_count * 1e9,
        "bandwidth": one.bandwidth,
        "fetch_bandwidth": one.fetch_bandwidth,
        "ratio": one.ratio,
        "is_bound": one.is_bandwidth_bound(),
    }


def _published_table(runner: Runner, ours: list[list[Cell]]) -> Table:
    """Table 3 of kernels with the records and the triangle test of the papers."""
    found = runner.measure("kernels as published", _published_kernels)
    own = {row[0]: row[2] for row in ours}
    rows: list[list[Cell]] = []
    near = {"ours": 0, "as published": 0}
    for name, one in found.items():
        theirs = published("foley", "table 3").values[name]
        for what, key in _QUANTITIES.items():
            before, after = own.get(f"{name}: {what}"), one[key]
            value = theirs[key]
            near["ours"] += isinstance(before, int) and _is_close(before, value)
            near["as published"] += _is_close(after, value)
            ratio = after / value if value else None
            rows.append([f"{name}: {what}", value, before, after, ratio])
    return Table.of(
        "foley-table-3-as-published",
        f"The same with kernels as published: {published('foley', 'table 3').source}",
        ["quantity", "published", "ours", "as published, here", "ratio"],
        rows,
        f"Within a quarter: {near['ours']} of {len(rows)} with our kernels, "
        f"{near['as published']} with those as published.",
        "As published: the packed records of Figure 6, whose sign bits hold a ray's state; one "
        "triangle per run, by Möller and Trumbore (Purcell 2002, Figure 5); brute force with the "
        "triangle in constants. Floats in and out count the fields that the code reads and writes. "
        "The paper's instructions work on vectors of 4 numbers, ours on scalars.",
    )


#: Quantities of Table 3, and their published names.
_QUANTITIES = {
    "instructions": "instructions",
    "floats in": "floats_in",
    "floats out": "floats_out",
    "dependent fetches": "dependent_fetches",
}


def _is_close(ours: float, theirs: float) -> bool:
    return ours == theirs if theirs == 0 else is_near(ours, theirs)


def _published_kernels() -> dict[str, dict[str, int]]:
    """Costs of the kernels in `as_published`, by the names of Table 3."""
    grid = Tracer(cornell(), "grid", **KEY_STRUCTURES["grid"]).structure
    tree = Tracer(cornell(), "kdtree", **KEY_STRUCTURES["kdtree"]).structure
    assert isinstance(grid, GridStructure)
    assert isinstance(tree, KdTreeStructure)
    costs = {"brute intersect": cost_of(brute_steps(), 0)}
    for structure, steps in (("grid", grid_steps(grid)), ("kdtree", kdtree_steps(tree))):
        costs |= _named(structure, steps)
    return {
        name: {
            "instructions": one.code.total,
            "floats_in": one.used_in + one.fetched_words,
            "floats_out": one.used_out,
            "dependent_fetches": one.dependent_loads,
        }
        for name, one in costs.items()
    }


def _named(structure: str, steps: Steps) -> dict[str, KernelCost]:
    return {
        KERNEL_NAMES[structure, one.name]: cost_of(steps, number)
        for number, one in enumerate(steps.kernels)
        if (structure, one.name) in KERNEL_NAMES
    }


def _rows(name: str, theirs: dict[str, float], one: dict[str, Any]) -> list[list[Cell]]:
    parts = f"{one['in']} of the ray, {one['fetched']} of the scene"
    at_once = "; 4 triangles at a time" if name == "kd intersect" else ""
    given = (
        ("instructions", theirs["instructions"], one["code"], "LLVM's, all branches" + at_once),
        ("floats in", theirs["floats_in"], one["in"] + one["fetched"], parts + at_once),
        ("floats out", theirs["floats_out"], one["out"], "with the state"),
        ("dependent fetches", theirs["dependent_fetches"], one["dependent"], "of a word or more"),
    )
    return [
        [f"{name}: {what}", published_, ours, ours / published_ if published_ else None, why]
        for what, published_, ours, why in given
    ]

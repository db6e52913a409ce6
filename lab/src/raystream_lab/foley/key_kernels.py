"""Words, dependent fetches and bandwidth of the key kernels (Foley 2005, Table 3)."""

from __future__ import annotations

from typing import Any

import numpy as np

from raystream.core.errors import RaystreamError
from raystream_lab.kernels.bandwidth import KernelSpeed, copy_bandwidth, kernel_speeds
from raystream_lab.kernels.costs import kernel_costs
from raystream_lab.kernels.snapshots import local_rays
from raystream_lab.published import published
from raystream_lab.results import Cell, Claim, Plot, Result, Series, Table
from raystream_lab.runner import Runner

__all__ = ["KERNEL_NAMES", "KEY_STRUCTURES", "key_kernels"]

_SIZE = 512

#: Foley's structures; the kitchen's rays, as in section 4.2.
KEY_STRUCTURES: dict[str, dict[str, Any]] = {
    "brute": {},
    "grid": {"resolution": 50},
    "kdtree": {"traversal": "backtrack", "layout": "foley", "traversal_cost": 8.0},
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
        Table.of(
            "foley-bandwidth",
            f"{runs} runs of each kernel on the kitchen's rays, {size} x {size}, in turn with "
            "versions that only fetch",
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
            "as long as its fetch-only version waits for memory. As long: up to a quarter more, "
            "our choice.",
            "All rays that waited for the kernel in its busiest pass take part; none is masked.",
        ),
    ]
    result.claims = [
        Claim.judged(
            "Only the kd-tree's Down waits for arithmetic, all others for memory",
            "Foley 2005, section 4.2",
            bound,
            "full over fetch-only time: " + ", ".join(f"{row[0]} {row[5]:.2f}" for row in speeds),
        )
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

"""Table 2 on a device: rays in each state, counted by the kernels that ran on them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from typing import Any

from raystream.core.errors import RaystreamError
from raystream.structures.kdtree.structure import KdTreeStructure
from raystream.tracer import Tracer
from raystream_lab.agreement import Row, agreement_claim, agreement_table
from raystream_lab.foley.scenes import (
    SIZE,
    TRAVERSALS,
    available_views,
    figures_of,
    foley_trees,
    published_figures,
)
from raystream_lab.foley.sensitivity import is_near
from raystream_lab.foley.state_counts import COUNTED
from raystream_lab.published import published
from raystream_lab.results import Cell, Claim, Result, Table, comparison
from raystream_lab.runner import Runner
from raystream_lab.views import View

#: Traversals without a stack, which multipass machines step through.
_STACKLESS = ("restart", "backtrack")

#: Titles of the figures of Table 2.
_TITLES = {
    "down": "backtrack: Down",
    "up": "backtrack: Up",
    "restart down": "restart: Down",
    "intersect": "Intersect",
    "transitions": "Trans.",
}

#: Counters, kernel runs and passes of a scene, by side and traversal.
_Found = dict[str, dict[str, dict[str, Any]]]


def count_kernel_runs(tree: KdTreeStructure, view: View, rays: Any, device: str) -> dict[str, Any]:
    """Trace rays by passes, and count the rays that each kernel ran on.

    Parameters
    ----------
    tree : KdTreeStructure
    view : View
    rays : tuple of ndarray
        Origins and directions.
    device : str

    Returns
    -------
    dict
        ``rays``; the ray counters; ``passes``, ``efficiency``; ``runs`` and ``kernel passes``,
        by kernel.

    Raises
    ------
    RaystreamError
        If the device cannot trace it.
    """
    tracer = Tracer.of_structure(
        tree, view.scene, device, machine="multipass", scheduler="double", counters=True
    )
    tracer.first_hit(*rays)
    counters = tracer.counters
    assert counters.passes is not None
    runs: Counter[str] = Counter()
    kernel_passes: Counter[str] = Counter()
    for one in counters.passes:
        runs[one.kernel] += one.run_count
        kernel_passes[one.kernel] += 1
    return {
        "rays": counters.steps.size,
        **counters.total,
        "passes": len(counters.passes),
        "efficiency": counters.passes.efficiency,
        "runs": dict(runs),
        "kernel passes": dict(kernel_passes),
    }


def counts_on_device(runner: Runner) -> Result:
    """Ray states by the device's counters and by its kernels' runs, against the CPU's."""
    result = Result()
    size = runner.device_size(SIZE)
    found: dict[str, _Found] = {}
    for name, view in available_views(runner, COUNTED[: 1 if runner.quick else None], result):
        try:
            found[name] = _measure(runner, name, view, size)
        except RaystreamError as error:
            result.notes.append(f"{name} is left out: {error}")
    if not found:
        return result
    counts = [row for name, each in found.items() for row in _count_rows(name, each)]
    result.tables = [
        _table_2(runner, found, size),
        _kernel_table(found),
        agreement_table(
            "foley-device-states",
            f"Ray states and passes: the device's against the CPU's, {size} x {size} rays",
            runner.device,
            counts,
        ),
    ]
    result.claims = [*_claims(runner, found), agreement_claim(runner.device, counts)]
    return result


def _measure(runner: Runner, name: str, view: View, size: int) -> _Found:
    def measure() -> _Found:
        trees = foley_trees(view.scene, runner.progress)
        rays = view.rays(size)
        found: _Found = {"cpu": {}, "device": {}}
        for traversal in _STACKLESS:
            for side, device in (("cpu", "cpu"), ("device", runner.device)):
                found[side][traversal] = count_kernel_runs(trees[traversal], view, rays, device)
        for side, device in (("cpu", "cpu"), ("device", runner.device)):
            tracer = Tracer.of_structure(trees[TRAVERSALS[0]], view.scene, device, counters=True)
            tracer.first_hit(*rays)
            found[side][TRAVERSALS[0]] = {"rays": rays[1].size // 3, **tracer.counters.total}
        return found

    found: _Found = runner.measure(f"{name}, {size} x {size}", measure)
    return found


def _table_2(runner: Runner, found: Mapping[str, _Found], size: int) -> Table:
    rows: list[tuple[str, Cell, Cell, str]] = []
    for name, each in found.items():
        theirs = published_figures(name)
        cpu, ours = figures_of(each["cpu"]), figures_of(each["device"])
        for key, title in _TITLES.items():
            why = f"the CPU counts {cpu[key]:.4g}; for causes, see foley-counts on the CPU"
            near = is_near(ours[key], theirs[key])
            rows.append((f"{name}, {title}", theirs[key], ours[key], "" if near else why))
    return comparison(
        "foley-table-2",
        f"Rays in each state, in millions: {published('foley', 'table 2').source}; {size} x "
        f"{size} rays",
        rows,
        runner.facts.note,
        "Counted by the device on the multipass machine, and scaled to 512 x 512 rays. Backtrack's "
        "Down omits the run after each climb, as Foley's does.",
    )


def _kernel_table(found: Mapping[str, _Found]) -> Table:
    rows: list[list[Cell]] = [
        [name, traversal, kernel, runs, runs / one["rays"], one["kernel passes"][kernel]]
        for name, each in found.items()
        for traversal in _STACKLESS
        for one in [each["device"][traversal]]
        for kernel, runs in one["runs"].items()
    ]
    return Table.of(
        "foley-kernel-runs",
        "Rays that each kernel ran on, and its passes",
        ["scene", "traversal", "kernel", "runs", "per ray", "passes"],
        rows,
        "The device counts the rays that wait before each pass. A run of our Intersect tests a "
        "block of up to four triangles, so there are fewer runs than Foley has tests; runs of Leaf "
        "are Foley's transitions.",
    )


def _count_rows(name: str, each: _Found) -> list[Row]:
    rows: list[Row] = []
    for traversal, ours in each["device"].items():
        cpu = each["cpu"][traversal]
        for key, value in cpu.items():
            if isinstance(value, dict):
                rows += [
                    (f"{name}, {traversal}: {key} of {kernel}", count, ours[key].get(kernel, 0))
                    for kernel, count in value.items()
                ]
            elif key != "rays" and value:
                rows.append((f"{name}, {traversal}: {key.replace('_', ' ')}", value, ours[key]))
    return rows


def _claims(runner: Runner, found: Mapping[str, _Found]) -> list[Claim]:
    limits = published("foley", "claims").values
    section = "Foley 2005, section 4.1"
    figures = {name: figures_of(each["device"]) for name, each in found.items()}
    restart = {name: one["restart down"] / one["down"] for name, one in figures.items()}
    backtrack = {name: 1.0 + one["up"] / one["down"] for name, one in figures.items()}
    return [
        Claim.judged(
            f"{what} takes less than {limit} times a stack's steps",
            section,
            {name: ratio < limit for name, ratio in ratios.items()},
            f"on {runner.device}: " + "; ".join(f"{name} {r:.3g}" for name, r in ratios.items()),
        )
        for what, limit, ratios in (
            ("kd-restart", limits["restart_over_stack"], restart),
            ("kd-backtrack", limits["backtrack_over_stack"], backtrack),
        )
    ]

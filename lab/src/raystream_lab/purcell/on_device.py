"""Purcell's ray tracer on a current device: passes, draws and time (2002, section 3).

His simulators counted the work of such hardware; this runs on the device.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np

from raystream.core.hits import Hits
from raystream.tracer import Tracer
from raystream_lab.devices import CUDA_PASSES
from raystream_lab.published import published
from raystream_lab.purcell.image_counts import SIZE, grid_options
from raystream_lab.purcell.scene_statistics import paper_view
from raystream_lab.results import Cell, Claim, Result, Table, comparison
from raystream_lab.runner import Runner
from raystream_lab.timing import median_times
from raystream_lab.views import PURCELL_VIEWS

#: Rounds in which contenders take turns, and the total seconds after which a slow one leaves.
_ROUNDS, _PATIENCE = 3, 10.0

#: The reference for the hits and passes of the others.
_REFERENCE = "cpu, multipass"

#: Relative difference of passes that are called equal in a claim, and of figures in the text.
_SAME, _NEAR = 0.001, 0.25

_Found = dict[str, dict[str, Any]]


def contenders(device: str, fast: str) -> dict[str, dict[str, Any]]:
    """Options of the tracers that are compared, by name.

    Parameters
    ----------
    device : str
    fast : str
        The device's machine that traces a ray from start to end.
    """
    unroll = published("purcell", "unrolling").values
    unrolled = {name: unroll[name] for name in ("traversal_steps", "intersections")}
    passes = {"device": device, "machine": "multipass"}
    return {
        f"{device}, multipass": passes,
        f"{device}, multipass, naive": {**passes, "scheduler": "naive"},
        f"{device}, multipass, unrolled": {**passes, **unrolled},
        f"{device}, branching": {"device": device, "machine": "branching"},
        f"{device}, {fast}": {"device": device, "machine": fast},
        _REFERENCE: {"machine": "multipass"},
        f"{_REFERENCE}, naive": {"machine": "multipass", "scheduler": "naive"},
        "cpu, branching": {},
    }


def on_device(runner: Runner) -> Result:
    """Hits, passes, draws and times of each machine, compared with the CPU's."""
    result = Result()
    device, size = runner.device, runner.device_size(SIZE)
    views = PURCELL_VIEWS[::3] if runner.quick else PURCELL_VIEWS
    found = dict(result.available(views, lambda name: _measure(runner, name, size)))
    result.tables = [
        _machines_table(runner, found, size),
        _passes_table(f"{device}, multipass", found, size),
    ]
    passes: dict[str, bool] = {}
    ratios: dict[str, float] = {}
    for name, each in found.items():
        for way in ("multipass", "multipass, naive"):
            ours, cpu = each[f"{device}, {way}"]["passes"], each[f"cpu, {way}"]["passes"]
            passes[f"{name}, {way}"] = abs(ours / cpu - 1.0) <= _SAME
        slow, fast = (each[f"{device}, {way}"] for way in ("multipass", runner.fast_machine))
        ratios[name] = slow["seconds"] / fast["seconds"]
    if found:
        result.claims = [
            Claim.judged(
                f"{device} takes as many passes as the simulated machine, within one in a thousand",
                published("purcell", "table 2").source,
                passes,
                "; ".join(f"not {case}" for case, held in passes.items() if not held) or "all",
            ),
            Claim.judged(
                "One program with loops is faster than passes (read as: times of machine "
                f"{runner.fast_machine})",
                published("purcell", "table 1").source,
                {name: ratio > 1.0 for name, ratio in ratios.items()},
                ", ".join(f"{name} {ratio:.3g} times" for name, ratio in ratios.items()),
            ),
        ]
    return result


def _machines_table(runner: Runner, found: dict[str, _Found], size: int) -> Table:
    rows: list[list[Cell]] = [
        [
            name,
            contender,
            *(one[key] for key in ("passes", "draws", "efficiency", "seconds")),
            size * size / one["seconds"] / 1e6,
            one["other_hits"],
            one["farthest"],
        ]
        for name, each in found.items()
        for contender, one in each.items()
    ]
    return Table.of(
        "purcell-machines",
        f"Primary rays on machines of {runner.device} and the CPU, {size} x {size}",
        ["view", "machine", "passes", "draws", "rays active in a pass", "seconds"]
        + ["million rays/s", "rays with other triangles", "largest difference in t, of t"],
        rows,
        runner.facts.note,
        "Draws: those encoded; if a graphics device chooses the kernel, the draws of the others "
        "are empty. Seconds: medians of rounds in which all machines take turns, including the "
        "transfer of rays and hits. Unrolled: steps and tests per pass as in section 4.2.",
        "Other triangles and differences in t: compared with the CPU's multipass machine.",
        CUDA_PASSES,
    )


def _passes_table(contender: str, found: dict[str, _Found], size: int) -> Table:
    """Table 2 by the device's own passes."""
    rows: list[tuple[str, Cell, Cell, str]] = []
    for name, each in found.items():
        theirs = published("purcell", "table 2").values[paper_view(name)]
        ours, cpu = each[contender], each[_REFERENCE]
        for what, key, own in (
            ("passes", "total", "passes"),
            ("traversal passes", "traversal", "traverse"),
            ("intersection passes", "intersection", "intersect"),
            ("SIMD efficiency", "efficiency", "efficiency"),
        ):
            is_near = abs(ours[own] / theirs[key] - 1.0) <= _NEAR
            why = f"the CPU's machine has {cpu[own]:.4g}; for causes, see purcell-passes on the CPU"
            rows.append((f"{name}: {what}", theirs[key], ours[own], "" if is_near else why))
    return comparison(
        "purcell-table-2",
        f"Passes on the device: {published('purcell', 'table 2').source}; threshold 20 %, {size} x "
        f"{size}",
        rows,
        "The scenes, grids and cameras are those of the CPU's experiments, and so are the causes "
        "of differences: models that replace unpublished ones, and cameras that are not known. In "
        "images of other sizes than 1024 x 1024 pixels, the longest rays, which bound the passes, "
        "are different ones.",
    )


def _measure(runner: Runner, name: str, size: int) -> _Found:
    """Each contender's passes, draws and time, and its difference from the reference."""

    def measure() -> _Found:
        view = runner.view(name)
        rays = view.rays(size)
        grid = Tracer(view.scene, "grid", **grid_options(view, runner.quick)).structure
        options = contenders(runner.device, runner.fast_machine)

        def tracer(one: str, counters: bool) -> Tracer:
            return Tracer.of_structure(grid, view.scene, counters=counters, **options[one])

        answers = {one: _counted(tracer(one, True), rays) for one in options}
        reference = answers[_REFERENCE][0]
        calls = {one: partial(tracer(one, False).first_hit, *rays) for one in options}
        rounds = 1 if runner.quick else _ROUNDS
        seconds = median_times(calls, rounds, warm_up=not runner.quick, patience=_PATIENCE)
        return {
            one: {**figures, **_differences(hits, reference), "seconds": seconds[one]}
            for one, (hits, figures) in answers.items()
        }

    values: _Found = runner.measure(f"{name}, {size} x {size}", measure)
    return values


def _counted(tracer: Tracer, rays: Any) -> tuple[Hits, dict[str, Any]]:
    """Hits, passes, draws and efficiency."""
    hits = tracer.first_hit(*rays)
    passes = tracer.counters.passes
    if passes is None:
        return hits, dict.fromkeys(("passes", "draws", "efficiency"))
    return hits, {
        "passes": len(passes),
        "draws": passes.draw_count or None,
        "efficiency": passes.efficiency,
        "traverse": passes.of("traverse"),
        "intersect": passes.of("intersect"),
    }


def _differences(hits: Hits, reference: Hits) -> dict[str, float]:
    """Rays that hit another triangle, and the maximum relative difference in t of the others."""
    is_other = hits.prim_id != reference.prim_id
    both = hits.is_hit & ~is_other
    t, expected = hits.t[both].astype(np.float64), reference.t[both].astype(np.float64)
    farthest = np.abs(t - expected) / np.maximum(np.abs(expected), np.finfo(np.float32).tiny)
    return {"other_hits": int(is_other.sum()), "farthest": float(farthest.max(initial=0.0))}

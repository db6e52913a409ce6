"""Purcell's ray tracer on a current graphics pipeline: passes, draws and time (2002, section 3).

His simulators counted the work of such hardware; this runs on the available adapter.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from types import MappingProxyType
from typing import Any

import numpy as np

from raystream.core.hits import Hits
from raystream.graphics.adapters import open_device
from raystream.tracer import Tracer
from raystream_lab.published import published
from raystream_lab.purcell.image_counts import grid_options
from raystream_lab.results import Cell, Claim, Result, Table
from raystream_lab.runner import Runner
from raystream_lab.timing import median_times
from raystream_lab.views import PURCELL_VIEWS, View

__all__ = ["SIZE", "adapter_note", "on_graphics"]

#: Width and height: a quarter of his, since the adapter may be software.
SIZE = 256

#: Rounds in which contenders take turns, and the total seconds after which a slow one leaves.
_ROUNDS, _PATIENCE = 3, 10.0

#: Options of the tracer by contender.
_CONTENDERS: Mapping[str, dict[str, Any]] = MappingProxyType(
    {
        "graphics, multipass": {"device": "graphics", "machine": "multipass"},
        "graphics, multipass, naive": {
            "device": "graphics",
            "machine": "multipass",
            "scheduler": "naive",
        },
        "graphics, multipass, unrolled": {"device": "graphics", "machine": "multipass"},
        "graphics, branching": {"device": "graphics", "machine": "branching"},
        "graphics, compute": {"device": "graphics", "machine": "compute"},
        "cpu, multipass": {"machine": "multipass"},
        "cpu, multipass, naive": {"machine": "multipass", "scheduler": "naive"},
        "cpu, branching": {},
    }
)

#: The reference for the hits and passes of the others.
_REFERENCE = "cpu, multipass"


def on_graphics(runner: Runner) -> Result:
    """Hits, passes, draws and times of each machine, compared with the CPU's."""
    result = Result()
    size = runner.size(SIZE)
    rows: list[list[Cell]] = []
    equal: dict[str, bool] = {}
    ratios: dict[str, float] = {}
    for name, found in result.available(PURCELL_VIEWS, lambda name: _measure(runner, name, size)):
        reference = found[_REFERENCE]
        for contender, one in found.items():
            rays = size * size
            rows.append(
                [
                    name,
                    contender,
                    one["passes"],
                    one["draws"],
                    one["efficiency"],
                    one["seconds"],
                    rays / one["seconds"] / 1e6,
                    one["other_hits"],
                    one["farthest"],
                ]
            )
        near = {
            contender: abs(found[contender]["passes"] / other["passes"] - 1.0) <= 0.001
            for contender, other in (
                ("graphics, multipass", reference),
                ("graphics, multipass, naive", found["cpu, multipass, naive"]),
            )
        }
        equal |= {f"{name}, {contender}": held for contender, held in near.items()}
        passes, compute = found["graphics, multipass"], found["graphics, compute"]
        ratios[name] = passes["seconds"] / compute["seconds"]
    result.tables = [
        Table.of(
            "purcell-graphics",
            f"Primary rays on the graphics pipeline, {size} x {size}",
            [
                "view",
                "machine",
                "passes",
                "draws",
                "rays active in a pass",
                "seconds",
                "million rays/s",
                "rays with other triangles",
                "farthest t, of t",
            ],
            rows,
            adapter_note(),
            "Draws: those encoded; where the device chooses the kernel, draws of the others are "
            "empty. Seconds: medians of rounds in which all take turns, including the transfer "
            "of rays and hits. Unrolled: steps and tests per pass as in section 4.2.",
            "Other triangles, and t: compared with the CPU's multipass machine.",
        )
    ]
    if equal:
        result.claims = [
            Claim.judged(
                "The graphics pipeline takes as many passes as the simulated machine, within one "
                "in a thousand",
                published("purcell", "table 2").source,
                equal,
                "; ".join(f"not {case}" for case, held in equal.items() if not held) or "all",
            ),
            Claim.judged(
                "One program with loops is faster than passes (read as: times of the compute "
                "shader)",
                published("purcell", "table 1").source,
                {name: ratio > 1.0 for name, ratio in ratios.items()},
                ", ".join(f"{name} {ratio:.3g} times" for name, ratio in ratios.items()),
            ),
        ]
    return result


def adapter_note() -> str:
    """Describe the adapter, and whether it is software."""
    adapter = open_device().adapter
    kind = "software: its times are not those of GPUs" if adapter.kind == "CPU" else adapter.kind
    return f"Adapter: {adapter.name}, {adapter.backend}, {adapter.description} ({kind})."


def _measure(runner: Runner, name: str, size: int) -> dict[str, dict[str, Any]]:
    """Each contender's passes, draws and time, and its difference from the reference."""

    def measure() -> dict[str, dict[str, Any]]:
        view = runner.view(name)
        rays = view.rays(size)
        answers = {one: _counted(runner, view, one, rays) for one in _CONTENDERS}
        reference = answers[_REFERENCE][0]
        seconds = _seconds(runner, view, rays)
        return {
            one: {**figures, **_differences(hits, reference), "seconds": seconds[one]}
            for one, (hits, figures) in answers.items()
        }

    values: dict[str, dict[str, Any]] = runner.measure(f"{name}, {size} x {size}", measure)
    return values


def _tracer(runner: Runner, view: View, contender: str, counters: bool) -> Tracer:
    options = {**_CONTENDERS[contender], **grid_options(view, runner.quick)}
    if contender.endswith("unrolled"):
        values = published("purcell", "unrolling").values
        options["traversal_steps"] = values["traversal_steps"]
        options["intersections"] = values["intersections"]
    return Tracer(view.scene, "grid", counters=counters, **options)


def _counted(runner: Runner, view: View, contender: str, rays: Any) -> tuple[Hits, dict[str, Any]]:
    """Hits, passes, draws and efficiency."""
    tracer = _tracer(runner, view, contender, True)
    hits = tracer.first_hit(*rays)
    passes = tracer.counters.passes
    if passes is None:
        return hits, {"passes": None, "draws": None, "efficiency": None}
    return hits, {
        "passes": len(passes),
        "draws": passes.draw_count or None,
        "efficiency": passes.efficiency,
    }


def _differences(hits: Hits, reference: Hits) -> dict[str, float]:
    """Rays that hit another triangle, and the maximum relative difference in t of the others."""
    is_other = hits.prim_id != reference.prim_id
    both = hits.is_hit & ~is_other
    t, expected = hits.t[both].astype(np.float64), reference.t[both].astype(np.float64)
    farthest = np.abs(t - expected) / np.maximum(np.abs(expected), np.finfo(np.float32).tiny)
    return {"other_hits": int(is_other.sum()), "farthest": float(farthest.max(initial=0.0))}


def _seconds(runner: Runner, view: View, rays: Any) -> dict[str, float]:
    """Median seconds of each contender without counters, timed in turn."""
    tracers = {one: _tracer(runner, view, one, False) for one in _CONTENDERS}
    calls = {one: partial(tracer.first_hit, *rays) for one, tracer in tracers.items()}
    return median_times(calls, 1 if runner.quick else _ROUNDS, patience=_PATIENCE)

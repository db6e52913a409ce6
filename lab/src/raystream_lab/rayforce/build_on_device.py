"""Structures built by the device, compared with those that the CPU builds (Rayforce 2013)."""

from __future__ import annotations

from typing import Any

from raystream.structures import Structure
from raystream.tracer import Tracer
from raystream_lab.agreement import Row, agreement_claim, agreement_table
from raystream_lab.rayforce.scenes import STRUCTURES, scenes
from raystream_lab.results import Cell, Result, Table
from raystream_lab.runner import Runner
from raystream_lab.views import View

#: The device builds it by another method, so it is another tree.
_OTHER = "bvh"


def build_on_device(runner: Runner) -> Result:
    """Build times on the CPU and on the device, and figures of what was built."""
    result = Result()
    found = {view.name: _measure(runner, view) for view in scenes(runner, result)}
    rows: list[list[Cell]] = []
    figures: list[Row] = []
    for name, each in found.items():
        for structure, one in each.items():
            cpu, ours = one["cpu"], one["device"]
            rows.append(
                [name, structure, cpu["seconds"], ours["seconds"]]
                + [cpu["seconds"] / ours["seconds"], cpu["bytes"], ours["bytes"]]
            )
            if structure != _OTHER:
                figures += [
                    (f"{name}, {structure}: {what}", value, ours["quality"][what])
                    for what, value in cpu["quality"].items()
                ]
    result.tables = [
        Table.of(
            "rayforce-build",
            "Build times",
            ["scene", "structure", "CPU, s", f"{runner.device}, s", "times as fast", "bytes, CPU"]
            + [f"bytes, {runner.device}"],
            rows,
            runner.facts.note,
            "Times are the shorter of two builds, since the first may compile. The triangles are "
            "on the device already, and the structure stays there. The BVH is built by clusters on "
            "the device, and by the surface area heuristic on the CPU.",
        ),
        agreement_table(
            "rayforce-build-agreement",
            "What was built: the device's figures against the CPU's",
            runner.device,
            figures,
        ),
    ]
    result.claims = [agreement_claim(runner.device, figures)] if figures else []
    return result


def _measure(runner: Runner, view: View) -> dict[str, dict[str, Any]]:
    def measure() -> dict[str, dict[str, Any]]:
        return {
            name: {
                "cpu": _built(view, name),
                "device": _built(view, name, device=runner.device, build="device"),
            }
            for name in STRUCTURES
        }

    values: dict[str, dict[str, Any]] = runner.measure(view.name, measure)
    return values


def _built(view: View, name: str, **options: Any) -> dict[str, Any]:
    """Seconds, bytes and figures of a structure."""
    first, again = (_structure(view, name, options) for _ in range(2))
    return {
        "seconds": min(first.report.seconds, again.report.seconds),
        "bytes": again.report.byte_count,
        "quality": dict(again.quality()),
    }


def _structure(view: View, name: str, options: dict[str, Any]) -> Structure:
    return Tracer(view.scene, name, **options).structure

"""Bounces without recursion on a current graphics pipeline (Christen 2005, section 5)."""

from __future__ import annotations

from typing import Any

import numpy as np

from raystream.rendering.render import render
from raystream.tracer import Tracer
from raystream_lab.christen.scenes import SCENES, christen_scene
from raystream_lab.devices import open_facts
from raystream_lab.results import Cell, Plot, Result, Series, Table
from raystream_lab.runner import Runner
from raystream_lab.timing import median_times

#: Width and height: a quarter of his, since the adapter may be software.
SIZE = 64

#: Numbers of iterations, and cells along each axis of the grid.
_ITERATIONS = (1, 2, 3, 4, 5)
_QUICK_ITERATIONS = (1, 3)
_CELLS = 20

_ROUNDS = 3


def on_graphics(runner: Runner) -> Result:
    """Passes and times of images by the number of iterations, compared with the CPU renderer."""
    size = runner.size(SIZE)
    found = {letter: _measure(runner, letter, size) for letter in SCENES}
    rows: list[list[Cell]] = [
        [
            letter,
            one["iterations"],
            one["passes"],
            one["seconds"],
            one["cpu_seconds"],
            one["seconds"] / one["cpu_seconds"],
            one["farthest"],
        ]
        for letter, each in found.items()
        for one in each
    ]
    lines = [
        Series(letter, [one["iterations"] for one in each], [one["passes"] for one in each])
        for letter, each in found.items()
    ]
    return Result(
        tables=[
            Table.of(
                "christen-graphics",
                f"Images by fragment programs, {size} x {size}, {_CELLS} cells along each axis",
                [
                    "scene",
                    "iterations",
                    "passes",
                    "seconds",
                    "seconds, CPU",
                    "ratio",
                    "largest colour difference",
                ],
                rows,
                open_facts("graphics").note,
                "A pass runs one kernel over the pixels that wait for it: eye rays, a step of the "
                "grid, a test, or shading, which spawns the next ray. Colour and weight (equation "
                "5.1 of the thesis) stay in textures, without readback before the end. CPU: mode "
                "whitted on the same grid, single rays. Largest colour difference: from that "
                "image, in linear light.",
            )
        ],
        plots=[
            Plot(
                "christen-graphics",
                f"Passes and iterations, {size} x {size}",
                "iterations",
                "passes",
                lines,
            )
        ],
    )


def _measure(runner: Runner, letter: str, size: int) -> list[dict[str, Any]]:
    """Measurements for each number of iterations."""
    iterations = _QUICK_ITERATIONS if runner.quick else _ITERATIONS
    rounds = 1 if runner.quick else _ROUNDS

    def measure() -> list[dict[str, Any]]:
        scene = christen_scene(letter)
        tracer = Tracer(scene, "grid", resolution=_CELLS)
        passes = Tracer(scene, "grid", "graphics", machine="multipass", resolution=_CELLS)
        return [_one(passes, tracer, count, size, rounds) for count in iterations]

    values: list[dict[str, Any]] = runner.measure(f"{letter}, {size} x {size}", measure)
    return values


def _one(passes: Tracer, tracer: Tracer, iterations: int, size: int, rounds: int) -> dict[str, Any]:
    options: dict[str, Any] = {
        "size": (size, size),
        "max_bounces": iterations - 1,
        "min_weight": 0.0,
    }

    def ours() -> Any:
        return render(passes, "whitted", **options)

    def theirs() -> Any:
        return render(tracer, "whitted", **options)

    image, reference = ours(), theirs()  # compiles
    return {
        "iterations": iterations,
        "passes": sum(image.figures["passes"].values()),
        "farthest": float(np.abs(image.pixels - reference.pixels).max()),
        **median_times({"seconds": ours, "cpu_seconds": theirs}, rounds, warm_up=False),
    }

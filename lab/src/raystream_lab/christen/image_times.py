"""Times of scenes A, B and C against grid size and bounces (Christen 2005, section 6.2)."""

from __future__ import annotations

import statistics
from collections.abc import Callable
from typing import Any

from raystream.core.errors import RaystreamError
from raystream.rendering.integrator import RenderContext
from raystream.scene.scene import Scene
from raystream.tracer import Tracer
from raystream_lab.christen.scenes import (
    SCENES,
    TEAPOT,
    christen_scene,
    image_size,
    teapot_model,
    timed_iterations,
)
from raystream_lab.devices import CUDA_PASSES
from raystream_lab.frame_timing import affordable_size, render_context, report_image
from raystream_lab.published import published
from raystream_lab.results import Cell, Plot, Result, Series, Table, comparison
from raystream_lab.runner import Runner

#: The scenes that are timed.
LETTERS = (*SCENES, TEAPOT)

#: Cells along each axis.
GRIDS = (5, 10, 20, 50, 100)
_QUICK_GRIDS = (10, 20)

#: Surfaces per path: five bounces after the first surface.
ITERATIONS = 6

ROUNDS = 3

#: Maximum seconds per image; larger ones are reduced.
_LIMIT = 2.0

#: The multipass machine needs a pass per triangle test of the longest ray; above this it is
#: skipped.
MAX_TESTS = 5000

_Times = dict[str, Any]


def image_times(runner: Runner) -> Result:
    """Times of images on every device and machine."""
    grids = _QUICK_GRIDS if runner.quick else GRIDS
    result = Result()
    found: dict[tuple[str, int, str], _Times] = {}
    triangles: dict[str, int] = {}
    for letter in LETTERS:
        scene = christen_scene(letter)
        triangles[letter] = scene.triangle_count
        for grid in grids:
            found[letter, grid, runner.fast_machine] = _fast(runner, scene, letter, grid)
        if "multipass" in runner.machines:
            for grid in grids:
                found[letter, grid, "multipass"] = _multipass(runner, scene, letter, grid)
        if runner.device != "cpu":
            continue
        title = f"{_title(letter)}, {ITERATIONS} iterations"
        name = f"christen {letter}"
        bounces = {"max_bounces": ITERATIONS - 1, "min_weight": 0.0}
        result.images.append(
            report_image(runner, name, title, scene, "whitted", (256, 256), samples=4, **bounces)
        )
    result.tables = [_scenes(triangles), _table(runner, found)]
    result.plots = [_grid_plot(found, 1), _grid_plot(found, ITERATIONS), _bounce_plot(found)]
    result.notes = [
        (
            "The values of the thesis's Figures 6.8 to 6.10 are not in our copy, so no published "
            "times are given. The thesis's times are from a GeForce 6 in 2005; ours are from the "
            f"device {runner.device!r}."
        ),
        (
            "As in Christen's renderer, no shadow rays are traced, and no ray is terminated "
            "because of a small weight. The lab's other images of these scenes have shadows."
        ),
    ]
    if runner.device != "cpu":
        result.notes.append(runner.facts.note)
    if "multipass" not in runner.machines:
        result.notes.append(CUDA_PASSES)
    return result


def _fast(runner: Runner, scene: Scene, letter: str, grid: int) -> _Times:
    size = image_size(runner)

    def measure() -> _Times:
        tracer = Tracer(scene, "grid", runner.device, resolution=grid)
        context = render_context(tracer, (size, size))
        least = max(size // 8, 1)
        timed_iterations(context, tracer, 8, ITERATIONS)  # compiles
        small = timed_iterations(context, tracer, least, ITERATIONS)[0][-1] / least**2
        chosen, _ = affordable_size(small, (size, size), _LIMIT, (least, least))
        rounds = 1 if runner.quick else ROUNDS
        return _timed(context, tracer, chosen, rounds)

    values: _Times = runner.measure(
        f"{letter}, {grid} cells, {runner.fast_machine}", lambda: _unless_refused(measure)
    )
    return values


def _multipass(runner: Runner, scene: Scene, letter: str, grid: int) -> _Times:
    """The same, once; only the reason if too many passes are needed."""
    size = image_size(runner)

    def measure() -> _Times:
        counting = Tracer(scene, "grid", resolution=grid, counters=True)
        counting.first_hit(*scene.camera_for(1.0).rays(64, 64))
        most = int(counting.counters.tests.max())
        if most > MAX_TESTS:
            return {"most_tests": most}
        tracer = Tracer(scene, "grid", runner.device, resolution=grid, machine="multipass")
        context = render_context(tracer, (size, size))
        timed_iterations(context, tracer, 8, ITERATIONS)  # compiles
        return _timed(context, tracer, size, 1)

    values: _Times = runner.measure(
        f"{letter}, {grid} cells, multipass", lambda: _unless_refused(measure)
    )
    return values


def _unless_refused(measure: Callable[[], _Times]) -> _Times:
    """Measure; only the reason if the device cannot trace the scene."""
    try:
        return measure()
    except RaystreamError as error:
        return {"refused": str(error)}


def _timed(context: RenderContext, tracer: Tracer, size: int, rounds: int) -> _Times:
    """Median times after each iteration, over rounds."""
    runs = [timed_iterations(context, tracer, size, ITERATIONS) for _ in range(rounds)]
    seconds = [statistics.median(one) for one in zip(*(run[0] for run in runs), strict=True)]
    return {"size": size, "seconds": seconds, "light": runs[0][1]}


def _title(letter: str) -> str:
    return "The teapot" if letter == TEAPOT else f"Scene {letter}"


def _scenes(triangles: dict[str, int]) -> Table:
    theirs = published("christen", "table 6.1")
    teapot = published("christen", "figure A.3")
    rows: list[tuple[str, Cell, Cell, str]] = [
        (f"{letter}: `{SCENES[letter][0]}`", theirs.values[letter], count, SCENES[letter][1])
        for letter, count in triangles.items()
        if letter != TEAPOT
    ]
    if TEAPOT in triangles:
        count = triangles[TEAPOT]
        rows.append((TEAPOT, teapot.values["triangles"], count, teapot_model()[1]))
    return comparison(
        "christen-scenes",
        f"Triangles of the scenes: {theirs.source}; the teapot: {teapot.place}",
        rows,
        "Christen's scenes were published only as images; the last column says how ours differ.",
    )


def _milliseconds(lab_size: int, one: _Times) -> list[float | None]:
    """Milliseconds of a whole image after each iteration."""
    if "seconds" not in one:
        return [None] * ITERATIONS
    scale = (lab_size / one["size"]) ** 2
    return [1000.0 * scale * seconds for seconds in one["seconds"]]


def _table(runner: Runner, found: dict[tuple[str, int, str], _Times]) -> Table:
    size = image_size(runner)
    rows: list[list[Cell]] = []
    for (letter, grid, machine), one in found.items():
        drawn = f"{one['size']} x {one['size']}" if "size" in one else "not traced"
        rows.append([letter, f"{grid}³", runner.device, machine, drawn, *_milliseconds(size, one)])
    reasons = [
        f"{letter} with {grid}³ cells: its longest ray tests {one['most_tests']:,} triangles, one "
        f"per pass; above {MAX_TESTS:,} the multipass machine is skipped."
        for (letter, grid, _), one in found.items()
        if "most_tests" in one
    ]
    reasons += [
        f"{letter} with {grid}³ cells, {machine}: {one['refused']}"
        for (letter, grid, machine), one in found.items()
        if "refused" in one
    ]
    return Table.of(
        "christen-times",
        f"Milliseconds per image of {size} x {size} pixels, by number of iterations",
        ["scene", "grid", "device", "machine", "drawn", *map(str, range(1, ITERATIONS + 1))],
        rows,
        "An iteration is a surface on a path: n iterations are n - 1 bounces after the first "
        "surface. The machine multipass is timed once; times of the other machine are medians of "
        f"{ROUNDS} rounds. Times of reduced images are scaled by the number of pixels.",
        *reasons,
    )


def _labelled(found: dict[tuple[str, int, str], _Times]) -> dict[str, dict[int, list[Any]]]:
    """Milliseconds by scene and machine, then by grid."""
    whole = max(one.get("size", 1) for one in found.values())
    lines: dict[str, dict[int, list[Any]]] = {}
    for (letter, grid, machine), one in found.items():
        lines.setdefault(f"{letter}, {machine}", {})[grid] = _milliseconds(whole, one)
    return lines


def _grid_plot(found: dict[tuple[str, int, str], _Times], iteration: int) -> Plot:
    return Plot(
        f"christen-grids-{iteration}",
        f"Time against grid size, {iteration} iteration{'s' if iteration > 1 else ''}",
        "cells along each axis",
        "milliseconds per image",
        [
            Series(label, list(line), [each[iteration - 1] for each in line.values()])
            for label, line in _labelled(found).items()
            if any(each[0] is not None for each in line.values())
        ],
        log_x=True,
        log_y=True,
    )


def _bounce_plot(found: dict[tuple[str, int, str], _Times]) -> Plot:
    grid = published("christen", "settings").values["resolution"]
    return Plot(
        "christen-iterations",
        f"Time against iterations, {grid}³ cells",
        "iterations",
        "milliseconds per image",
        [
            Series(label, list(range(1, ITERATIONS + 1)), line[grid])
            for label, line in _labelled(found).items()
            if any(line[grid])
        ],
        log_y=True,
    )

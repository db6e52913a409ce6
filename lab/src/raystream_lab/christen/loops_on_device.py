"""The loop of passes, controlled by the host or by the device (Christen 2005, section 7)."""

from __future__ import annotations

from functools import partial
from typing import Any

from raystream.core.errors import RaystreamError
from raystream.tracer import Tracer
from raystream_lab.agreement import Row, agreement_claim, agreement_table
from raystream_lab.christen.image_times import GRIDS, MAX_TESTS
from raystream_lab.christen.scenes import SCENES, Bounce, bounces_of, christen_scene, image_size
from raystream_lab.published import published
from raystream_lab.results import Cell, Claim, Plot, Result, Series, Table
from raystream_lab.runner import Runner
from raystream_lab.timing import time_in_turn

#: Values of ``Tracer(loop=...)`` on graphics devices.
_HOST, _DEVICE = "queries", "device"

#: The same comparison on CUDA, from raystream's decision 0054.
_CUDA_LOOPS = (
    "CUDA's multipass machine has been removed. On an H100, a loop on the device, in a CUDA graph, "
    "traced grids 1.8 (cornell), 3.9 (sponza) and 4.4 times (forest of a million triangles) as "
    "fast as batches of passes launched by the host: raystream's decision 0054."
)

_QUICK_GRIDS = (5, 20)

#: Iterations whose rays are traced: the camera's, and two of reflections.
ITERATIONS = 3

_ROUNDS, _PATIENCE = 3, 10.0

#: Our reading of a major gain: this many times as fast.
MAJOR = 1.5

_Loop = dict[str, Any]
_Found = dict[tuple[str, int], dict[str, _Loop]]


def loops_on_device(runner: Runner) -> Result:
    """Passes and times of both loops, from coarse to fine grids."""
    result = Result()
    found: _Found = {}
    for letter in SCENES:
        for grid in _QUICK_GRIDS if runner.quick else GRIDS:
            one = _measure(runner, letter, grid)
            if "most_tests" in one:
                result.notes.append(
                    f"{letter} with {grid}³ cells is skipped: its longest ray tests "
                    f"{one['most_tests']:,} triangles, one per pass."
                )
                continue
            refused = {loop: each for loop, each in one.items() if "refused" in each}
            result.notes += [
                f"{letter} with {grid}³ cells, loop {loop}: {each['refused']}"
                for loop, each in refused.items()
            ]
            found[letter, grid] = {loop: one[loop] for loop in one if loop not in refused}
    counts = [
        (f"{letter}, {grid}³ cells, loop {loop}: passes", each["cpu"]["passes"], one["passes"])
        for (letter, grid), each in found.items()
        for loop, one in each.items()
        if loop != "cpu"
    ]
    result.tables = [_table(runner, found), _agreement(runner, counts)]
    result.plots = [_plot(found)]
    result.claims = [_gain(found), agreement_claim(runner.device, counts)]
    return result


def _measure(runner: Runner, letter: str, grid: int) -> dict[str, Any]:
    """Passes and seconds of each loop, and of the CPU's machine."""

    def measure() -> dict[str, Any]:
        scene = christen_scene(letter)
        structure = Tracer(scene, "grid", resolution=grid).structure
        counting = Tracer.of_structure(structure, scene, counters=True)
        counting.first_hit(*scene.camera_for(1.0).rays(64, 64))
        most = int(counting.counters.tests.max())
        if most > MAX_TESTS:
            return {"most_tests": most}
        bounces = bounces_of(scene, image_size(runner), ITERATIONS)
        options: dict[str, dict[str, Any]]
        options = {loop: {"device": runner.device, "loop": loop} for loop in (_HOST, _DEVICE)}
        found: dict[str, Any] = {}
        calls = {}
        for loop, chosen in {**options, "cpu": {}}.items():
            make = partial(Tracer.of_structure, structure, scene, machine="multipass", **chosen)
            try:
                found[loop] = _passes(make(counters=True), bounces)
                calls[loop] = partial(_trace, make(), bounces)
            except RaystreamError as error:
                found[loop] = {"refused": str(error)}
        rounds = 1 if runner.quick else _ROUNDS
        for loop, seconds in time_in_turn(calls, rounds, patience=_PATIENCE).items():
            found[loop]["seconds"] = min(seconds)
        return found

    values: dict[str, Any] = runner.measure(f"{letter}, {grid} cells, loops", measure)
    return values


def _passes(tracer: Tracer, bounces: list[Bounce]) -> _Loop:
    found: _Loop = {"rays": 0, "passes": 0, "draws": 0}
    for one in bounces:
        tracer.first_hit(one.origins, one.directions)
        passes = tracer.counters.passes
        assert passes is not None
        found["rays"] += len(one.directions)
        found["passes"] += len(passes)
        found["draws"] += passes.draw_count
    return found


def _trace(tracer: Tracer, bounces: list[Bounce]) -> None:
    for one in bounces:
        tracer.first_hit(one.origins, one.directions)


def _table(runner: Runner, found: _Found) -> Table:
    size = image_size(runner)
    rows: list[list[Cell]] = [
        [letter, f"{grid}³", loop, one["rays"], one["passes"], one["draws"] or None]
        + [one["seconds"], 1e6 * one["seconds"] / one["passes"]]
        for (letter, grid), each in found.items()
        for loop, one in each.items()
    ]
    return Table.of(
        "christen-loops",
        f"Kernel calls of {ITERATIONS} iterations, by who chooses the next kernel, {size} x {size} "
        "pixels",
        ["scene", "grid", "loop", "rays", "passes", "draws", "seconds", "microseconds per pass"],
        rows,
        runner.facts.note,
        "queries: the host waits for the occlusion queries of each pass, as in Christen's "
        "renderer; device: a compute shader counts the waiting rays, and chooses the kernel of the "
        "next pass by the arguments of indirect draws.",
        f"cpu: the CPU's multipass machine. Seconds: the best of up to {_ROUNDS} rounds in which "
        "the loops take turns. No shadow rays are traced, as in Christen's renderer.",
        _CUDA_LOOPS,
    )


def _agreement(runner: Runner, counts: list[Row]) -> Table:
    title = "Passes: the device's against the CPU's"
    return agreement_table("christen-loop-passes", title, runner.device, counts)


def _gain(found: _Found) -> Claim:
    source = published("christen", "outlook")
    ratios = {
        f"{letter} {grid}³": each[_HOST]["seconds"] / each[_DEVICE]["seconds"]
        for (letter, grid), each in found.items()
        if _HOST in each and _DEVICE in each
    }
    return Claim.judged(
        "a loop on the graphics hardware, without control by occlusion queries, is a "
        f"{source.values['loop_without_queries']} (read as: loop {_DEVICE!r} is {MAJOR:g} times as "
        f"fast as {_HOST!r})",
        source.source,
        {case: ratio >= MAJOR for case, ratio in ratios.items()},
        "; ".join(f"{case}: {ratio:.3g} times" for case, ratio in ratios.items()),
    )


def _plot(found: _Found) -> Plot:
    lines: dict[str, dict[int, float]] = {}
    for (letter, grid), each in found.items():
        for loop, one in each.items():
            lines.setdefault(f"{letter}, {loop}", {})[grid] = 1e3 * one["seconds"]
    return Plot(
        "christen-loops",
        "Time of the loop against grid size",
        "cells along each axis",
        "milliseconds",
        [Series(label, list(line), list(line.values())) for label, line in lines.items()],
        log_x=True,
        log_y=True,
    )

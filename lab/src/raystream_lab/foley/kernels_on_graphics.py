"""Table 3 on the graphics pipeline: words and time of the key kernels' passes."""

from __future__ import annotations

import time
from typing import Any

from raystream.core.errors import RaystreamError
from raystream.machines.schedulers import Queues, make_scheduler
from raystream.tracer import Tracer
from raystream_lab.foley.key_kernels import KERNEL_NAMES, KEY_STRUCTURES
from raystream_lab.published import published
from raystream_lab.results import Cell, Result, Table
from raystream_lab.runner import Runner

_SIZE = 512

_WORD_BYTES = 4

#: For brute force, which takes a pass for each triangle, instead of the kitchen.
_SMALL_SCENE = "cornell_open"

_Figures = dict[str, dict[str, Any]]


class TimedScheduler:
    """A scheduler of the host that times the passes between its choices.

    Parameters
    ----------
    rule : str
        The scheduler that chooses.

    Attributes
    ----------
    seconds : dict of str to float
        By kernel: from the choice of each of its passes to the next choice.
    runs, passes : dict of str to int
        Rays that the kernel ran on, and its passes, as far as timed: all but the last.
    """

    def __init__(self, rule: str = "double") -> None:
        self._scheduler = make_scheduler(rule)
        self._latest = ""
        self._waiting = 0
        self._chosen_at = 0.0
        self.seconds: dict[str, float] = {}
        self.runs: dict[str, int] = {}
        self.passes: dict[str, int] = {}

    def choose(self, queues: Queues) -> int:
        """See `Scheduler.choose`."""
        now = time.perf_counter()
        if self._latest:
            kernel = self._latest
            self.seconds[kernel] = self.seconds.get(kernel, 0.0) + now - self._chosen_at
            self.runs[kernel] = self.runs.get(kernel, 0) + self._waiting
            self.passes[kernel] = self.passes.get(kernel, 0) + 1
        chosen = self._scheduler.choose(queues)
        self._latest, self._waiting = queues.kernels[chosen].name, queues.waiting[chosen]
        self._chosen_at = time.perf_counter()
        return chosen


def kernels_on_graphics(runner: Runner) -> Result:
    """Words, time and bandwidth of each key kernel in the passes of an image."""
    result = Result()
    size = runner.device_size(_SIZE)
    rows: list[list[Cell]] = []
    speeds: list[list[Cell]] = []
    for structure in KEY_STRUCTURES:
        scene = _SMALL_SCENE if structure == "brute" or runner.quick else "kitchen"
        try:
            found = _measure(runner, structure, scene, size)
        except RaystreamError as error:
            result.notes.append(f"{structure} in {scene} is left out: {error}")
            continue
        for kernel, one in found.items():
            name = KERNEL_NAMES[structure, kernel]
            theirs = published("foley", "table 3").values[name]
            rows += _rows(name, theirs, one)
            words = one["in"] + one["out"]
            rate = one["runs"] / one["seconds"]
            speeds.append(
                [name, scene, one["passes"], one["runs"], 1e6 * one["seconds"] / one["passes"]]
                + [1e9 / rate, _WORD_BYTES * words * rate / 1e9, theirs["gigabytes_per_second"]]
            )
    result.tables = [
        Table.of(
            "foley-table-3",
            f"Words of a kernel per ray: {published('foley', 'table 3').source}",
            ["quantity", "published", "ours", "ratio", "why they differ"],
            rows,
            "Floats in and out are the texels of the ray's streams, four words each. Nodes, cells "
            "and triangles are read from storage buffers, and not counted; the paper counts them.",
        ),
        Table.of(
            "foley-bandwidth",
            f"Passes of each kernel, {size} x {size} rays, loop by occlusion queries",
            ["kernel", "scene", "passes", "runs", "microseconds per pass", "ns per run"]
            + ["GB/s of streams", "published GB/s"],
            speeds,
            runner.facts.note,
            "A pass is timed from the choice of its kernel to the next choice: the draw, the draws "
            "that copy back and classify, and the host's wait for the occlusion queries. The paper "
            "repeats one full pass without masked rays; here passes are those of the image, in "
            "which few rays are active, so bandwidths are lower bounds.",
        ),
    ]
    return result


def _measure(runner: Runner, structure: str, scene: str, size: int) -> _Figures:
    """Figures of a structure's key kernels, by kernel."""

    def measure() -> _Figures:
        view = runner.view(scene)
        options = {} if structure == "brute" else KEY_STRUCTURES[structure]
        built = Tracer(view.scene, structure, **options).structure
        rays = view.rays(size)
        Tracer.of_structure(built, **_loop("double")).first_hit(*view.rays(8))  # compiles
        scheduler = TimedScheduler()
        tracer = Tracer.of_structure(built, counters=True, **_loop(scheduler))
        tracer.first_hit(*rays)
        passes = tracer.counters.passes
        assert passes is not None
        found: _Figures = {}
        for one in passes:
            name = one.kernel
            if (structure, name) in KERNEL_NAMES and name in scheduler.runs and one.run_count:
                found[name] = {
                    "in": sum(one.words_read.values()) // one.run_count,
                    "out": sum(one.words_written.values()) // one.run_count,
                    "seconds": scheduler.seconds[name],
                    "runs": scheduler.runs[name],
                    "passes": scheduler.passes[name],
                }
        names = [kernel for one, kernel in KERNEL_NAMES if one == structure]
        return {kernel: found[kernel] for kernel in names if kernel in found}

    found: _Figures = runner.measure(f"{structure} in {scene}, {size} x {size}", measure)
    return found


def _loop(scheduler: Any) -> dict[str, Any]:
    return {
        "device": "graphics",
        "machine": "multipass",
        "loop": "queries",
        "scheduler": scheduler,
    }


def _rows(name: str, theirs: dict[str, float], one: dict[str, Any]) -> list[list[Cell]]:
    whole = "whole texels of four words; "
    return [
        [f"{name}: floats in", theirs["floats_in"], one["in"], one["in"] / theirs["floats_in"]]
        + [whole + "without nodes, cells and triangles"],
        [f"{name}: floats out", theirs["floats_out"], one["out"]]
        + [one["out"] / theirs["floats_out"], whole + "with the state"],
    ]

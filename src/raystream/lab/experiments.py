"""Experiments by paper and name, and a run of some of them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from typing import NamedTuple

from raystream.core.errors import RaystreamError
from raystream.lab.laboratory import Laboratory
from raystream.lab.results import Result

__all__ = ["DEVICES", "EXPERIMENTS", "PAPERS", "Experiment", "Outcome", "choose", "run_all"]

#: Papers by the name that the command line knows, in the order of the report.
PAPERS = ("purcell", "foley", "rayforce", "christen")

#: Devices that have experiments.
DEVICES = ("cpu", "graphics")


@dataclass(frozen=True)
class Experiment:
    """One question, put to raystream as a paper put it.

    Attributes
    ----------
    name : str
        Such as ``"purcell-statistics"``; begins with the paper's.
    title : str
    place : str
        Module and function, imported when it runs.
    device : str
        What it measures: those of another device than the CPU run when they are asked for.
    """

    name: str
    title: str
    place: str
    device: str = "cpu"

    @property
    def paper(self) -> str:
        """One of `PAPERS`."""
        return self.name.partition("-")[0]

    def function(self) -> Callable[[Laboratory], Result]:
        """What it does."""
        module, _, name = self.place.rpartition(".")
        function: Callable[[Laboratory], Result] = getattr(
            import_module(f"raystream.lab.{module}"), name
        )
        return function


class Outcome(NamedTuple):
    """An experiment with what it found, and how many seconds its measurements took."""

    experiment: Experiment
    result: Result
    seconds: float = 0.0


EXPERIMENTS = (
    Experiment(
        "purcell-statistics",
        "What a ray meets: v, t and s",
        "purcell.statistics.scene_statistics",
    ),
    Experiment(
        "purcell-resolution",
        "Grids from coarse to fine: steps against tests",
        "purcell.resolution.grid_resolution",
    ),
    Experiment("purcell-passes", "Passes and schedulers", "purcell.schedules.schedules"),
    Experiment("purcell-costs", "Compute and bandwidth", "purcell.costs.picture_costs"),
    Experiment("purcell-speed", "Triangle tests a second", "purcell.speed.tests_per_second"),
    Experiment("purcell-unrolling", "Several steps in a pass", "purcell.unrolling.loop_unrolling"),
    Experiment(
        "purcell-cache",
        "The texture cache over the machines' own references",
        "purcell.caches.texture_cache",
    ),
    Experiment("purcell-mailbox", "What a mailbox would save", "purcell.mailbox.mailbox"),
    Experiment("purcell-memory", "Geometry in a small memory", "purcell.memory.small_memory"),
    Experiment("purcell-zbuffer", "Ray tracing against the Z-buffer", "purcell.zbuffer.zbuffer"),
    Experiment("purcell-kernels", "Our own kernels, compiled", "purcell.compiled.compiled_kernels"),
    Experiment(
        "purcell-extensions",
        "Shadows, mirrors and paths",
        "purcell.extensions.extension_costs",
    ),
    Experiment(
        "purcell-graphics",
        "The same on a graphics pipeline of today",
        "purcell.on_graphics.on_graphics",
        "graphics",
    ),
    Experiment(
        "foley-times",
        "Brute force, grid and kd-trees: times",
        "foley.times.structure_times",
    ),
    Experiment(
        "foley-counts",
        "What having no stack costs: states of rays",
        "foley.counts.state_counts",
    ),
    Experiment(
        "foley-kernels", "What the key kernels read and wait for", "foley.table3.key_kernels"
    ),
    Experiment(
        "foley-costs",
        "A step is 8 times a test: the costs of the tree",
        "foley.costs.cost_sweep",
    ),
    Experiment(
        "foley-schedule",
        "When to switch kernels: schedulers",
        "foley.schedule.schedules",
    ),
    Experiment(
        "foley-recirculation",
        "What carrying rays from pass to pass costs",
        "foley.recirculation.recirculation",
    ),
    Experiment(
        "foley-secondary",
        "Coherence of secondary rays",
        "foley.secondary.coherence",
    ),
    Experiment(
        "rayforce-modes",
        "Four kinds of pictures in three scenes",
        "rayforce.modes.modes",
    ),
    Experiment(
        "rayforce-layers",
        "Multi-hit against the number of layers",
        "rayforce.layers.layers",
    ),
    Experiment(
        "rayforce-hidden",
        "What a ray pays for",
        "rayforce.hidden.hidden",
    ),
    Experiment(
        "rayforce-graph",
        "The graph beside the other structures",
        "rayforce.sectors.graph",
    ),
    Experiment(
        "christen-times",
        "Time against grid size and bounces",
        "christen.times.times",
    ),
    Experiment(
        "christen-calls",
        "Kernel calls, and rays that are masked out",
        "christen.calls.calls",
    ),
    Experiment(
        "christen-graphics",
        "Bounces on a graphics pipeline of today",
        "christen.on_graphics.on_graphics",
        "graphics",
    ),
)


def choose(
    papers: Sequence[str], only: Sequence[str] = (), device: str = "cpu"
) -> list[Experiment]:
    """Find experiments.

    Parameters
    ----------
    papers : sequence of str
        Of `PAPERS`, or ``"all"``.
    only : sequence of str
        Names of experiments, or their ends without the paper; all of them if there is none.
    device : str
        Of `DEVICES`: what they measure.

    Raises
    ------
    ValueError
        If a name is unknown, or belongs to none of the papers or to another device; or if the
        papers have no experiment for the device.
    """
    if device not in DEVICES:
        raise ValueError(f"device: expected {' or '.join(DEVICES)}, got {device!r}")
    for paper in papers:
        if paper not in (*PAPERS, "all"):
            raise ValueError(f"expected {', '.join((*PAPERS, 'all'))}, got {paper!r}")
    chosen = [
        one
        for one in EXPERIMENTS
        if ("all" in papers or one.paper in papers) and one.device == device
    ]
    if not chosen:
        having = dict.fromkeys(one.paper for one in EXPERIMENTS if one.device == device)
        raise ValueError(f"device {device!r}: has experiments of {', '.join(having)}")
    if not only:
        return chosen
    for name in only:
        if not any(_is_called(one, name) for one in chosen):
            known = ", ".join(one.name for one in chosen)
            raise ValueError(f"no experiment {name!r}; there are {known}")
    return [one for one in chosen if any(_is_called(one, name) for name in only)]


def _is_called(experiment: Experiment, name: str) -> bool:
    return name in (experiment.name, experiment.name.partition("-")[2])


def run_all(
    lab: Laboratory,
    experiments: Sequence[Experiment],
    progress: Callable[[int, int], None] | None = None,
) -> list[Outcome]:
    """Run experiments one after another.

    Parameters
    ----------
    lab : Laboratory
    experiments : sequence of Experiment
    progress : callable, optional
        Called with (experiments done, experiments).

    Notes
    -----
    One that lacks a model, or memory, says so in its notes; the others run.
    """
    outcomes = []
    for number, one in enumerate(experiments):
        try:
            result = lab.run(one.name, partial(_call, one))
        except (RaystreamError, MemoryError) as error:
            result = Result(notes=[f"{one.name} was not measured: {error}"])
        outcomes.append(Outcome(one, result, lab.seconds))
        if progress:
            progress(number + 1, len(experiments))
    return outcomes


def _call(experiment: Experiment, lab: Laboratory) -> Result:
    return experiment.function()(lab)

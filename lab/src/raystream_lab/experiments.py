"""The list of experiments, selection by paper and name, and running them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from typing import TYPE_CHECKING, NamedTuple

from raystream.core.errors import RaystreamError
from raystream_lab.devices import DEVICES

if TYPE_CHECKING:
    from raystream_lab.results import Result
    from raystream_lab.runner import Runner

#: Papers by their name on the command line, in the order of the report.
PAPERS = ("purcell", "foley", "rayforce", "christen")


@dataclass(frozen=True)
class Experiment:
    """One question of a paper, put to raystream.

    Attributes
    ----------
    name : str
        Such as ``"purcell-statistics"``; begins with the paper's name.
    title : str
    module : str
        Below `raystream_lab`; imported on first use. Its function has the same name.
    devices : tuple of str
        Those of `devices.DEVICES` that it runs on.
    on_device : str
        The module for all devices but the CPU, if it is another: it compares counts with the
        CPU's, and has none of the CPU's analyses of causes.
    """

    name: str
    title: str
    module: str
    devices: tuple[str, ...] = ("cpu",)
    on_device: str = ""

    @property
    def paper(self) -> str:
        """One of `PAPERS`."""
        return self.name.partition("-")[0]

    def function(self, device: str = "cpu") -> Callable[[Runner], Result]:
        """The function that runs it, on a runner for this device."""
        name = self.module if device == "cpu" else self.on_device or self.module
        module = import_module(f"raystream_lab.{name}")
        function: Callable[[Runner], Result] = getattr(module, name.rpartition(".")[2])
        return function


class Outcome(NamedTuple):
    """An experiment, its result, and the seconds that its measurements took."""

    experiment: Experiment
    result: Result
    seconds: float = 0.0


EXPERIMENTS = (
    Experiment(
        "purcell-statistics",
        "Work per ray: v, t and s",
        "purcell.scene_statistics",
        DEVICES,
        "purcell.statistics_on_device",
    ),
    Experiment(
        "purcell-resolution",
        "Grids from coarse to fine: steps against tests",
        "purcell.grid_resolution",
    ),
    Experiment("purcell-passes", "Passes and schedulers", "purcell.schedules"),
    Experiment(
        "purcell-lists",
        "Exact lists, as published: v, t, s and passes, and the price of equal bits",
        "purcell.exact_lists",
    ),
    Experiment("purcell-costs", "Compute and bandwidth", "purcell.image_costs"),
    Experiment("purcell-speed", "Triangle tests per second", "purcell.triangle_rate"),
    Experiment("purcell-unrolling", "Several steps per pass", "purcell.loop_unrolling"),
    Experiment(
        "purcell-cache",
        "The texture cache with the machines' own memory references",
        "purcell.texture_cache",
    ),
    Experiment("purcell-mailbox", "Savings of a mailbox", "purcell.mailbox"),
    Experiment("purcell-memory", "Geometry in a small memory", "purcell.small_memory"),
    Experiment("purcell-zbuffer", "Ray tracing against the Z-buffer", "purcell.zbuffer"),
    Experiment("purcell-kernels", "Our own kernels, compiled", "purcell.compiled_kernels"),
    Experiment("purcell-extensions", "Shadows, mirrors and paths", "purcell.extensions"),
    Experiment(
        "purcell-machines",
        "Ray casting in passes and by programs with loops",
        "purcell.on_device",
        ("graphics",),
    ),
    Experiment(
        "foley-times",
        "Brute force, grid and kd-trees: times",
        "foley.structure_times",
        DEVICES,
        "foley.times_on_device",
    ),
    Experiment(
        "foley-counts",
        "The cost of having no stack: ray states",
        "foley.state_counts",
        ("cpu", "graphics"),
        "foley.counts_on_device",
    ),
    Experiment(
        "foley-kernels",
        "Reads and bottlenecks of the key kernels",
        "foley.key_kernels",
        ("cpu", "graphics"),
        "foley.kernels_on_graphics",
    ),
    Experiment(
        "foley-costs", "A step costs 8 tests: the cost model of the tree", "foley.tree_costs"
    ),
    Experiment("foley-schedule", "When to switch kernels: schedulers", "foley.schedulers"),
    Experiment(
        "foley-recirculation", "The cost of carrying rays from pass to pass", "foley.recirculation"
    ),
    Experiment("foley-secondary", "Coherence of secondary rays", "foley.coherence"),
    Experiment(
        "foley-convergence", "Whether climbing halves the nodes of a group", "foley.convergence"
    ),
    Experiment("foley-bounds", "Worst cases of the stackless traversals", "foley.bounds"),
    Experiment("foley-memory", "Memory of nodes and of rays", "foley.memory_use"),
    Experiment("foley-paper", "Consistency of the paper's figures", "foley.paper_figures"),
    Experiment(
        "rayforce-modes", "Four render modes in three scenes", "rayforce.render_modes", DEVICES
    ),
    Experiment(
        "rayforce-layers", "Multi-hit against the number of layers", "rayforce.layers", DEVICES
    ),
    Experiment(
        "rayforce-hidden",
        "Cost per ray against hidden geometry",
        "rayforce.hidden_triangles",
        DEVICES,
    ),
    Experiment(
        "rayforce-graph",
        "The graph compared with the other structures",
        "rayforce.graph_statistics",
    ),
    Experiment("rayforce-build", "Building on the device", "rayforce.build_on_device", ("cuda",)),
    Experiment(
        "christen-times", "Time against grid size and bounces", "christen.image_times", DEVICES
    ),
    Experiment(
        "christen-calls",
        "Kernel calls, and rays that are masked out",
        "christen.kernel_calls",
    ),
    Experiment(
        "christen-loops",
        "Who chooses the next kernel: the host or the device",
        "christen.loops_on_device",
        ("graphics",),
    ),
    Experiment("christen-memory", "Memory per pixel against iterations", "christen.pixel_memory"),
    Experiment(
        "christen-graphics",
        "Bounces on a current graphics pipeline",
        "christen.on_graphics",
        ("graphics",),
    ),
)


def choose(
    papers: Sequence[str], only: Sequence[str] = (), device: str = "cpu"
) -> list[Experiment]:
    """Select experiments.

    Parameters
    ----------
    papers : sequence of str
        Names in `PAPERS`, or ``"all"``.
    only : sequence of str
        Names of experiments, with or without the paper [default: all].
    device : str
        One of `devices.DEVICES`.

    Raises
    ------
    ValueError
        If a name is unknown, or not of these papers and this device; or if the papers have no
        experiment for the device.
    """
    if device not in DEVICES:
        raise ValueError(f"device: expected one of {', '.join(DEVICES)}, got {device!r}")
    for paper in papers:
        if paper not in (*PAPERS, "all"):
            raise ValueError(f"expected {', '.join((*PAPERS, 'all'))}, got {paper!r}")
    chosen = [
        one
        for one in EXPERIMENTS
        if ("all" in papers or one.paper in papers) and device in one.devices
    ]
    if not chosen:
        available = dict.fromkeys(one.paper for one in EXPERIMENTS if device in one.devices)
        raise ValueError(f"device {device!r}: has experiments of {', '.join(available)}")
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
    runner: Runner,
    experiments: Sequence[Experiment],
    progress: Callable[[int, int], None] | None = None,
) -> list[Outcome]:
    """Run experiments in sequence.

    Parameters
    ----------
    runner : Runner
    experiments : sequence of Experiment
    progress : callable, optional
        Called with (experiments done, experiments).

    Notes
    -----
    An experiment that lacks a model or memory reports it in its notes; the others run.
    """
    from raystream_lab.results import Result

    outcomes = []
    for number, one in enumerate(experiments):
        try:
            result = runner.run(one.name, partial(_call, one))
        except (RaystreamError, MemoryError) as error:
            result = Result(notes=[f"{one.name} was not measured: {error}"])
        outcomes.append(Outcome(one, result, runner.seconds))
        if progress:
            progress(number + 1, len(experiments))
    return outcomes


def _call(experiment: Experiment, runner: Runner) -> Result:
    return experiment.function(runner.device)(runner)

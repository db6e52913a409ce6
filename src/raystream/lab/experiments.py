"""Experiments by paper and name, and a run of some of them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from typing import NamedTuple

from raystream.lab.laboratory import Laboratory
from raystream.lab.results import Result

__all__ = ["EXPERIMENTS", "PAPERS", "Experiment", "Outcome", "choose", "run_all"]

#: Papers by the name that the command line knows, in the order of the report.
PAPERS = ("purcell", "foley", "rayforce", "christen")


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
    """

    name: str
    title: str
    place: str

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
    """An experiment with what it found."""

    experiment: Experiment
    result: Result


EXPERIMENTS = (
    Experiment(
        "purcell-statistics",
        "What a ray meets: v, t and s",
        "purcell.statistics.scene_statistics",
    ),
)


def choose(papers: Sequence[str], only: Sequence[str] = ()) -> list[Experiment]:
    """Find experiments.

    Parameters
    ----------
    papers : sequence of str
        Of `PAPERS`, or ``"all"``.
    only : sequence of str
        Names of experiments, or their ends without the paper; all of them if there is none.

    Raises
    ------
    ValueError
        If a name is unknown, or belongs to none of the papers.
    """
    for paper in papers:
        if paper not in (*PAPERS, "all"):
            raise ValueError(f"expected {', '.join((*PAPERS, 'all'))}, got {paper!r}")
    chosen = [one for one in EXPERIMENTS if "all" in papers or one.paper in papers]
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
    """
    outcomes = []
    for number, one in enumerate(experiments):
        outcomes.append(Outcome(one, lab.run(one.name, partial(_call, one))))
        if progress:
            progress(number + 1, len(experiments))
    return outcomes


def _call(experiment: Experiment, lab: Laboratory) -> Result:
    return experiment.function()(lab)

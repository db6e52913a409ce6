"""Machines: how a traversal is executed, one ray from start to end or all rays step by step."""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from typing import Any

from raystream.machines.counters import RayCounters
from raystream.machines.counting import Counting
from raystream.machines.multipass import Multipass
from raystream.machines.passes import Passes
from raystream.machines.schedulers import Queues, Scheduler
from raystream.structures import Structure
from raystream.structures.batches import BatchQueries

__all__ = [
    "MACHINES",
    "Counting",
    "Multipass",
    "Passes",
    "Queues",
    "RayCounters",
    "Scheduler",
    "make_machine",
    "own_options",
]

#: Machines by the name that `Tracer` takes.
MACHINES = ("branching", "multipass")

#: Options of the multipass machine.
_MULTIPASS_OPTIONS = tuple(inspect.signature(Multipass).parameters)[1:]


def own_options(machine: str, options: Mapping[str, Any]) -> dict[str, Any]:
    """Those of a tracer's options that are a machine's; the others are the structure's.

    Raises
    ------
    ValueError
        If there is no machine of that name.
    TypeError
        If an option is another machine's.
    """
    if machine not in list(MACHINES):
        known = ", ".join(map(repr, MACHINES))
        raise ValueError(f"machine: expected one of {known}, got {machine!r}")
    own = {name: value for name, value in options.items() if name in _MULTIPASS_OPTIONS}
    if own and machine != "multipass":
        name = next(iter(own))
        raise TypeError(f"{machine}: has no option {name!r}; it is one of machine='multipass'")
    return own


def make_machine(
    machine: str, structure: Structure, counters: bool, options: Mapping[str, Any]
) -> BatchQueries | Counting:
    """Make a machine for a structure.

    Parameters
    ----------
    machine : {"branching", "multipass"}
    structure : Structure
        Branching is what a structure does by itself.
    counters : bool
        Whether it counts what rays meet.
    options : mapping
        Of the machine; see `own_options`.
    """
    made = Multipass(structure, **options) if machine == "multipass" else structure
    return Counting(made) if counters else made

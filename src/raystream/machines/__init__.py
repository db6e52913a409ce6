"""Machines: execute a traversal, one ray from start to end or all rays step by step."""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from raystream.core import choices
from raystream.machines.branching import Branching
from raystream.structures import Structure

if TYPE_CHECKING:
    from raystream.machines.backend import Backend
    from raystream.machines.counters import RayCounters
    from raystream.machines.multipass import MultipassBackend
    from raystream.machines.pass_snapshot import Observer, PassSnapshot
    from raystream.machines.passes import Passes
    from raystream.machines.schedulers import Queues, Scheduler

__all__ = [
    "MACHINES",
    "MULTIPASS_OPTIONS",
    "Branching",
    "MultipassBackend",
    "Observer",
    "PassSnapshot",
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
MULTIPASS_OPTIONS = choices.Multipass.names()

# Imported on first use: the branching machine needs neither streams nor their kernels.
_HOMES = {
    "MultipassBackend": "multipass",
    "Observer": "pass_snapshot",
    "Passes": "passes",
    "Queues": "schedulers",
    "RayCounters": "counters",
    "Scheduler": "schedulers",
    "PassSnapshot": "pass_snapshot",
}


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(importlib.import_module(f"{__name__}.{_HOMES[name]}"), name)
    globals()[name] = value
    return value


def own_options(machine: str, options: Mapping[str, Any]) -> dict[str, Any]:
    """Select the options of a machine among those of a tracer.

    Raises
    ------
    ValueError
        If the machine is unknown.
    TypeError
        If an option belongs to another machine.
    """
    if machine not in list(MACHINES):
        known = ", ".join(map(repr, MACHINES))
        raise ValueError(f"machine: expected one of {known}, got {machine!r}")
    own = {name: value for name, value in options.items() if name in MULTIPASS_OPTIONS}
    if own and machine != "multipass":
        name = next(iter(own))
        raise TypeError(
            f"{machine}: has no option {name!r}; it is an option of machine='multipass'"
        )
    return own


def make_machine(machine: str, structure: Structure, options: Mapping[str, Any]) -> Backend:
    """Make a CPU backend for a structure.

    Parameters
    ----------
    machine : {"branching", "multipass"}
    structure : Structure
    options : mapping
        Of the machine; see `own_options`.
    """
    if machine == "multipass":
        from raystream.machines.multipass import MultipassBackend

        return MultipassBackend(structure, **options)
    return Branching(structure)

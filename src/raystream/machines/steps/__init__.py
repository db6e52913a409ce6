"""Each structure's traversal as kernels: one step of every ray that waits for it."""

from __future__ import annotations

from raystream.machines.steps.base import Steps
from raystream.structures import Structure, form_of, names_with

__all__ = ["Steps", "steps_of"]


def steps_of(structure: Structure) -> Steps:
    """The steps of a structure's traversal.

    Raises
    ------
    ValueError
        If the multipass machine does not support it.
    """
    make = form_of(structure.name, "multipass")
    if make is None:
        known = ", ".join(map(repr, names_with("multipass")))
        raise ValueError(
            f"machine: 'multipass' supports the structures {known}, not {structure.name!r}"
        )
    return make(structure)

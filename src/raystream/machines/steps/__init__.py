"""Each structure's traversal as kernels over rays: one step of every ray that waits for it."""

from __future__ import annotations

from collections.abc import Callable

from raystream.machines.steps import brute, bvh, graph, grid, kdtree
from raystream.machines.steps.base import Steps
from raystream.structures import Structure

__all__ = ["STEPS", "Steps", "steps_of"]

#: By the name of the structure.
STEPS: dict[str, Callable[..., Steps]] = {
    "brute": brute.steps,
    "bvh": bvh.steps,
    "graph": graph.steps,
    "grid": grid.steps,
    "kdtree": kdtree.steps,
}


def steps_of(structure: Structure) -> Steps:
    """The steps of a structure's traversal.

    Raises
    ------
    ValueError
        If it is not given as steps.
    """
    if structure.name not in STEPS:
        known = ", ".join(map(repr, STEPS))
        raise ValueError(
            f"machine: 'multipass' runs the structures {known}, not {structure.name!r}"
        )
    return STEPS[structure.name](structure)

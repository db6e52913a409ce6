"""The kernels of a structure's passes, as a page runs them: those of the multipass machine."""

from __future__ import annotations

import copy
from dataclasses import replace
from typing import Any

from raystream.graphics.errors import GraphicsError
from raystream.graphics.multipass.kernels import kernels_of
from raystream.graphics.structures import shader_structure_of
from raystream.machines.records import RayState
from raystream.machines.schedulers import DEFAULT_THRESHOLD
from raystream.structures import Structure
from raystream.structures.kdtree.structure import KdTreeStructure

#: Shader files of all structures' passes.
LOOP_FILES = (
    "fragment/no_counters.wgsl",
    "multipass/commit.wgsl",
    "multipass/loop/commit.wgsl",
    "multipass/loop/eye_rays.wgsl",
    "multipass/loop/shade.wgsl",
    "multipass/schedule.wgsl",
    "page/states.wgsl",
)


def pass_kernels(structure: Structure) -> dict[str, Any] | None:
    """A structure's kernels but for shading, which is a mode's; None if it has none.

    A kd-tree whose traversal has a stack restarts instead: rays have no memory for one.
    """
    structure = _without_stack(structure)
    try:
        traversal = kernels_of(structure)
    except GraphicsError:
        return None
    kernels = [
        {
            "name": one.name,
            "entry": one.entry,
            "state": int(one.state),
            # All rays are shaded, those that miss the structure's box, too.
            "next": [
                int(
                    RayState.SHADING
                    if one.state == RayState.STARTING and to == RayState.DONE
                    else to
                )
                for to in one.transitions
            ],
            "writes": list(one.writes),
        }
        for one in traversal.kernels[:-1]
    ]
    instead = shader_structure_of(structure).instead
    return {"shader": traversal.shader, "kernels": kernels, "instead": instead}


def pass_files(passes: dict[str, Any]) -> set[str]:
    """Shader files of a structure's passes."""
    return {passes["shader"], *passes["instead"].values(), *LOOP_FILES}


def schedule() -> dict[str, Any]:
    """How a page chooses the kernels: by the multipass machine's default."""
    states = {one.name.lower().replace("_", " "): int(one) for one in RayState}
    return {"states": states, "threshold": DEFAULT_THRESHOLD}


def _without_stack(structure: Structure) -> Structure:
    if not isinstance(structure, KdTreeStructure):
        return structure
    if structure.options.traversal not in ("stack", "short-stack"):
        return structure
    restarting = copy.copy(structure)
    restarting.options = replace(structure.options, traversal="restart")
    return restarting

"""Kernels of programs with arguments of the right types, to compile them without a GPU."""

from __future__ import annotations

from typing import Any

import numpy as np

from raystream.core.triangles import Triangles
from raystream.cuda.programs import steps
from raystream.cuda.programs.device_program import DeviceProgram
from raystream.cuda.programs.records import aligned_dtype
from raystream.jit.cuda import RangeKernel
from raystream.kernels.hits import HitAddresses
from raystream.kernels.ray import SceneFrame
from raystream.kernels.ray_source import RaySource
from raystream.programs.decisions import Decision
from raystream.programs.loop_source import Goal

_AT = np.uint64(0)
_RECORD = aligned_dtype(np.dtype([("crossings", "i4"), ("inside", "f8")]))
_GOALS: tuple[Goal, ...] = ("first", "count", "keep")


def _add_up(hit: Any, payload: Any) -> Any:
    """Add up the length inside meshes, up to the eighth crossing."""
    payload.crossings += 1
    if hit.is_entering:
        payload.inside -= hit.t
    else:
        payload.inside += hit.t
    return Decision.STOP if payload.crossings == 8 else Decision.CONTINUE


def _is_solid(hit: Any) -> Any:
    return hit.mesh_id != 0


def program_kernels(triangles: Triangles) -> dict[str, tuple[RangeKernel, tuple[Any, ...]]]:
    """The kernels by name, with arguments that have the right types only.

    Parameters
    ----------
    triangles : Triangles
        Any.
    """
    programs = {"trace": DeviceProgram(_add_up, "trace", record=(_RECORD, 1))}
    for goal in _GOALS:
        programs[f"filter, {goal}"] = DeviceProgram(_is_solid, goal, skips=True)
    source = RaySource(_AT, _AT, False, _AT, _AT, False, _AT, _AT, _AT, _AT)
    hits, number = HitAddresses(_AT, _AT, _AT, _AT), np.int64(0)
    made: dict[str, tuple[RangeKernel, tuple[Any, ...]]] = {
        name: (program.kernel, program.typical()) for name, program in programs.items()
    }
    return made | {
        "open": (steps.OPEN, (_AT,)),
        "want": (steps.WANT, (_AT, _AT, number, number, _AT)),
        "clear ignored": (steps.CLEAR_IGNORED, (_AT, hits)),
        "is hit": (steps.IS_HIT, (_AT, _AT)),
        "note invalid": (steps.NOTE_INVALID, (source, SceneFrame.identity(triangles), _AT)),
        "narrow": (steps.NARROW, (_AT, _AT)),
    }

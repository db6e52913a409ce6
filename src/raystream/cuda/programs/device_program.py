"""DeviceProgram: a filter or program, compiled into a kernel over rows of hits."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

import numpy as np

from raystream.cuda.programs.records import is_aligned
from raystream.jit.cuda import UserKernel
from raystream.jit.cuda.arguments import example_of
from raystream.jit.fingerprint import fingerprint
from raystream.jit.from_source import kernel_from_source
from raystream.jit.intrinsics import record_at
from raystream.jit.user_loops import as_device
from raystream.kernels.hits import HitAddresses
from raystream.programs.filters import Filter
from raystream.programs.hits import RaysAt, RowsAt, SceneAt
from raystream.programs.loop_source import Goal, loop_globals, loop_source
from raystream.programs.program import check_function
from raystream.programs.rows import SkipsAt

#: Dtype of a payload, and the number of elements per ray if it has no fields.
Record = tuple[np.dtype[Any], int]

_AT = np.uint64(0)

#: Arguments of each goal with the right types only.
_GOALS: dict[str, tuple[Any, ...]] = {
    "trace": (_AT,),
    "first": (example_of(HitAddresses),),
    "count": (_AT,),
    "keep": (_AT, np.int64(0), _AT, example_of(HitAddresses)),
}

#: Most kernels kept in memory; the oldest are dropped.
_KEPT_KERNELS = 1024

_MADE: dict[Any, UserKernel] = {}


class DeviceProgram:
    """A user's function as a kernel.

    Parameters
    ----------
    function : callable
        See `Program`.
    goal : {"trace", "first", "count", "keep"}
    skips : bool
        Whether rays skip triangles.
    constants : tuple, optional
        Passed to the function: numbers, and tuples of them.
    record : (dtype, int), optional
        Of the payload, for the goal ``"trace"``.

    Attributes
    ----------
    name : str
        Of the function.
    kernel : UserKernel

    Raises
    ------
    TypeError
        If it is not a function, or has other parameters.
    """

    def __init__(
        self,
        function: Callable[..., Any],
        goal: Goal,
        *,
        skips: bool = False,
        constants: tuple[Any, ...] | None = None,
        record: Record | None = None,
    ) -> None:
        self.name = check_function(function, goal, constants is not None)
        self._goal, self._skips, self._record = goal, skips, record
        self._has_host_addresses = False
        self._constants = () if constants is None else (constants,)
        names, lines = loop_source(
            goal,
            skips,
            constants is not None,
            "None" if record is None else "record_of(payload, ray)",
            "return",
        )
        head = f"def run_program(i, {', '.join(names)}):"
        text = "\n".join([head, *(f"    {line}" for line in lines), "    return"]) + "\n"
        self.kernel = _kernel(text, function, goal, record)

    @classmethod
    def of(cls, on_hit: Any, goal: Goal, record: Record | None = None) -> DeviceProgram:
        """The program of a query: its filter, or the function itself with the goal ``"trace"``."""
        if not isinstance(on_hit, Filter):
            return cls(on_hit, goal, record=record)
        bound = on_hit.bound
        constants = None if bound is None else bound.constants
        program = cls(on_hit.function, goal, skips=on_hit.skipped is not None, constants=constants)
        program._has_host_addresses = bound is not None and bound.kept is not None
        return program

    def arguments(
        self,
        rows: RowsAt,
        rays: RaysAt,
        scene: SceneAt,
        open_rays: np.uint64,
        skips: SkipsAt | None,
        goal: Iterable[Any],
    ) -> tuple[Any, ...]:
        """The kernel's arguments after the index of an entry."""
        own = () if skips is None else (skips,)
        return (rows, rays, scene, open_rays, *own, *self._constants, *goal)

    def typical(self) -> tuple[Any, ...]:
        """Arguments with the right types only."""
        return self.arguments(
            RowsAt.nowhere(),
            RaysAt.nowhere(),
            SceneAt(_AT, _AT, _AT, _AT),
            _AT,
            SkipsAt(_AT, _AT) if self._skips else None,
            _GOALS[self._goal],
        )

    def reason_against(self, capability: tuple[int, int]) -> str | None:
        """Why it has to run on the CPU; None if it runs on GPUs of a compute capability."""
        if self._has_host_addresses:
            return "its constants are addresses on the host"
        if self._record is not None and not is_aligned(self._record[0]):
            return "the fields of its payload are not aligned"
        return self.kernel.reason_against(self.typical(), capability)


def _kernel(
    text: str, function: Callable[..., Any], goal: Goal, record: Record | None
) -> UserKernel:
    """Make a kernel, or reuse that of a function with the same fingerprint."""
    key = fingerprint(function)
    place = function if key is None else key, text, record
    if place not in _MADE:
        while len(_MADE) >= _KEPT_KERNELS:
            del _MADE[next(iter(_MADE))]
        names = {**loop_globals(goal), "function": as_device(function)}
        if record is not None:
            names["record_of"] = record_at(*record)
        _MADE[place] = UserKernel(kernel_from_source(text, names, __name__), function)
    return _MADE[place]

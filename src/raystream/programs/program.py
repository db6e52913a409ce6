"""Program: a user's function, compiled into a loop over the hits of a query."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raystream.core.store import Store
from raystream.jit.user_loops import Loop, compile_loop
from raystream.kernels.hits import HitBatch
from raystream.programs.hits import RaysAt, RowsAt
from raystream.programs.loop_source import Goal, loop_globals, loop_source
from raystream.programs.ray_subset import PendingRays
from raystream.programs.rows import SkipsAt
from raystream.programs.scene_forms import form_of

#: Expressions that read a payload, by its number of dimensions; 0 without a payload.
_RECORDS = {0: "None", 1: "payload[ray]", 2: "row_of(payload, ray)"}


class Program:
    """A user's function in a loop over hits.

    Parameters
    ----------
    function : callable
        Takes a `Hit`, for the goal ``"trace"`` a payload record, and constants if there are any.
    goal : {"trace", "first", "count", "multi"}
    skipped : ndarray of shape (N, k) or (N, k, 2), int32, optional
        Triangles that rays skip; see `rows.skipped_triangles`.
    arguments : tuple
        Arguments of the goal's loop: the payload's array or None; the output of hits or counts,
        by rays of the batch; for ``"multi"`` the hits found so far and the most.
    triangles : Store
        Those of the scene; the program keeps their arrays alive.
    constants : tuple, optional
        The function's last argument.

    Raises
    ------
    TypeError
        If it is not a function of this number of arguments.
    """

    def __init__(
        self,
        function: Callable[..., Any],
        goal: Goal,
        skipped: NDArray[np.int32] | None,
        arguments: tuple[Any, ...],
        triangles: Store,
        constants: tuple[Any, ...] | None = None,
    ) -> None:
        self.name = check_function(function, goal, constants is not None)
        payload = arguments[0] if goal == "trace" else None
        record = _RECORDS[0 if payload is None else payload.ndim]
        form = form_of(triangles)
        text = _text(goal, skipped is not None, constants is not None, record)
        text = form.heading + text
        self._loop: Loop = compile_loop(text, function, loop_globals(goal, form), __name__)
        self._scene, self._scene_arrays = form.addresses.of(triangles)
        skips = None if skipped is None else SkipsAt.of(skipped)
        own = [value for value in (skips, constants) if value is not None]
        self._arguments = (*own, *arguments)
        self._kept = skipped

    @property
    def compiled_count(self) -> int:
        """How often this process compiled its loop, rather than loading it from disk."""
        return self._loop.compiled_count

    def compile(self, *more: Any) -> None:
        """Compile the loop now: later errors are raised by the function itself.

        Parameters
        ----------
        *more
            See `run`.

        Raises
        ------
        TypeError
            If the function cannot be compiled.
        """
        nowhere = RowsAt.nowhere(), RaysAt.nowhere(), self._scene, np.uint64(0)
        try:
            self._loop(0, 0, *nowhere, *self._arguments, *more)
        except TypeError:
            raise
        except Exception as error:  # from inside Numba, such as a field that a record lacks
            reason = f"{type(error).__name__}: {error}"
            raise TypeError(f"{self.name}: Numba cannot compile it: {reason}") from error

    def run(self, found: HitBatch, pending: PendingRays, *more: Any) -> int:
        """Run it over the rows of some rays, on the calling thread.

        Parameters
        ----------
        found : HitBatch
        pending : PendingRays
            The rays that were traced; those that end are closed.
        *more
            The goal's last argument, if each part has its own.

        Returns
        -------
        int
            Rows that it visited.

        Raises
        ------
        RuntimeError
            If the function raised an exception.
        """
        rows = RowsAt.of(found.hits, found.splits, pending.delivered)
        rays = RaysAt.of(pending.source, *pending.rays.places, found.ids, found.first)
        open_rays = np.uint64(pending.open_rays.ctypes.data)
        try:
            return int(
                self._loop(
                    0, len(found), rows, rays, self._scene, open_rays, *self._arguments, *more
                )
            )
        except Exception as error:
            reason = f": {error}" if str(error) else ""
            raise RuntimeError(f"{self.name}: raised {type(error).__name__}{reason}") from error


def _text(goal: Goal, skips: bool, constants: bool, record: str) -> str:
    """The loop over entries and their rows; it returns the number of rows visited."""
    names, lines = loop_source(goal, skips, constants, record, "continue")
    lines = [
        f"def loop(begin, end, {', '.join(names)}):",
        "    seen = zero",
        "    for i in range(unsigned(begin), unsigned(end)):",
        *(f"        {line}" for line in lines),
        "        seen += row - start",
        "    return seen",
    ]
    return "\n".join(lines) + "\n"


def check_function(function: Callable[..., Any], goal: Goal, has_constants: bool) -> str:
    """The name of a user's function, for errors.

    Raises
    ------
    TypeError
        If it is not a function of the arguments of a program.
    """
    name = getattr(function, "__name__", type(function).__name__)
    expected = ["hit", *(["payload"] if goal == "trace" else [])]
    expected += ["constants"] if has_constants else []
    code = getattr(getattr(function, "py_func", function), "__code__", None)
    if code is None:
        raise TypeError(f"on_hit: expected a Python function, got {type(function).__name__}")
    if code.co_argcount != len(expected) or code.co_kwonlyargcount:
        given = ", ".join(code.co_varnames[: code.co_argcount])
        raise TypeError(f"{name}: takes ({given}); expected ({', '.join(expected)})")
    return str(name)

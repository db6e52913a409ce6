"""Program: a user's function, compiled into a loop over the rows of a query's answer."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from raystream.jit.loops import Loop, compile_loop
from raystream.jit.programs import accept_decision, row_of
from raystream.jit.threads import parallel_for
from raystream.programs.decisions import IGNORE, STOP, Decision
from raystream.programs.hits import RaysAt, RowsAt, SceneAt, hit_at, ray_at, row_range
from raystream.programs.rows import SkipsAt, is_skipped, move_row, put_row

__all__ = ["CHUNK", "Goal", "Program"]

#: What becomes of hits: given to a program with a record, or kept by a filter as the nearest,
#: counted, or kept in order.
Goal = Literal["trace", "first", "count", "multi"]

#: Rays that a thread takes at a time.
CHUNK = 1 << 14

#: Statements at the beginning of a ray, at a hit that exists, and at the end of a ray.
_STATEMENTS: dict[str, tuple[list[str], list[str], list[str]]] = {
    "trace": ([], [], []),
    "first": ([], ["put_row(out, ray, rows, row)", "is_open = zero", "break"], []),
    "count": ([], ["out[ray] += 1"], []),
    "multi": (
        ["to = row"],
        [
            "move_row(rows, row, to)",
            "to += one",
            "found[ray] += 1",
            "if found[ray] == most:",
            "    is_open = zero",
            "    break",
        ],
        ["kept[i] = to - start"],
    ),
}

_PARAMETERS = {
    "trace": ["payload"],
    "first": ["out"],
    "count": ["out"],
    "multi": ["found", "most", "kept"],
}

#: How a program's payload is read, by the array's number of dimensions; 0 without one.
_RECORDS = {0: "None", 1: "payload[ray]", 2: "row_of(payload, ray)"}


def _text(goal: Goal, skips: bool, dimensions: int) -> str:
    """The loop over rays and their rows; it returns the number of rows that it looked at."""
    before, at_hit, after = _STATEMENTS[goal]
    payload = f", {_RECORDS[dimensions]}" if goal == "trace" else ""
    names = ["begin", "end", "rows", "rays", "scene", "open_rays"]
    names += [*(["skips"] if skips else []), *_PARAMETERS[goal]]
    skipped = ["        if is_skipped(skips, ray, rows, row):", "            row += one"]
    lines = [
        f"def loop({', '.join(names)}):",
        "    seen = zero",
        "    for i in range(unsigned(begin), unsigned(end)):",
        "        ray = ray_at(rays, i)",
        "        row, row_end = row_range(rows, i)",
        "        start = row",
        "        is_open = one",
        *(f"        {line}" for line in before),
        "        while row != row_end:",
        *([f"    {line}" for line in [*skipped, "            continue"]] if skips else []),
        "            hit = hit_at(rows, row, rays, i, ray, scene)",
        f"            decision = accept(function(hit{payload}))",
        *([] if goal == "trace" else ["            if decision != ignore:"]),
        *(f"                {line}" for line in at_hit),
        "            row += one",
        "            if decision == stop:",
        "                is_open = zero",
        "                break",
        "        seen += row - start",
        "        open_rays[i] = is_open != zero",
        *(f"        {line}" for line in after),
        "    return seen",
    ]
    return "\n".join(lines) + "\n"


def _names(goal: Goal) -> dict[str, Any]:
    return {
        "accept": accept_decision(Decision, goal != "trace"),
        "hit_at": hit_at,
        "ignore": np.int64(IGNORE),
        "is_skipped": is_skipped,
        "move_row": move_row,
        "one": np.uint64(1),
        "put_row": put_row,
        "ray_at": ray_at,
        "row_of": row_of,
        "row_range": row_range,
        "stop": np.int64(STOP),
        "unsigned": np.uint64,
        "zero": np.uint64(0),
    }


class Program:
    """A user's function in a loop over hits.

    Parameters
    ----------
    function : callable
        Takes a `Hit`, and with the goal ``"trace"`` a payload record.
    goal : {"trace", "first", "count", "multi"}
    skips : SkipsAt, optional
        Triangles that do not exist for a ray.
    arguments : tuple
        What the goal's loop takes: the payload's array or None; where hits or counts go, by
        rays of the batch; for ``"multi"`` the hits found so far and the most.

    Raises
    ------
    TypeError
        If it is no function of so many arguments.
    """

    def __init__(
        self,
        function: Callable[..., Any],
        goal: Goal,
        skips: SkipsAt | None,
        arguments: tuple[Any, ...],
    ) -> None:
        self.name = getattr(function, "__name__", type(function).__name__)
        expected = ("hit", "payload") if goal == "trace" else ("hit",)
        _check_arguments(self.name, function, expected)
        payload = arguments[0] if goal == "trace" else None
        dimensions = 0 if payload is None else payload.ndim
        text = _text(goal, skips is not None, dimensions)
        self._loop: Loop = compile_loop(text, function, _names(goal), __name__)
        self._arguments = (*(() if skips is None else (skips,)), *arguments)

    @property
    def compiled_count(self) -> int:
        """How often this process compiled its loop, rather than find it on disk."""
        return self._loop.compiled_count

    def run(
        self,
        count: int,
        rows: RowsAt,
        rays: RaysAt,
        scene: SceneAt,
        *more: Any,
    ) -> tuple[NDArray[np.bool_], int]:
        """Run it over the rows of `count` rays, on all threads.

        Parameters
        ----------
        count : int
        rows, rays, scene
            Where the rows, the rays asked about and the triangles lie.
        *more
            The goal's last argument, if it is made for each answer.

        Returns
        -------
        open_rays : ndarray of shape (count,), bool
            Which rays did not end.
        seen : int
            Rows that it looked at.

        Raises
        ------
        TypeError
            If the function cannot be compiled.
        RuntimeError
            If it raised something.
        """
        open_rays = np.empty(count, np.bool_)
        arguments = (rows, rays, scene, open_rays, *self._arguments, *more)
        seen: list[int] = []
        self._compile(arguments)

        def body(begin: int, end: int) -> None:
            try:
                seen.append(self._loop(begin, end, *arguments))
            except Exception as error:
                reason = f": {error}" if str(error) else ""
                message = f"{self.name}: raised {type(error).__name__}{reason}"
                raise RuntimeError(message) from error

        parallel_for(body, count, CHUNK)
        return open_rays, int(sum(seen))

    def _compile(self, arguments: tuple[Any, ...]) -> None:
        """Run the loop over nothing: what is raised later is the function's own."""
        try:
            self._loop(0, 0, *arguments)
        except TypeError:
            raise
        except Exception as error:  # from inside Numba, such as a field that a record lacks
            reason = f"{type(error).__name__}: {error}"
            raise TypeError(f"{self.name}: Numba cannot compile it: {reason}") from error


def _check_arguments(name: str, function: Callable[..., Any], expected: tuple[str, ...]) -> None:
    code = getattr(getattr(function, "py_func", function), "__code__", None)
    if code is None:
        raise TypeError(f"on_hit: expected a Python function, got {type(function).__name__}")
    if code.co_argcount != len(expected) or code.co_kwonlyargcount:
        given = ", ".join(code.co_varnames[: code.co_argcount])
        raise TypeError(f"{name}: takes ({given}); expected ({', '.join(expected)})")

"""Program: a user's function, compiled into a loop over the rows of a query's answer."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Literal

import numpy as np

from raystream.core.triangles import Triangles
from raystream.jit.loops import Loop, compile_loop
from raystream.jit.programs import accept_decision, row_of
from raystream.programs.asked import Piece
from raystream.programs.decisions import IGNORE, STOP, Decision
from raystream.programs.hits import (
    RaysAt,
    RowsAt,
    SceneAt,
    hit_at,
    position_at,
    ray_at,
    row_range,
)
from raystream.programs.rows import SkipsAt, is_skipped, move_row, put_row
from raystream.structures.found import Found

__all__ = ["Goal", "Program"]

#: What becomes of hits: given to a program with a record, or kept by a filter as the nearest,
#: counted, or kept in order.
Goal = Literal["trace", "first", "count", "multi"]

#: Statements at the beginning of a ray, at a hit that exists, and at the end of a ray.
_STATEMENTS: dict[str, tuple[list[str], list[str], list[str]]] = {
    "trace": ([], [], []),
    "first": (
        [],
        ["put_row(out, ray, rows, row)", "open_rays[position] = False", "break"],
        ["if start == row_end:", "    open_rays[position] = False"],
    ),
    "count": ([], ["out[ray] += 1"], []),
    "multi": (
        ["to = row"],
        [
            "move_row(rows, row, to)",
            "to += one",
            "found[ray] += 1",
            "if found[ray] == most:",
            "    open_rays[position] = False",
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


def _text(goal: Goal, skips: bool, constants: bool, dimensions: int) -> str:
    """The loop over entries and their rows; it returns the number of rows that it looked at."""
    before, at_hit, after = _STATEMENTS[goal]
    more = f", {_RECORDS[dimensions]}" if goal == "trace" else ""
    more += ", constants" if constants else ""
    names = ["begin", "end", "rows", "rays", "scene", "open_rays"]
    names += [*(["skips"] if skips else []), *(["constants"] if constants else [])]
    names += _PARAMETERS[goal]
    skipped = ["        if is_skipped(skips, ray, rows, row):", "            row += one"]
    lines = [
        f"def loop({', '.join(names)}):",
        "    seen = zero",
        "    for i in range(unsigned(begin), unsigned(end)):",
        "        position = position_at(rays, i)",
        "        if not open_rays[position]:",
        "            continue",
        "        ray = ray_at(rays, position)",
        "        row, row_end = row_range(rows, i)",
        "        start = row",
        *(f"        {line}" for line in before),
        "        while row != row_end:",
        *([f"    {line}" for line in [*skipped, "            continue"]] if skips else []),
        "            hit = hit_at(rows, row, rays, position, ray, scene)",
        f"            decision = accept(function(hit{more}))",
        *([] if goal == "trace" else ["            if decision != ignore:"]),
        *(f"                {line}" for line in at_hit),
        "            row += one",
        "            if decision == stop:",
        "                open_rays[position] = False",
        "                break",
        "        seen += row - start",
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
        "position_at": position_at,
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
        Takes a `Hit`, with the goal ``"trace"`` a payload record, and constants if there are any.
    goal : {"trace", "first", "count", "multi"}
    skips : SkipsAt, optional
        Triangles that do not exist for a ray.
    arguments : tuple
        What the goal's loop takes: the payload's array or None; where hits or counts go, by
        rays of the batch; for ``"multi"`` the hits found so far and the most.
    triangles : Triangles
        What is hit; the program keeps it.
    constants : tuple, optional
        Handed to the function as its last argument.

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
        triangles: Triangles,
        constants: tuple[Any, ...] | None = None,
    ) -> None:
        self.name = getattr(function, "__name__", type(function).__name__)
        expected = ["hit", *(["payload"] if goal == "trace" else [])]
        expected += [] if constants is None else ["constants"]
        _check_arguments(self.name, function, expected)
        payload = arguments[0] if goal == "trace" else None
        dimensions = 0 if payload is None else payload.ndim
        text = _text(goal, skips is not None, constants is not None, dimensions)
        self._loop: Loop = compile_loop(text, function, _names(goal), __name__)
        own = [value for value in (skips, constants) if value is not None]
        self._arguments = (*own, *arguments)
        self._triangles = triangles
        self._scene = SceneAt.of(triangles)

    @property
    def compiled_count(self) -> int:
        """How often this process compiled its loop, rather than find it on disk."""
        return self._loop.compiled_count

    def compile(self, *more: Any) -> None:
        """Run the loop over nothing: what is raised later is the function's own.

        Parameters
        ----------
        *more
            See `run`.

        Raises
        ------
        TypeError
            If the function cannot be compiled.
        """
        nothing = np.empty(0, np.bool_)
        nowhere = RowsAt.nowhere(), RaysAt.nowhere()
        try:
            self._loop(0, 0, *nowhere, self._scene, nothing, *self._arguments, *more)
        except TypeError:
            raise
        except Exception as error:  # from inside Numba, such as a field that a record lacks
            reason = f"{type(error).__name__}: {error}"
            raise TypeError(f"{self.name}: Numba cannot compile it: {reason}") from error

    def run(self, found: Found, piece: Piece, *more: Any) -> int:
        """Run it over the rows of some rays, on the calling thread.

        Parameters
        ----------
        found : Found
        piece : Piece
            The rays that were asked about; those that end are closed.
        *more
            The goal's last argument, if it is made for each part.

        Returns
        -------
        int
            Rows that it looked at.

        Raises
        ------
        RuntimeError
            If the function raised something.
        """
        rows = RowsAt.of(found.hits, found.splits, piece.delivered)
        rays = RaysAt.of(piece.source, *piece.asked.places, found.ids, found.first)
        arguments = rows, rays, self._scene, piece.open_rays, *self._arguments, *more
        try:
            return int(self._loop(0, len(found), *arguments))
        except Exception as error:
            reason = f": {error}" if str(error) else ""
            raise RuntimeError(f"{self.name}: raised {type(error).__name__}{reason}") from error


def _check_arguments(name: str, function: Callable[..., Any], expected: list[str]) -> None:
    code = getattr(getattr(function, "py_func", function), "__code__", None)
    if code is None:
        raise TypeError(f"on_hit: expected a Python function, got {type(function).__name__}")
    if code.co_argcount != len(expected) or code.co_kwonlyargcount:
        given = ", ".join(code.co_varnames[: code.co_argcount])
        raise TypeError(f"{name}: takes ({given}); expected ({', '.join(expected)})")

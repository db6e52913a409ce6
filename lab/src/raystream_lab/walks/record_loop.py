"""The generated loop that records walks: the multipass kernels on one ray from start to end."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from raystream.jit.simd import load
from raystream.jit.user_loops import Loop, compile_loop
from raystream.kernels.tally import ROW
from raystream.machines.records import FOUND, RAY, WANTED, RayState
from raystream.machines.steps.base import StepKernel, Steps
from raystream.streams.layout import Layout
from raystream_lab.walks.kernels.visited_places import cell_of, node_of


class VisitedPlaces(NamedTuple):
    """The visits to a structure that can be recorded.

    Attributes
    ----------
    place_of : device function
        Maps (tree, place) to the number of a cell or node, uint32.
    states : frozenset of RayState
        States of the kernels whose steps visit one.
    """

    place_of: Callable[..., Any]
    states: frozenset[RayState]


_VISITS = {
    "grid": VisitedPlaces(cell_of, frozenset({RayState.TRAVERSING})),
    "kdtree": VisitedPlaces(
        node_of, frozenset({RayState.TRAVERSING, RayState.AT_LEAF, RayState.BACKTRACKING})
    ),
}


def visits_of(structure: str) -> VisitedPlaces | None:
    """The visits of steps through a structure; None if they cannot be recorded."""
    return _VISITS.get(structure)


def search_loop(structure: str, steps: Steps) -> Loop:
    """Generate the loop over rays for a structure, compiled once per structure.

    Parameters
    ----------
    structure : str
        Its name.
    steps : Steps

    Returns
    -------
    Loop
        ``loop(begin, end, rays, tree, query, found, place, is_recording, has_visits, run_splits,
        run_kernels, run_lengths, visit_splits, visits)``. `found` and `place` are records of the
        streams of these names, one of each. Without `is_recording`, the number of runs of ray i is
        written to run_splits[i + 1]. With it, its runs are written from row run_splits[i], and with
        `has_visits` also its visits, from row visit_splits[i]: a pass must then be one step
        (``query.steps``).
    """
    own = visits_of(structure)
    states = own.states if own else frozenset()
    text = "\n".join(_lines(structure, steps, states)) + "\n"
    names: dict[str, Any] = {f"step_{k}": one.function for k, one in enumerate(steps.kernels)}
    names |= {
        "Ray": Layout(RAY).record,
        "Wanted": Layout(WANTED).record,
        "Found": Layout(FOUND).record,
        "Place": Layout(steps.place).record,
        "load": load,
        "u8": np.uint8,
        "u32": np.uint32,
        "u64": np.uint64,
        "ROW": ROW,
    }
    return compile_loop(text, own.place_of if own else node_of, names, __name__)


def _lines(structure: str, steps: Steps, states: frozenset[RayState]) -> list[str]:
    """The lines of the loop."""
    body = []
    for number, one in enumerate(steps.kernels):
        body += [
            f"            {'elif' if number else 'if'} state == u8({int(one.state)}):",
            *(f"                {line}" for line in _step(number, one, steps, one.state in states)),
        ]
    return [
        f"# {structure}: {[(one.name, int(one.state), one.outputs) for one in steps.kernels]}",
        "def loop(begin, end, rays, tree, query, found, place, is_recording, has_visits,",
        "         run_splits, run_kernels, run_lengths, visit_splits, visits):",
        "    o, d = rays.origins, rays.directions",
        "    for i in range(u64(begin), u64(end)):",
        "        ray = Ray((o[i, 0], o[i, 1], o[i, 2]), (d[i, 0], d[i, 1], d[i, 2]),",
        "                  rays.t_min[i], rays.t_max[i])",
        "        wanted = Wanted(i, u64(1), u32(i))",
        "        counted = query.runs + i * ROW",
        "        row, visit = u64(0), u64(0)",
        "        if is_recording:",
        "            row, visit = u64(run_splits[i]), u64(visit_splits[i])",
        f"        state, latest = u8({int(RayState.STARTING)}), u8(255)",
        "        while True:",
        *body,
        "            else:",
        "                break",
        "            if kernel != latest:",
        "                if is_recording:",
        "                    run_kernels[row], run_lengths[row] = kernel, u32(0)",
        "                row += u64(1)",
        "                latest = kernel",
        "            if is_recording:",
        "                run_lengths[row - u64(1)] += u32(ticks)",
        "        if not is_recording:",
        "            run_splits[i + u64(1)] = row",
    ]


def _step(number: int, one: StepKernel, steps: Steps, has_places: bool) -> list[str]:
    """Code that runs one kernel on a ray and counts its steps."""
    layouts = {"found": Layout(FOUND), "place": Layout(steps.place)}
    place = layouts["place"].load("place", ["0"], "Place")
    known = {
        "ray": "ray",
        "wanted": "wanted",
        "tree": "tree",
        "query": "query",
        "kernel": f"u64({number})",
        "found": layouts["found"].load("found", ["0"], "Found"),
        "place": place,
    }
    names = [name for name in _parameters(one) if name in known]
    count = f"load(u32, counted + u64({4 * number}))"
    lines = [f"kernel = u8({number})"]
    if has_places:
        lines += [
            "if has_visits:",
            f"    visits[visit] = function(tree, {place})",
            "    visit += u64(1)",
        ]
    lines += [
        f"before = {count}",
        f"result = step_{number}({', '.join(known[name] for name in names)})",
    ]
    for part, name in enumerate(one.outputs):
        lines += layouts[name].store(name, "0", f"result[{part}]")
    state = f"result[{len(one.outputs)}]" if one.outputs else "result"
    return [*lines, f"state = u8({state})", f"ticks = {count} - before"]


def _parameters(one: StepKernel) -> list[str]:
    code = getattr(one.function, "py_func", one.function).__code__
    return list(code.co_varnames[: code.co_argcount])

"""Descriptions of steps, and the sections of the papers that define them."""

from __future__ import annotations

from raystream.machines.records import RayState
from raystream.stepper.maps import GraphMap, GridMap, KdMap
from raystream.stepper.structure_map import StructureMap
from raystream.stepper.walk import Step, Walk
from raystream.structures.kdtree.traversals.short_stack import PLACES

__all__ = ["sentence", "source"]

_AXES = "xyz"

_SHADER = "Purcell 2002, section 3.1.4 (shader)"

#: Sections by structure and kernel.
_SOURCES = {
    "grid": {
        "set up": "Purcell 2002, sections 3.1.1 (test of the scene's box) and 3.1.2 (set-up)",
        "traverse": "Purcell 2002, section 3.1.2 (traverser: one cell)",
        "intersect": "Purcell 2002, section 3.1.3 (intersector)",
        "shade": _SHADER,
    },
    "kdtree": {
        "initialize": "Foley 2005, section 2.1 (kd-search; in 3.3 Initialize)",
        "down": "Foley 2005, section 2.1 (search-split; in 3.3 Down)",
        "leaf": "Foley 2005, section 2.1 (search-leaf; in 3.3 Leaf)",
        "intersect": "Foley 2005, section 2.1 (search-leaf; in 3.3 Intersect)",
        "up": "Foley 2005, section 2.3 (backtrack; in 3.3 Up)",
        "shade": _SHADER,
    },
    "graph": {
        "set up": "Rayforce 2013, section 2 (bins give the first sector)",
        "traverse": "Rayforce 2013, section 2 (sectors and links)",
        "intersect": "Rayforce 2013, section 2 (all primitives of a sector)",
        "shade": _SHADER,
    },
}

#: Sections on continue-search, which differs between Foley's traversals and Horn's.
_CONTINUE = {
    "stack": "Foley 2005, section 2.1 (continue-search with a stack; in 3.3 Continue)",
    "restart": "Foley 2005, section 2.2 (kd-restart; in 3.3 Continue)",
    "backtrack": "Foley 2005, section 2.3 (kd-backtrack; in 3.3 Continue)",
    "short-stack": "Horn 2007 (push-down and short-stack; Foley 2005, 3.3 Continue)",
}


def source(walked: Walk, step: Step) -> str:
    """The paper and section that describe a step."""
    if step.kernel == "continue":
        return _CONTINUE[walked.traversal or "stack"]
    return _SOURCES[walked.structure][step.kernel]


def sentence(walked: Walk, step: Step, chart: StructureMap) -> str:
    """Describe a step.

    Parameters
    ----------
    walked : Walk
    step : Step
        One of its steps.
    chart : StructureMap
        Of the traversed structure.

    Returns
    -------
    str
    """
    if step.kernel == "shade":
        return f"Return the hit: triangle {step.prim_id} at t = {_number(step.t)}."
    if step.at is None:
        return _begin(step, chart)
    if isinstance(chart, KdMap):
        return _in_tree(walked, step, chart)
    if step.kernel == "intersect":
        return f"{_test(step)} {_after_tests(step, chart)}"
    return _visit(step, chart)


def _begin(step: Step, chart: StructureMap) -> str:
    """Describe the set-up in any structure."""
    spot = step.to
    if spot is None:
        return "The ray misses the scene's box: there is nothing to search."
    enters = f"The ray enters the scene's box at t = {_number(spot.t_in)}"
    if isinstance(chart, KdMap):
        return f"{enters} and leaves it at t = {_number(spot.t_out)}: start at the root."
    if isinstance(chart, GridMap):
        return f"{enters}, in {chart.label(spot.number)}."
    return f"{enters}. From the bin of that point the search finds {chart.label(spot.number)}."


def _visit(step: Step, chart: StructureMap) -> str:
    """Describe the visit of a cell or sector."""
    assert step.at is not None
    assert step.to is not None
    name = _capital(chart.label(step.at.number))
    if step.after is RayState.INTERSECTING:
        count = _triangles(chart.list_size(step.at.number))
        verb = "lists" if isinstance(chart, GridMap) else "bounds"
        return f"{name} {verb} {count}: the ray waits for the intersection kernel."
    if step.to.number == step.at.number:
        if step.after is RayState.TRAVERSING:
            return f"{name} is divided into finer cells: traverse these."
        return f"{name} is empty and the last one: the search ends."
    return f"{name} is empty: {_onward(step, chart)}"


def _after_tests(step: Step, chart: StructureMap) -> str:
    """Describe the state after testing a triangle in a grid or a block in a graph."""
    assert step.at is not None
    assert step.to is not None
    if step.after is RayState.INTERSECTING:
        return "The list continues."
    if step.after is RayState.TRAVERSING:
        return f"The list ends: {_onward(step, chart)}"
    if step.prim_id < 0:
        return "The list ends, and so does the ray: a miss."
    where = "cell" if isinstance(chart, GridMap) else "sector"
    return f"The list ends with a hit in this {where}: nothing behind it can be nearer."


def _onward(step: Step, chart: StructureMap) -> str:
    assert step.to is not None
    label = chart.label(step.to.number)
    if not isinstance(chart, GraphMap):
        return f"step to {label}, which the ray enters at t = {_number(step.to.t_in)}."
    count = step.counts.get("link_nodes", 0)
    planes = "" if not count else f", past {count} separation plane{'s' if count > 1 else ''},"
    return f"the link of its {step.face} face leads{planes} to {label}."


def _in_tree(walked: Walk, step: Step, chart: KdMap) -> str:
    """Describe a step of a kd-tree's kernels, except the first one."""
    assert step.at is not None
    assert step.to is not None
    at, to = step.at, step.to
    name, target = _capital(chart.label(at.number)), chart.label(to.number)
    if step.kernel == "down":
        return f"{name} at {_plane(chart, at.number)}: {_choice(walked, step, chart)}"
    if step.kernel == "leaf":
        count = chart.list_size(at.number)
        if not count:
            return f"{name} is empty."
        return f"{name} lists {_triangles(count)}: the ray waits for the intersection kernel."
    if step.kernel == "intersect":
        rest = "The list continues." if step.after is step.before else "Done here."
        return f"{_test(step)} {rest}"
    if step.kernel == "up":
        if step.after is RayState.BACKTRACKING:
            return f"Climb to {target}: the ray left its box before t = {_number(to.t_in)}."
        return f"Climb to {target}: its box still holds the ray at t = {_number(to.t_in)}. Descend."
    if step.after in (RayState.DONE, RayState.SHADING):
        if step.prim_id < 0:
            return f"No hit in {chart.label(at.number)}, and nothing is left of the ray: a miss."
        return (
            f"The hit at t = {_number(step.t)} lies in {chart.label(at.number)}: "
            "leaves behind it cannot hold a nearer one."
        )
    missed = f"No hit in {chart.label(at.number)}:"
    if step.counts.get("restarts") and walked.traversal == "short-stack":
        return (
            f"{missed} the next entry was dropped; restart at {target}, which contains all that is "
            f"left, with t from {_number(to.t_in)}."
        )
    if walked.traversal in ("stack", "short-stack"):
        return f"{missed} pop {target}, with t from {_number(to.t_in)} to {_number(to.t_out)}."
    if walked.traversal == "restart":
        return f"{missed} restart at the root, with t from {_number(to.t_in)}."
    return f"{missed} move the start to t = {_number(to.t_in)}, and climb."


def _choice(walked: Walk, step: Step, chart: KdMap) -> str:
    """Describe which child a descent visits."""
    assert step.at is not None
    assert step.to is not None
    at, to = step.at, step.to
    first = chart.children[at.number]
    upward = walked.direction[chart.axes[at.number]] > 0.0
    near = first if upward else first + 1
    target = chart.label(to.number)
    if to.t_out < at.t_out:
        other = chart.label(int(2 * first + 1 - to.number))
        deferred = {
            "stack": f"push {other}",
            "restart": f"drop {other} until a restart",
            "backtrack": f"leave {other} to be found by climbing",
            "short-stack": f"push {other}, and drop the oldest of more than {PLACES}",
        }[walked.traversal or "stack"]
        cut = f"its plane cuts the interval at t = {_number(to.t_out)}"
        return f"{cut}. Near child {target} first; {deferred}."
    where = "ahead of" if to.number == near else "behind"
    return f"its plane lies {where} the interval, so {target} contains all of it."


def _plane(chart: KdMap, number: int) -> str:
    return f"{_AXES[chart.axes[number]]} = {_number(float(chart.planes[number]))}"


def _test(step: Step) -> str:
    """Describe the tested triangles and the result."""
    assert step.at is not None
    numbers = ", ".join(map(str, step.tested))
    plural = "s" if len(step.tested) > 1 else ""
    where = f"in this {step.at.kind}"
    if step.prim_id in step.tested:
        found = f"nearest hit so far: {step.prim_id} at t = {_number(step.t)}"
    else:
        found = f"no hit {where}" if step.prim_id < 0 else f"nothing nearer {where}"
    return f"Test triangle{plural} {numbers}; {found}."


def _triangles(count: int) -> str:
    return "1 triangle" if count == 1 else f"{count} triangles"


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]


def _number(number: float) -> str:
    return f"{number:.2f}"

"""Foley's four scenes, and the trees and counts shared by the experiments."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from types import MappingProxyType
from typing import Any

import numpy as np

from raystream.core.query import Kind, Query
from raystream.core.rays import RayBatch
from raystream.jit.threads import Progress
from raystream.machines import Branching, RayCounters
from raystream.machines.backend import Backend
from raystream.machines.counters import answer_counting
from raystream.scene.scene import Scene
from raystream.structures import Structure, build_structure
from raystream.structures.kdtree.options import KdTree
from raystream.structures.kdtree.structure import KdTreeStructure
from raystream_lab.foley.settings import PBRT_BONUS
from raystream_lab.published import published
from raystream_lab.results import Result
from raystream_lab.runner import Runner
from raystream_lab.views import View

#: The paper's traversals, with a stack for reference.
TRAVERSALS = ("stack", "restart", "backtrack")

#: Width and height of Foley's images, section 4.
SIZE = 512

#: Seconds of all rounds together, after which a structure is not timed again.
PATIENCE = 8.0

#: Names for `load` by the names of the published figures.
SCENES = MappingProxyType(
    {"cornell": "cornell_open", "bunny": "bunny", "robots": "bart_robots", "kitchen": "kitchen"}
)

#: Sums over all rays by traversal.
States = dict[str, dict[str, int]]


def available_views(
    runner: Runner, names: Sequence[str], result: Result
) -> Iterator[tuple[str, View]]:
    """Yield the available scenes; add a note for each missing one."""
    return result.available(names, lambda name: runner.view(SCENES[name]))


def foley_tree(scene: Scene, progress: Progress | None = None, **options: Any) -> KdTreeStructure:
    """Build a tree as in Foley 2005, section 3.2: packed, steps of 8 tests' cost, pbrt's bonus.

    Parameters
    ----------
    scene : Scene
    progress : callable, optional
        Called with (triangles placed, triangles).
    **options
        Options of ``"kdtree"`` that replace Foley's or raystream's.
    """
    cost = float(published("foley", "claims").values["traversal_cost"])
    chosen = {
        "layout": "foley",
        "traversal": "backtrack",
        "traversal_cost": cost,
        "empty_bonus": PBRT_BONUS,
        **options,
    }
    return KdTreeStructure(scene.triangles, KdTree(**chosen), progress=progress)


def foley_trees(
    scene: Scene, progress: Progress | None = None, **options: Any
) -> dict[str, KdTreeStructure]:
    """One tree with each of `TRAVERSALS`."""
    tree = foley_tree(scene, progress, **options)
    return {traversal: tree.with_traversal(traversal) for traversal in TRAVERSALS}


def foley_structures(
    scene: Scene, name: str, progress: Progress | None = None
) -> dict[str, Structure]:
    """The structures of Table 1, and a stack and a BVH for reference.

    Parameters
    ----------
    scene : Scene
    name : str
        A key of `SCENES`, for the grid's resolution.
    progress : callable, optional
        Called with (triangles placed, triangles).
    """
    resolution = published("foley", "scenes").values[name]["resolution"]
    trees = foley_trees(scene, progress)
    return {
        "brute": build_structure("brute", scene.triangles),
        "grid": build_structure("grid", scene.triangles, resolution=resolution),
        "restart": trees["restart"],
        "backtrack": trees["backtrack"],
        "stack": trees["stack"],
        "bvh": build_structure("bvh", scene.triangles, progress=progress),
    }


def trace_counters(
    machine: Structure | Backend,
    origins: Any,
    directions: Any,
    *,
    t_max: Any = np.inf,
    any_hit: bool = False,
    progress: Progress | None = None,
) -> RayCounters:
    """Counters of a first-hit or any-hit query."""
    backend = Branching(machine) if isinstance(machine, Structure) else machine
    query = Query(Kind.ANY_HIT if any_hit else Kind.FIRST_HIT)
    batch = RayBatch(origins, directions, 0.0, t_max)
    return answer_counting(backend, query, batch, progress)[1]


def mean_counts(counters: RayCounters) -> dict[str, float]:
    """Mean ``steps`` down and up, ``leaves`` and ``tests`` per ray."""
    total, count = counters.total, counters.steps.size
    return {
        "steps": (total["steps"] + total["backtrack_steps"]) / count,
        "leaves": total["leaves"] / count,
        "tests": total["tests"] / count,
    }


def count_states(trees: dict[str, KdTreeStructure], origins: Any, directions: Any) -> States:
    """Count ray states in each traversal (Foley 2005, Table 2).

    Returns
    -------
    dict of str to dict of str to int
        By traversal, `RayCounters.total` and the number of ``rays``.
    """
    found: States = {}
    for traversal, tree in trees.items():
        counters = trace_counters(tree, origins, directions)
        found[traversal] = {"rays": counters.steps.size, **counters.total}
    return found


def figures_of(found: States) -> dict[str, float]:
    """The figures of Table 2, in millions for an image of Foley's size.

    Parameters
    ----------
    found : dict
        From `count_states`.

    Returns
    -------
    dict of str to float
        ``down``: of the stack, and of backtrack by Foley's count; ``up``; ``restart down``;
        ``intersect``; ``transitions``: leaves.

    Notes
    -----
    After a climb, our backtrack runs Down once more, on the split whose far side is next. Foley's
    does not, or counts it as Up: his Down "is exactly the number of search steps that the
    stack-based approach would have required". These runs are omitted here.
    """
    restart, backtrack = found["restart"], found["backtrack"]
    share = SIZE**2 / backtrack["rays"] / 1e6
    return {
        "down": share * (backtrack["steps"] - backtrack["backtracks"]),
        "up": share * backtrack["backtrack_steps"],
        "restart down": share * restart["steps"],
        "intersect": share * backtrack["tests"],
        "transitions": share * backtrack["leaves"],
    }


def published_figures(name: str) -> dict[str, float]:
    """The same figures as published in Table 2, by scene name."""
    table = published("foley", "table 2").values
    restart, backtrack = table[f"{name} restart"], table[f"{name} backtrack"]
    return {
        "down": backtrack["down"],
        "up": backtrack["up"],
        "restart down": restart["down"],
        "intersect": backtrack["intersect"],
        "transitions": backtrack["transitions"],
    }

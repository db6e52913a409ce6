"""Worst-case bounds of kd-restart and kd-backtrack, checked on every ray (sections 2.2, 2.3)."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from raystream.structures.kdtree.structure import KdTreeStructure
from raystream_lab.foley.recorded_visits import TreeVisits, record_visits
from raystream_lab.foley.scenes import SCENES, SIZE, available_views, foley_trees, trace_counters
from raystream_lab.published import published
from raystream_lab.results import TOLERANCE, Cell, Claim, Result, Table, listed
from raystream_lab.runner import Runner
from raystream_lab.views import View

_SOURCE = "Foley 2005, section 2"

Found = dict[str, Any]


def bounds(runner: Runner) -> Result:
    """The most steps of any ray, over the bounds."""
    result = Result()
    found: dict[str, Found] = {}
    names = ("cornell", "robots") if runner.quick else tuple(SCENES)
    for name, view in available_views(runner, names, result):
        found[name] = _measured(runner, name, view)
    if not found:
        return result
    size = runner.size(SIZE)
    result.tables = [_table(found, size), _leaf_table(found)]
    result.claims = _claims(found)
    return result


def _measured(runner: Runner, name: str, view: View) -> Found:
    size = runner.size(SIZE)

    def measure() -> Found:
        trees = foley_trees(view.scene, runner.progress, layout="compact")
        return check_bounds(trees, *view.rays(size))

    found: Found = runner.measure(f"{name}, {size} x {size}", measure)
    return found


def check_bounds(trees: dict[str, KdTreeStructure], origins: Any, directions: Any) -> Found:
    """Compare every ray's steps with the bounds.

    Parameters
    ----------
    trees : dict of str to KdTreeStructure
        One tree with each traversal, layout ``"compact"``.
    origins, directions : array_like

    Returns
    -------
    dict
        ``rays``; ``height``, the splits on the longest path, and ``tree leaves``. ``restart``: the
        most splits of any ray over its leaves times the height, and ``rays over restart``.
        ``backtrack`` and ``backtrack, with the run after a climb``: the most steps down and up of
        any ray over a stack's, and ``rays over backtrack``. ``climbed to``: the most climbs of a
        ray to one node; ``never descended``: nodes that a ray climbs to without having been there.
        ``leaves``: mean, median, 99 % and most of a ray.
    """
    stack, restart, backtrack = (
        trace_counters(trees[name], origins, directions)
        for name in ("stack", "restart", "backtrack")
    )
    quality = trees["stack"].quality()
    height, leaves = quality["depth"], stack.leaves.reshape(-1)
    down = stack.steps.reshape(-1)
    both = backtrack.steps.reshape(-1) + backtrack.backtrack_steps.reshape(-1)
    bare = both - backtrack.backtracks.reshape(-1)
    visits = record_visits(trees["backtrack"], origins, directions)
    most, strange = _climbs(visits)
    entered = leaves[leaves > 0]
    return {
        "rays": int(leaves.size),
        "height": height,
        "tree leaves": quality["leaves"],
        "restart": _most(restart.steps.reshape(-1), leaves * height),
        "rays over restart": int(np.count_nonzero(restart.steps.reshape(-1) > leaves * height)),
        "backtrack": _most(bare, down),
        "backtrack, with the run after a climb": _most(both, down),
        "rays over backtrack": int(np.count_nonzero(bare > 3 * down)),
        "climbed to": most,
        "never descended": strange,
        "leaves": [
            float(entered.mean()) if len(entered) else 0.0,
            *(float(np.quantile(entered, q)) if len(entered) else 0.0 for q in (0.5, 0.99, 1.0)),
        ],
    }


def _most(steps: NDArray[Any], limit: NDArray[Any]) -> float:
    """The largest ratio of any ray that takes a step."""
    taken = np.asarray(limit) > 0
    return float(np.max(steps[taken] / limit[taken], initial=0.0))


def _climbs(visits: TreeVisits) -> tuple[int, int]:
    """The most climbs of a ray to one node, and climbs to nodes where the ray never was."""
    count = np.uint64(len(visits.parents))
    rays = visits.rays.astype(np.uint64) * count
    up, down = visits.of("up"), visits.of("down")
    reached, times = np.unique(rays[up] + visits.reached(), return_counts=True)
    been = np.unique(rays[down] + visits.nodes[down])
    return int(times.max(initial=0)), int(np.count_nonzero(~np.isin(reached, been)))


def _table(found: dict[str, Found], size: int) -> Table:
    rows: list[list[Cell]] = [
        [
            name,
            one["height"],
            one["restart"],
            one["rays over restart"],
            one["backtrack"],
            one["backtrack, with the run after a climb"],
            one["rays over backtrack"],
            one["climbed to"],
            one["never descended"],
        ]
        for name, one in found.items()
    ]
    return Table.of(
        "foley-bounds",
        f"Worst cases among all {size} x {size} rays: Foley 2005, sections 2.2 and 2.3",
        ["scene", "height h", "restart: most splits / (leaves x h)", "rays above it"]
        + ["backtrack: most steps / stack's", "with our run after a climb", "rays above 3"]
        + ["most climbs to a node", "climbs to unvisited nodes"],
        rows,
        "A ray that visits m leaves should take at most m h splits with restart, and at most three "
        "times a stack's steps with backtrack. Steps: splits descended and nodes climbed to. After "
        "a climb, our Down runs once more on the node that was reached; Foley's does not.",
    )


def _leaf_table(found: dict[str, Found]) -> Table:
    return Table.of(
        "foley-leaves",
        "Leaves per ray, for rays that hit the scene's box",
        ["scene", "leaves of the tree", "mean", "median", "99 %", "most"],
        [[name, one["tree leaves"], *one["leaves"]] for name, one in found.items()],
    )


def _claims(found: dict[str, Found]) -> list[Claim]:
    limits = published("foley", "bounds").values
    table = published("foley", "table 2").values
    few = max(1e6 * row["transitions"] / SIZE**2 for row in table.values())
    return [
        Claim.judged(
            "With kd-restart, a ray that visits m leaves of a tree of height h descends at most "
            "m h splits (every ray)",
            f"{_SOURCE}.2",
            {name: one["rays over restart"] == 0 for name, one in found.items()},
            "most of any ray, over the bound: "
            + listed({n: o["restart"] for n, o in found.items()}),
        ),
        Claim.judged(
            f"kd-backtrack is at most a factor of {limits['backtrack_over_stack']} slower than a "
            "stack, in steps (every ray)",
            f"{_SOURCE}.3",
            {name: one["rays over backtrack"] == 0 for name, one in found.items()},
            "most of any ray: " + listed({name: one["backtrack"] for name, one in found.items()}),
        ),
        Claim.judged(
            f"A ray climbs to a node at most {limits['climbs_to_a_node']} times, and only to nodes "
            "that it has descended through (every ray)",
            f"{_SOURCE}.3",
            {
                name: one["climbed to"] <= limits["climbs_to_a_node"]
                and one["never descended"] == 0
                for name, one in found.items()
            },
            "; ".join(
                f"{name} at most {one['climbed to']}, {one['never descended']} elsewhere"
                for name, one in found.items()
            ),
        ),
        Claim.judged(
            "Rays visit few leaves on average (read as: at most a quarter more than "
            f"{few:.3g}, the paper's own most)",
            "Foley 2005, sections 2.1 and 2.2",
            {name: one["leaves"][0] <= few * (1.0 + TOLERANCE) for name, one in found.items()},
            "; ".join(
                f"{name} {one['leaves'][0]:.3g} of {one['tree leaves']:,.0f}"
                for name, one in found.items()
            ),
        ),
    ]

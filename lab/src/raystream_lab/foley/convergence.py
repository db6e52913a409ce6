"""Whether climbing halves the nodes of a group of rays, for groups up to all rays (section 4.2).

The paper's kernel runs on all rays of an image that climb at the same time.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raystream_lab.foley.coherence import GROUPINGS
from raystream_lab.foley.recorded_visits import last_climbs, record_visits
from raystream_lab.foley.scenes import SIZE, available_views, foley_tree
from raystream_lab.foley.secondary_rays import ray_kinds
from raystream_lab.results import Cell, Claim, Plot, Result, Series, Table
from raystream_lab.runner import Runner
from raystream_lab.views import View
from raystream_lab.walks.ray_orders import ray_order

#: Climbs per group; the last one has all.
GROUP_SIZES = (64, 512, 4096, 32768)
_ALL = "all"

#: Groups of a size that are averaged, at most.
_GROUPS = 24

#: Steps of a climb that are followed; shorter climbs are left out.
CLIMB = 6

#: Share of distinct nodes left by a step, if each level has "roughly half as many nodes as the one
#: beneath it"; and our tolerance.
HALF, _ABOUT = 0.5, 0.25

_SEED = 1

#: By kind of ray, grouping and group size: ``climbs``, ``groups``, and ``steps``, shares.
Found = dict[str, Any]


def convergence(runner: Runner) -> Result:
    """Distinct nodes by step and group size."""
    result = Result()
    found: dict[str, Found] = {}
    names = ("robots",) if runner.quick else ("robots", "kitchen")
    for name, view in available_views(runner, names, result):
        found[name] = _measured(runner, name, view)
    if not found:
        return result
    cases = list(_cases(found))
    size = runner.size(SIZE)
    result.tables = [_table(cases, size)]
    result.plots = [_plot(name, each) for name, each in found.items()]
    result.claims = [_claim(cases)]
    return result


def _measured(runner: Runner, name: str, view: View) -> Found:
    size = runner.size(SIZE)

    def measure() -> Found:
        tree = foley_tree(view.scene, runner.progress, layout="compact")
        return {
            rays.name: _grouped(
                last_climbs(
                    record_visits(
                        tree,
                        rays.origins,
                        rays.directions,
                        t_max=rays.t_max,
                        any_hit=rays.any_hit,
                        progress=runner.progress,
                    ),
                    CLIMB,
                ),
                rays.pixels,
                size,
            )
            for rays in ray_kinds(view, tree, size)
        }

    found: Found = runner.measure(f"{name}, {size} x {size}", measure)
    return found


def _grouped(climbs: Any, pixels: NDArray[np.int64], size: int) -> Found:
    """Shares of distinct nodes by grouping and group size."""
    place = np.empty(size * size, np.int64)
    place[ray_order("morton", (size, size))] = np.arange(size * size)
    orders = {
        "neighbours": np.argsort(place[pixels[climbs.rays]]),
        "at random": np.random.default_rng(_SEED).permutation(len(climbs.rays)),
    }
    count = len(climbs.rays)
    sizes = [one for one in GROUP_SIZES if one < count]
    return {
        grouping: {
            **{str(one): distinct_shares(climbs.nodes[orders[grouping]], one) for one in sizes},
            _ALL: distinct_shares(climbs.nodes, count),
        }
        for grouping in GROUPINGS
    }


def distinct_shares(nodes: NDArray[np.uint32], size: int) -> dict[str, Any]:
    """Distinct nodes of groups over their climbs, after each step.

    Parameters
    ----------
    nodes : ndarray of shape (C, K), uint32
        The nodes reached by each step of each climb, in the order in which groups are taken.
    size : int
        Climbs per group.

    Returns
    -------
    dict
        ``climbs`` per group, ``groups`` that were averaged, evenly spaced, and ``steps``: the
        share after each step.
    """
    whole = len(nodes) // size if size else 0
    if not whole:
        return {"climbs": 0, "groups": 0, "steps": []}
    chosen = np.unique(np.linspace(0, whole - 1, min(_GROUPS, whole)).astype(int)).tolist()
    counts = [
        [len(np.unique(nodes[size * group : size * (group + 1), k])) for k in range(nodes.shape[1])]
        for group in chosen
    ]
    shares = np.mean(counts, axis=0) / size
    return {"climbs": size, "groups": len(chosen), "steps": shares.tolist()}


def step_factor(steps: Sequence[float]) -> float:
    """The mean share of distinct nodes that a step leaves."""
    return float((steps[-1] / steps[0]) ** (1.0 / (len(steps) - 1)))


#: Scene, kind of ray, grouping, size of the group, and its shares.
Case = tuple[str, str, str, str, Mapping[str, Any]]


def _cases(found: Mapping[str, Found]) -> Iterator[Case]:
    for name, kinds in found.items():
        for kind, groupings in kinds.items():
            for grouping, sizes in groupings.items():
                for size, one in sizes.items():
                    if one["steps"] and not (size == _ALL and grouping != GROUPINGS[0]):
                        label = "all together" if size == _ALL else grouping
                        yield name, kind, label, size, one


def _table(cases: Sequence[Case], size: int) -> Table:
    rows: list[list[Cell]] = [
        [name, kind, grouping, one["climbs"], one["groups"], *one["steps"]]
        + [step_factor(one["steps"])]
        for name, kind, grouping, _, one in cases
    ]
    return Table.of(
        "foley-convergence",
        f"Distinct nodes by the step of a climb and the size of the group, {size} x {size} pixels",
        ["scene", "rays are", "groups are", "climbs", "groups averaged"]
        + [*(f"step {k + 1}" for k in range(CLIMB)), "left by a step"],
        rows,
        f"Of each ray, the last climb of at least {CLIMB} steps counts; step 1 reaches the parent "
        "of the leaf. Figures are the distinct nodes of a group over its climbs. Groups of "
        "neighbours follow a Morton curve over the image; the largest group has all climbs.",
    )


def _plot(name: str, kinds: Found) -> Plot:
    series = []
    for kind, groupings in kinds.items():
        for grouping, sizes in groupings.items():
            kept = [one for one in sizes.values() if one["steps"]]
            series.append(
                Series(
                    f"{kind}, {grouping}",
                    [one["climbs"] for one in kept],
                    [step_factor(one["steps"]) for one in kept],
                )
            )
    return Plot(
        f"foley-convergence-{name}",
        f"{name}: share of distinct nodes that a step up leaves",
        "climbs in a group",
        "share",
        series,
        log_x=True,
        marks={"half, within a quarter": HALF * (1.0 + _ABOUT)},
    )


def _claim(cases: Sequence[Case]) -> Claim:
    factors = {
        f"{name}, {kind}, {size} {grouping}": step_factor(one["steps"])
        for name, kind, grouping, size, one in cases
    }
    sizes = dict.fromkeys(size for *_, size, _ in cases)
    spans = {
        size: [step_factor(one["steps"]) for *_, other, one in cases if other == size]
        for size in sizes
    }
    return Claim.judged(
        "Coherence grows exponentially as rays climb: a step at least halves the distinct nodes, "
        "within a quarter, as each level of a tree has half the nodes of the one beneath",
        "Foley 2005, section 4.2",
        {case: factor <= HALF * (1.0 + _ABOUT) for case, factor in factors.items()},
        "mean share left by a step, by climbs in a group: "
        + ", ".join(f"{size} {min(each):.2f} to {max(each):.2f}" for size, each in spans.items()),
    )

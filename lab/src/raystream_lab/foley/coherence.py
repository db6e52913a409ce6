"""Coherence of secondary rays, and whether climbing makes rays converge (section 4.2)."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raystream.machines import MultipassBackend
from raystream.structures.kdtree.structure import KdTreeStructure
from raystream_lab.foley.node_visits import NodeVisits, TreeWalker, distinct_share
from raystream_lab.foley.scenes import SIZE, available_views, foley_tree, trace_counters
from raystream_lab.foley.secondary_rays import RayKind, first_hits, ray_kinds
from raystream_lab.results import Cell, Claim, Plot, Result, Series, Table, listed
from raystream_lab.runner import Runner
from raystream_lab.views import View

#: Divisor of the paper's image size.
_SHARE = 2

#: Side of a tile of rays, and number of groups, each a tile or as many random rays.
_TILE = 8
_GROUPS = 24

GROUPINGS = ("neighbours", "at random")

#: Minimum length of the climbs considered, and the number of steps followed.
_CLIMB = 6

_SEED = 1

Found = dict[str, Any]


def coherence(runner: Runner) -> Result:
    """Counts and passes by kind of ray, and the distinct nodes of groups of 64 rays."""
    result = Result()
    found: dict[str, dict[str, Found]] = {}
    names = ("robots",) if runner.quick else ("robots", "kitchen")
    for name, view in available_views(runner, names, result):
        found[name] = _scene(runner, name, view)
    if not found:
        return result
    size = max(_TILE * 4, runner.size(SIZE) // _SHARE)
    result.tables = [_meeting_table(found, size), _distinct_table(found), _climb_table(found)]
    result.plots = [_plot(name, each) for name, each in found.items()]
    result.claims = _claims(found)
    return result


def _scene(runner: Runner, name: str, view: View) -> dict[str, Found]:
    size = max(_TILE * 4, runner.size(SIZE) // _SHARE)

    def measure() -> dict[str, Found]:
        tree = foley_tree(view.scene, runner.progress)
        walker = TreeWalker(tree)
        return {
            rays.name: {**_met(tree, rays), **_groups(tree, walker, rays, size)}
            for rays in ray_kinds(view, tree, size)
        }

    value: dict[str, Found] = runner.measure(f"{name}, {size} x {size}", measure)
    return value


def _met(tree: KdTreeStructure, rays: RayKind) -> Found:
    """Counts per ray, and passes."""
    machine = MultipassBackend(tree, scheduler="double")
    counters = trace_counters(
        machine, rays.origins, rays.directions, t_max=rays.t_max, any_hit=rays.any_hit
    )
    passes = counters.passes
    assert passes is not None
    total, count = counters.total, counters.steps.size
    return {
        "rays": count,
        "down": total["steps"] / count,
        "up": total["backtrack_steps"] / count,
        "leaves": total["leaves"] / count,
        "tests": total["tests"] / count,
        "passes": len(passes),
        "efficiency": passes.efficiency,
    }


def _groups(tree: KdTreeStructure, walker: TreeWalker, rays: RayKind, size: int) -> Found:
    """Shares of distinct nodes among a group's visits, by kind of step and grouping."""
    generator = np.random.default_rng(_SEED)
    found: Found = {}
    compared = same = 0
    for grouping in GROUPINGS:
        groups = _chosen(rays, grouping, size, generator)
        walks = []
        for rows in groups:
            part = rays.part(rows)
            visits = _visits(tree, walker, part)
            same += _same_count(tree, part, visits)
            compared += len(visits)
            walks.append(visits)
        found[grouping] = {
            "down": _share([[one.down for one in each] for each in walks]),
            "up": _share([[one.up for one in each] for each in walks]),
            "leaves": _share([[one.leaves for one in each] for each in walks]),
            **_climbing(walks),
        }
    found["same"] = same / max(compared, 1)
    return found


def _share(groups: Sequence[Sequence[Sequence[int]]]) -> float | None:
    share = distinct_share(groups)
    return None if math.isnan(share) else share


def _climbing(walks: Sequence[Sequence[NodeVisits]]) -> dict[str, Any]:
    """Distinct nodes reached by each step of each ray's last long climb.

    Not the first climb: all camera rays start in the leaf that contains the camera.
    """
    long = [
        [
            next(climb for climb in reversed(one.climbs) if len(climb) >= _CLIMB)
            for one in each
            if _has_long_climb(one)
        ]
        for each in walks
    ]
    return {
        "climbs": sum(map(len, long)),
        "steps": [_share([[[climb[k]] for climb in each] for each in long]) for k in range(_CLIMB)],
    }


def _has_long_climb(visits: NodeVisits) -> bool:
    return any(len(climb) >= _CLIMB for climb in visits.climbs)


def _chosen(
    rays: RayKind, grouping: str, size: int, generator: np.random.Generator
) -> list[NDArray[np.int64]]:
    """Ray indices of each group."""
    count = len(rays.pixels)
    if grouping != "neighbours":
        each = min(_TILE * _TILE, count)
        return [generator.choice(count, each, replace=False) for _ in range(_GROUPS)]
    rows, columns = np.divmod(rays.pixels, size)
    tiles = rows // _TILE * size + columns // _TILE
    names, counts = np.unique(tiles, return_counts=True)
    full = names[counts == _TILE * _TILE]
    picked = generator.choice(full, min(_GROUPS, len(full)), replace=False)
    return [np.flatnonzero(tiles == tile) for tile in picked]


def _visits(tree: KdTreeStructure, walker: TreeWalker, rays: RayKind) -> list[NodeVisits]:
    distances = first_hits(tree, rays).t.tolist()
    origins, directions = rays.origins.tolist(), rays.directions.tolist()
    return [
        walker.walk(o, d, rays.t_max, t)
        for o, d, t in zip(origins, directions, distances, strict=True)
    ]


def _same_count(tree: KdTreeStructure, rays: RayKind, visits: Sequence[NodeVisits]) -> int:
    """Count the walks with as many steps as the engine's."""
    counters = trace_counters(
        tree, rays.origins, rays.directions, t_max=rays.t_max, any_hit=rays.any_hit
    )
    engine = zip(
        counters.steps.tolist(),
        counters.backtrack_steps.tolist(),
        counters.leaves.tolist(),
        strict=True,
    )
    own = [(len(one.down), len(one.up), len(one.leaves)) for one in visits]
    return sum(a == b for a, b in zip(engine, own, strict=True))


def _meeting_table(found: Mapping[str, Mapping[str, Found]], size: int) -> Table:
    columns = ("rays", "down", "up", "leaves", "tests", "passes", "efficiency")
    return Table.of(
        "foley-secondary",
        f"Work by kind of ray with kd-backtrack; {size} x {size} pixels",
        ["scene", "rays are", *columns],
        [
            [name, kind, *(one[column] for column in columns)]
            for name, each in found.items()
            for kind, one in each.items()
        ],
        "Steps, leaves and tests per ray; passes and efficiency of the multipass machine with "
        "Foley's scheduler. Shadow rays go to the scene's first light and end at any hit; "
        "diffuse rays leave in cosine-weighted random directions.",
    )


def _distinct_table(found: Mapping[str, Mapping[str, Found]]) -> Table:
    rows: list[Sequence[Cell]] = [
        [name, kind, grouping, *(one[grouping][key] for key in ("down", "up", "leaves"))]
        for name, each in found.items()
        for kind, one in each.items()
        for grouping in GROUPINGS
    ]
    least = min(one["same"] for each in found.values() for one in each.values())
    return Table.of(
        "foley-distinct",
        f"Distinct nodes, in groups of {_TILE * _TILE} rays",
        ["scene", "rays are", "groups", "Down", "Up", "leaves"],
        rows,
        f"{_GROUPS} groups of each kind: tiles of {_TILE} x {_TILE} pixels, or random rays. "
        "Figures are the distinct nodes of a group over the sum of its rays' nodes: 1 means that "
        "no two rays of a group visit the same node; lower values are more coherent.",
        f"Traversed in float64; at least {least:.1%} of the rays take the same number of steps as "
        "in the engine.",
    )


def _climb_table(found: Mapping[str, Mapping[str, Found]]) -> Table:
    return Table.of(
        "foley-climbs",
        "Distinct nodes by the step of a climb",
        ["scene", "rays are", "groups", "climbs", *(f"step {k + 1}" for k in range(_CLIMB))],
        [
            [name, kind, grouping, one[grouping]["climbs"], *one[grouping]["steps"]]
            for name, each in found.items()
            for kind, one in each.items()
            for grouping in GROUPINGS
        ],
        f"Of each ray, the last climb of at least {_CLIMB} steps counts; step 1 reaches the parent "
        "of the leaf. Figures are the distinct nodes of a group over its climbs. They cannot "
        "increase, since equal nodes have the same parent; the rate of decrease is measured.",
    )


def _plot(name: str, each: Mapping[str, Found]) -> Plot:
    steps = list(range(1, _CLIMB + 1))
    return Plot(
        f"foley-climbs-{name}",
        f"{name}: distinct share of the nodes reached by climbs",
        "step of a climb",
        "distinct nodes / climbs",
        [
            Series(f"{kind}, {grouping}", steps, one[grouping]["steps"])
            for kind, one in each.items()
            for grouping in GROUPINGS
        ],
    )


def _claims(found: Mapping[str, Mapping[str, Found]]) -> list[Claim]:
    factors: dict[str, float] = {}
    apart: dict[str, bool] = {}
    leaves: dict[str, float] = {}
    for name, each in found.items():
        for kind, one in each.items():
            leaves[f"{name} {kind}"] = one["neighbours"]["leaves"]
            if kind != "primary":
                apart[f"{name} {kind}"] = (
                    one["neighbours"]["leaves"] > each["primary"]["neighbours"]["leaves"]
                )
            for grouping in GROUPINGS:
                first, *_, last = one[grouping]["steps"]
                if first:
                    factors[f"{name} {kind} {grouping}"] = (last / first) ** (1 / (_CLIMB - 1))
    source = "Foley 2005, section 4.2"
    return [
        Claim.judged(
            "Steps up make rays converge, even random and secondary rays",
            source,
            {case: factor < 1.0 for case, factor in factors.items()},
            f"mean share of distinct nodes left by a step: {listed(factors, '.2f')}",
        ),
        Claim.judged(
            "Neighbouring secondary rays are less coherent: more of their leaves are distinct",
            source,
            apart,
            listed(leaves),
        ),
    ]

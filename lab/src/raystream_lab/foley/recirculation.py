"""The cost of carrying rays from pass to pass, and of idle lanes (Foley 2005, section 5)."""

from __future__ import annotations

from typing import Any

from raystream.core.errors import RaystreamError
from raystream_lab.kernels.recirculation import by_occupancy, measure_recirculation
from raystream_lab.kernels.snapshots import local_rays
from raystream_lab.published import published
from raystream_lab.results import TOLERANCE, Cell, Claim, Plot, Result, Series, Table, listed
from raystream_lab.runner import Runner

_SIZE = 512

_STRUCTURES: dict[str, dict[str, Any]] = {
    "grid": {"resolution": 50},
    "kdtree": {"traversal": "backtrack", "layout": "foley", "traversal_cost": 8.0},
    "graph": {},
}


def recirculation(runner: Runner) -> Result:
    """Time the same steps on both machines, and passes by their occupancy."""
    result = Result()
    size = runner.size(_SIZE)
    found: dict[tuple[str, bool], dict[str, Any]] = {}
    for structure, options in _STRUCTURES.items():
        for compaction in (False, True):

            def measure(
                structure: str = structure,
                options: dict[str, Any] = options,
                compaction: bool = compaction,
            ) -> dict[str, Any]:
                view = runner.view("kitchen")
                built = runner.tracer(view, structure, **options).structure
                rays = local_rays(built, *view.rays(size))
                return _figures(measure_recirculation(built, rays, compaction=compaction))

            name = f"{structure}, {'compaction' if compaction else 'masks'}, {size} x {size}"
            try:
                found[structure, compaction] = runner.measure(name, measure)
            except RaystreamError as error:
                result.notes.append(f"the kitchen is left out: {error}")
                return result
    rows: list[list[Cell]] = [
        [
            structure,
            "dropped" if compaction else "masked",
            one["steps"],
            one["efficiency"],
            one["multipass"],
            one["branching"],
            one["multipass"] / one["branching"],
            one["full"],
            one["idle"],
            one["sparse"],
        ]
        for (structure, compaction), one in found.items()
    ]
    slowdown = published("foley", "claims").values["slowdown_of_idle_lanes"]
    ratios = {name: 1.0 / one["efficiency"] for (name, gone), one in found.items() if not gone}
    lost = {
        name: 1.0 / max(1e-9, 1.0 - one["sparse"])
        for (name, gone), one in found.items()
        if not gone
    }
    result.tables = [
        Table.of(
            "foley-recirculation",
            f"The same steps on both machines: the kitchen, {size} x {size}",
            [
                "structure",
                "ended rays",
                "steps",
                "mean share of rays in a pass",
                "multipass, ns per step",
                "branching, ns per step",
                "ratio",
                "passes nearly full, ns per step",
                "time for idle rays",
                "time that full passes would save",
            ],
            rows,
            "Both machines run the same functions on the same rays. Nearly full: passes in which "
            "at least three quarters of the rays are active; the time that they take in excess of "
            "the branching machine goes to loading and storing rays. Idle: the time for checking "
            "the state of rays that a pass does not run on.",
        )
    ]
    result.plots = [
        Plot(
            "foley-occupancy",
            "Time per step by the share of rays that take part in the pass (masked)",
            "least share of rays in the pass",
            "ns per step",
            [
                Series(name, [low for low, _ in one["bins"]], [ns for _, ns in one["bins"]])
                for (name, gone), one in found.items()
                if not gone
            ],
            log_y=True,
        )
    ]
    source = "Foley 2005, section 5"
    result.claims = [
        Claim.judged(
            f"Idle lanes cost more than a factor of {slowdown}: lanes that a wide SIMD machine "
            "would leave idle",
            source,
            {name: ratio > slowdown for name, ratio in ratios.items()},
            "all rays / active rays: "
            + listed(ratios, ".1f")
            + "; on this machine, which skips them, full passes would be faster by "
            + listed(lost, ".1f"),
        ),
        Claim.judged(
            "Carrying a ray's state from pass to pass is expensive (here: full passes take at "
            "least twice the branching machine's time per step)",
            source,
            {
                name: one["full"] >= 2.0 * one["branching"]
                for (name, gone), one in found.items()
                if not gone and one["full"] is not None
            },
            ", ".join(
                f"{name} {one['full'] / one['branching']:.1f}"
                for (name, gone), one in found.items()
                if not gone and one["full"] is not None
            ),
        ),
        _little(
            {
                f"{name}, ended rays {'dropped' if gone else 'masked'}": one
                for (name, gone), one in found.items()
                if name == "kdtree"
            }
        ),
    ]
    return result


def _little(found: dict[str, dict[str, Any]]) -> Claim:
    """Judge that branching kernels would change little for kd-trees."""
    ratios = {name: one["multipass"] / one["branching"] for name, one in found.items()}
    return Claim.judged(
        "Branching kernels have a minimal effect on kd-trees (read as: in passes, steps take at "
        "most a quarter more time, on this processor)",
        "Foley 2005, section 3.4",
        {name: ratio <= 1.0 + TOLERANCE for name, ratio in ratios.items()},
        "time per step in passes over that of branching: " + listed(ratios, ".2f"),
    )


def _figures(one: Any) -> dict[str, Any]:
    bins = by_occupancy(one.passes)
    kept = [[bin_.low, bin_.seconds / bin_.run_count * 1e9] for bin_ in bins if bin_.run_count]
    full = bins[-1]
    return {
        "steps": one.step_count,
        "efficiency": one.efficiency,
        "multipass": one.seconds_per_step * 1e9,
        "branching": one.branching_seconds_per_step * 1e9,
        "full": full.seconds / full.run_count * 1e9 if full.run_count else None,
        "idle": one.idle_share,
        "sparse": one.sparse_share,
        "bins": kept,
    }

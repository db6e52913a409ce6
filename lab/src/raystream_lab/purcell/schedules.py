"""Passes of the multipass machine under several schedulers (Purcell 2002, Table 2)."""

from __future__ import annotations

from typing import Any

from raystream.machines.schedulers import SCHEDULERS
from raystream_lab.published import published
from raystream_lab.purcell.image_counts import SIZE, grid_tracer
from raystream_lab.purcell.pass_reasons import FIGURES, pass_reasons, summary
from raystream_lab.purcell.scene_statistics import paper_view
from raystream_lab.results import Cell, Claim, Plot, Result, Series, Table, comparison, listed
from raystream_lab.runner import Runner
from raystream_lab.threshold_rule import near_fewest, threshold_claim
from raystream_lab.views import PURCELL_VIEWS
from raystream_lab.walks import Walks, record, replay, sweep

#: Percent.
_THRESHOLDS = (
    *(1, 2, 3, 5, 7, 10, 12, 15, 18, 20, 22, 25, 28, 30),
    *range(35, 91, 5),
)
_QUICK_THRESHOLDS = (1, 5, 10, 20, 30, 50, 70, 90)

#: Traversal steps and intersections per pass beyond the paper's 4 and 2: "more aggressive".
UNROLLED = ((8, 4), (16, 8), (32, 16))


def record_view(runner: Runner, name: str, *, visits: bool = False) -> Walks:
    """Record the walks of a view's rays on Purcell's grid."""
    view = runner.view(name)
    tracer = grid_tracer(runner, view)
    return record(tracer, *view.rays(runner.size(SIZE)), visits=visits, progress=runner.progress)


def image_schedule(runner: Runner, name: str) -> dict[str, Any]:
    """Passes of each scheduler for a view, from one recording.

    Returns
    -------
    dict
        ``passes``, ``traverse``, ``intersect``, ``other``, ``efficiency`` of the paper's schedule;
        ``optimal``, the paper's bound; ``most_steps`` and ``most_tests``; ``schedulers``, passes by
        name; ``sweep``, pairs of a threshold in percent and passes; ``unrolled``: passes and runs
        of each kernel with the paper's steps per pass, runs with one, ``once``, and ``more``,
        those of `UNROLLED`.
    """
    size = runner.size(SIZE)

    def measure() -> dict[str, Any]:
        walks = record_view(runner, name)
        usual = replay(walks)
        unroll = published("purcell", "unrolling").values
        steps, tests = unroll["traversal_steps"], unroll["intersections"]
        percents = _QUICK_THRESHOLDS if runner.quick else _THRESHOLDS
        replays = sweep(walks, [one / 100 for one in percents])
        return {
            **summary(walks, usual),
            "optimal": usual.optimal_count,
            "schedulers": {one: len(replay(walks, scheduler=one)) for one in SCHEDULERS},
            "sweep": [[x, len(one)] for x, one in zip(percents, replays, strict=True)],
            "unrolled": {
                **_unrolled(walks, steps, tests),
                "once": usual.runs,
                "more": [_unrolled(walks, *each) for each in UNROLLED],
            },
        }

    found: dict[str, Any] = runner.measure(
        f"{name}, schedules, {size} x {size}", measure, shared=True
    )
    return found


def _unrolled(walks: Walks, steps: int, tests: int) -> dict[str, Any]:
    found = replay(walks, traversal_steps=steps, intersections=tests)
    return {"passes": len(found), "runs": found.runs}


def schedules(runner: Runner) -> Result:
    """Table 2, schedulers, and the sweep of the threshold."""
    result = Result()
    found = dict(result.available(PURCELL_VIEWS, lambda name: image_schedule(runner, name)))
    size = runner.size(SIZE)
    result.tables = [_table_2(runner, found, size), _schedulers(found, size), _thresholds(found)]
    result.plots = [_plot(found)]
    result.claims = _claims(found)
    return result


def _table_2(runner: Runner, found: dict[str, dict[str, Any]], size: int) -> Table:
    rows: list[tuple[str, Cell, Cell, str]] = []
    for name, ours in found.items():
        theirs = published("purcell", "table 2").values[paper_view(name)]
        reasons = pass_reasons(runner, name, ours, theirs)
        rows += [
            (f"{name}: {what}", theirs[key], ours[own], reasons.get(own, ""))
            for own, (key, what) in FIGURES.items()
        ]
    source = published("purcell", "table 2").source
    return comparison(
        "purcell-table-2",
        f"Passes: {source}; threshold 20 %, {size} x {size}",
        rows,
        "Camera: of the cameras tried for Figure 6, the one whose longest walks are nearest to the "
        "paper's in both steps and tests, scheduled again at the full size.",
        "Other passes: set-up and shading. In the paper, generating eye rays takes a pass as well, "
        "and set-up takes two.",
    )


def _schedulers(found: dict[str, dict[str, Any]], size: int) -> Table:
    rows: list[list[Cell]] = []
    for name, ours in found.items():
        passes = ours["schedulers"]
        best = min(passes.values())
        rows.append(
            [
                name,
                ours["optimal"],
                *(passes[one] for one in SCHEDULERS),
                passes["threshold"] / ours["optimal"],
                passes["naive"] / passes["threshold"],
                min((one for one in SCHEDULERS if passes[one] == best), default=""),
            ]
        )
    return Table.of(
        "purcell-schedulers",
        f"Passes by scheduler, {size} x {size}",
        [
            "view",
            "optimal",
            *SCHEDULERS,
            "threshold / optimal",
            "naive / threshold",
            "fewest",
        ],
        rows,
        "Optimal: the sum, over kernels, of the maximum number of runs on any ray, a lower bound "
        "that may not be attainable. Naive intersects as soon as any ray waits for it.",
    )


def _thresholds(found: dict[str, dict[str, Any]]) -> Table:
    rows: list[list[Cell]] = []
    usual = published("purcell", "schedule").values["threshold"]
    for name, ours in found.items():
        best_percent, best = min(ours["sweep"], key=lambda one: one[1])
        near = near_fewest(_by_share(ours))
        within = f"{100 * near[0]:.0f} to {100 * near[-1]:.0f}"
        at_usual = dict(map(tuple, ours["sweep"]))[round(100 * usual)]
        rows.append([name, best_percent, best, at_usual, at_usual / best, within])
    return Table.of(
        "purcell-thresholds",
        "The threshold with the fewest passes",
        ["view", "best threshold, %", "its passes", "passes at 20 %", "ratio", "within 10 %, %"],
        rows,
        "Replays of recorded walks, for thresholds from 1 to 90 %.",
    )


def _by_share(ours: dict[str, Any]) -> dict[float, int]:
    """Passes by threshold, as a share of the active rays."""
    return {percent / 100: passes for percent, passes in ours["sweep"]}


def _plot(found: dict[str, dict[str, Any]]) -> Plot:
    usual = published("purcell", "schedule").values["threshold"]
    return Plot(
        "purcell-thresholds",
        f"Passes by threshold, over those at {usual:.0%}",
        "threshold: share of active rays that wait for an intersection, %",
        "passes",
        [
            Series(
                name,
                [percent for percent, _ in ours["sweep"]],
                [passes / ours["passes"] for _, passes in ours["sweep"]],
            )
            for name, ours in found.items()
        ],
        marks={f"at {usual:.0%}": 1.0},
    )


def _claims(found: dict[str, dict[str, Any]]) -> list[Claim]:
    schedule = published("purcell", "schedule")
    factor = schedule.values["naive_over_threshold"]
    low, high = schedule.values["best_over_optimal"]
    naive, optimal, total, busy = {}, {}, {}, {}
    for name, ours in found.items():
        passes = ours["schedulers"]
        naive[name] = passes["naive"] / passes["threshold"]
        optimal[name] = passes["threshold"] / ours["optimal"]
        total[name] = ours["passes"]
        busy[name] = ours["efficiency"]
    place = schedule.source
    return [
        Claim.judged(
            f"The naive schedule takes at least {factor} times as many passes",
            place,
            {name: ratio >= factor for name, ratio in naive.items()},
            listed(naive, ".2f"),
        ),
        Claim.judged(
            f"The threshold comes within {low} to {high} times the optimal count",
            place,
            {name: ratio <= high for name, ratio in optimal.items()},
            listed(optimal, ".2f"),
        ),
        threshold_claim(
            place,
            schedule.values["threshold"],
            {name: _by_share(ours) for name, ours in found.items()},
        ),
        Claim.judged(
            "An image takes 1000 to 3000 passes",
            "Purcell 2002, section 4.2",
            {name: 1000 <= count <= 3000 for name, count in total.items()},
            listed(total, ","),
        ),
        *_efficiency_claims(busy),
    ]


def _efficiency_claims(busy: dict[str, float]) -> list[Claim]:
    """Efficiencies are "roughly 10 %", if as near to it as the paper's own are."""
    source = published("purcell", "efficiency")
    about, other = source.values["about"], source.values["except"]
    table = published("purcell", "table 2").values
    theirs = [row["efficiency"] for name, row in table.items() if name != other]
    factor = max(max(one / about, about / one) for one in theirs)
    rest = {name: one for name, one in busy.items() if name != other}
    claims = [
        Claim.judged(
            f"The SIMD efficiency is roughly {about:.0%}, except for {other} (read as: as close to "
            f"it as the paper's own values, {about / factor:.3f} to {about * factor:.3f})",
            source.source,
            {name: about / factor <= one <= about * factor for name, one in rest.items()},
            listed(rest),
        )
    ]
    if other in busy and rest:
        claims.append(
            Claim.judged(
                f"... and much lower for {other} (read as: less than half of all others)",
                source.source,
                {name: busy[other] < one / 2.0 for name, one in rest.items()},
                f"{other} {busy[other]:.3g}; {listed(rest)}",
            )
        )
    return claims

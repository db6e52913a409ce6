"""When Foley's scheduler switches kernels, and how many lanes idle (sections 3.4 and 5)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any

import numpy as np

from raystream.machines import MultipassBackend, Queues
from raystream.machines.schedulers import Scheduler, make_scheduler
from raystream_lab.foley.scenes import SIZE, available_views, foley_tree, trace_counters
from raystream_lab.published import published
from raystream_lab.results import Cell, Claim, Plot, Result, Series, Table, listed
from raystream_lab.runner import Runner
from raystream_lab.views import View

#: Switch to another kernel if it has this many times the rays of the last one.
RATIOS = (1.0, 1.25, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0)

_RULES = ("naive", "threshold", "most-work", "double")
_TRAVERSALS = ("restart", "backtrack")

#: Divisor of the image size; the longest rays determine the number of passes.
_SHARE = 2

#: Figures of a schedule.
Schedule = dict[str, float]


class SwitchRatio:
    """Switch when another kernel has more than `ratio` times the rays (Foley 2005, section 3.4).

    Parameters
    ----------
    ratio : float
        Foley's is 2, raystream's ``"double"``.
    """

    def __init__(self, ratio: float) -> None:
        self.ratio = ratio

    def choose(self, queues: Queues) -> int:
        """See `Scheduler.choose`."""
        best = queues.fullest(range(len(queues.kernels)))
        latest = queues.latest
        if latest is None or queues.waiting[best] > self.ratio * queues.waiting[latest]:
            return best
        return latest


class RecordingScheduler:
    """A scheduler that records the number of active rays.

    Parameters
    ----------
    scheduler : Scheduler

    Attributes
    ----------
    active_counts : list of int
        Rays in mid-search, per pass.
    """

    def __init__(self, scheduler: Scheduler) -> None:
        self.scheduler = scheduler
        self.active_counts: list[int] = []

    def choose(self, queues: Queues) -> int:
        """See `Scheduler.choose`."""
        self.active_counts.append(sum(queues.waiting[: queues.shading]))
        return self.scheduler.choose(queues)


def schedulers(runner: Runner) -> Result:
    """Passes, switches and idle lanes of schedulers, and of other switching ratios."""
    result = Result()
    rules: dict[str, dict[str, Schedule]] = {}
    ratios: dict[str, dict[str, Schedule]] = {}
    names = ("robots",) if runner.quick else ("robots", "kitchen")
    for name, view in available_views(runner, names, result):
        for traversal in _TRAVERSALS:
            case = f"{name} {traversal}"
            run = _Runs(runner, name, view, traversal)
            rules[case] = {rule: run.of(rule, make_scheduler(rule)) for rule in _RULES}
            chosen = RATIOS[::3] if runner.quick else RATIOS
            ratios[case] = {f"{r:g}": run.of(f"ratio {r:g}", SwitchRatio(r)) for r in chosen}
    if not rules:
        return result
    size = max(16, runner.size(SIZE) // _SHARE)
    result.tables = [_rule_table(rules, size), _ratio_table(ratios, size)]
    result.plots = [_plot(ratios, "passes"), _plot(ratios, "switches")]
    result.claims = _claims(rules, ratios)
    return result


class _Runs:
    """Runs one tree with several schedulers."""

    def __init__(self, runner: Runner, name: str, view: View, traversal: str) -> None:
        self.runner, self.name, self.view, self.traversal = runner, name, view, traversal
        self.size = max(16, runner.size(SIZE) // _SHARE)
        self.tree: Any = None

    def of(self, title: str, scheduler: Scheduler) -> Schedule:
        """Figures of a scheduler's passes."""

        def measure() -> Schedule:
            if self.tree is None:
                scene, progress = self.view.scene, self.runner.progress
                self.tree = foley_tree(scene, progress, traversal=self.traversal)
            watched = RecordingScheduler(scheduler)
            machine = MultipassBackend(self.tree, scheduler=watched)
            rays = self.view.rays(self.size)
            passes = trace_counters(machine, *rays, progress=self.runner.progress).passes
            assert passes is not None
            return _figures(list(passes), watched.active_counts, passes.optimal_count)

        name = f"{self.name} {self.traversal}, {title}, {self.size} x {self.size}"
        figures: Schedule = self.runner.measure(name, measure)
        return figures


def _figures(passes: Sequence[Any], active: Sequence[int], optimal_count: int) -> Schedule:
    kernels = [one.kernel for one in passes]
    ran = np.array([one.run_count for one in passes], np.float64)
    lanes = np.array([one.record_count for one in passes], np.float64)
    searching = np.array(active, np.float64)
    return {
        "passes": len(passes),
        "optimal": optimal_count,
        "switches": sum(before != after for before, after in pairwise(kernels)),
        "efficiency": float(np.mean(ran / lanes)),
        "ended": float(np.mean(1.0 - searching / lanes)),
        "of active": float(ran[searching > 0].sum() / searching.sum()),
    }


def _row(one: Schedule) -> list[Cell]:
    return [
        one["passes"],
        one["passes"] / one["optimal"],
        one["switches"],
        one["efficiency"],
        1.0 / one["efficiency"],
        one["ended"],
        1.0 - one["ended"] - one["efficiency"],
    ]


_COLUMNS = (
    "passes",
    "over the bound",
    "switches",
    "lanes that work",
    "idle lanes cost",
    "lanes of ended rays",
    "lanes that wait for other kernels",
)


def _rule_table(rules: Mapping[str, Mapping[str, Schedule]], size: int) -> Table:
    rows = [[case, rule, *_row(one)] for case, each in rules.items() for rule, one in each.items()]
    factor = published("foley", "claims").values["slowdown_of_idle_lanes"]
    return Table.of(
        "foley-schedulers",
        f"Schedulers of kd-trees on the multipass machine, {size} x {size} rays",
        ["scene and traversal", "scheduler", *_COLUMNS],
        rows,
        "Shares are of all lanes, one per ray, as means over passes. Idle lanes cost: the number "
        f"of passes relative to a schedule without idle lanes; Foley estimates more than {factor}, "
        "for hardware that rejects blocks of idle fragments early, but pays for each kernel "
        "switch.",
        "The bound is the sum, over kernels, of the maximum number of runs on any ray.",
    )


def _ratio_table(ratios: Mapping[str, Mapping[str, Schedule]], size: int) -> Table:
    theirs = published("foley", "claims").values["switch_ratio"]
    rows = [
        [case, float(ratio), *_row(one), one["switches"] / one["passes"]]
        for case, each in ratios.items()
        for ratio, one in each.items()
    ]
    return Table.of(
        "foley-switch-ratio",
        f"Switching when another kernel has a multiple of the rays, {size} x {size} rays",
        ["scene and traversal", "ratio", *_COLUMNS, "switches per pass"],
        rows,
        f"Foley's ratio is {theirs}. At 1 the fullest kernel runs, but in a tie the last kernel "
        "continues.",
    )


def _plot(ratios: Mapping[str, Mapping[str, Schedule]], key: str) -> Plot:
    return Plot(
        f"foley-ratio-{key}",
        f"{key.capitalize()} against the switching ratio",
        "rays of another kernel over those of the last one",
        key,
        [
            Series(case, [float(ratio) for ratio in each], [one[key] for one in each.values()])
            for case, each in ratios.items()
        ],
    )


def _claims(
    rules: Mapping[str, Mapping[str, Schedule]], ratios: Mapping[str, Mapping[str, Schedule]]
) -> list[Claim]:
    values = published("foley", "claims").values
    factor, ratio = values["slowdown_of_idle_lanes"], values["switch_ratio"]
    idle = {case: 1.0 / each["double"]["efficiency"] for case, each in rules.items()}
    fewer = {
        case: (each["double"]["switches"], each["most-work"]["switches"])
        for case, each in rules.items()
    }
    batches = {
        case: (each["double"]["efficiency"], each["most-work"]["efficiency"])
        for case, each in rules.items()
    }
    best = {case: min(each, key=lambda r: each[r]["passes"]) for case, each in ratios.items()}
    source = "Foley 2005, section 3.4"
    return [
        Claim.judged(
            f"Low utilisation costs more than a factor of {factor} (read as: all lanes over those "
            "that work, not time)",
            "Foley 2005, section 5",
            {case: cost > factor for case, cost in idle.items()},
            "all lanes / lanes that work, with Foley's scheduler: " + listed(idle),
        ),
        Claim.judged(
            "Foley's rule switches kernels less often than a rule that always runs the fullest one",
            source,
            {case: double < most for case, (double, most) in fewer.items()},
            ", ".join(f"{case} {a:,.0f} and {b:,.0f}" for case, (a, b) in fewer.items()),
        ),
        Claim.judged(
            "... while its passes run on as many rays",
            source,
            {case: double >= most for case, (double, most) in batches.items()},
            ", ".join(f"{case} {a:.1%} and {b:.1%}" for case, (a, b) in batches.items())
            + f"; of the ratios tried, {', '.join(best.values())} take the fewest passes, Foley's "
            "is " + f"{ratio}",
        ),
    ]

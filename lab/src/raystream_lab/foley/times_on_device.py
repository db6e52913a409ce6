"""Table 1 on a device: milliseconds of brute force, grid and kd-trees on its machines."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

from raystream.core.errors import RaystreamError
from raystream.structures import Structure
from raystream.tracer import Tracer
from raystream_lab.agreement import Row, agreement_claim, agreement_table
from raystream_lab.devices import CUDA_PASSES
from raystream_lab.foley.other_views import lead
from raystream_lab.foley.scenes import (
    PATIENCE,
    SCENES,
    SIZE,
    available_views,
    foley_structures,
    mean_counts,
)
from raystream_lab.foley.sensitivity import is_near
from raystream_lab.published import published
from raystream_lab.results import Cell, Claim, Plot, Result, Series, Table, listed
from raystream_lab.runner import Runner
from raystream_lab.timing import time_in_turn
from raystream_lab.views import View

#: Structures that multipass machines step through.
_MULTIPASS = ("brute", "grid", "restart", "backtrack")

#: Divisor of the image size for brute force in large scenes, and the triangles that make one.
_BRUTE_SHARE, _LARGE = 8, 1000

_ROUNDS = 3

#: What tables say of passes.
_PASSES = (
    "The machine multipass has Foley's scheduler. Brute force runs in passes only in scenes of up "
    f"to {_LARGE:,} triangles, since it takes a pass over all rays for each triangle."
)

#: Scenes with details of many sizes, where kd-trees are ahead.
_COMPLEX = ("robots", "kitchen")

#: Figures by structure; with ``error`` instead where the device refuses one.
_Figures = dict[str, dict[str, Any]]


def times_on_device(runner: Runner) -> Result:
    """Times of every structure on the device's machines, and its counts against the CPU's."""
    result = Result()
    names = tuple(SCENES)[: 2 if runner.quick else None]
    found: dict[str, dict[str, _Figures]] = {}
    counts: list[Row] = []
    for name, view in available_views(runner, names, result):
        scene = _Scene(runner, name, view)
        found[name] = runner.measure(f"{name}, {scene.size} x {scene.size}", scene.figures)
        counts += _count_rows(name, found[name])
        result.notes += _refusals(name, found[name])
    if not found:
        return result
    size = runner.device_size(SIZE)
    result.tables = [
        _table_1(runner, found, size),
        _relative_table(runner, found),
        agreement_table(
            "foley-device-counts",
            "Counts per ray, and passes: the device's against the CPU's",
            runner.device,
            counts,
        ),
    ]
    result.plots = [_plot(runner, found)]
    result.claims = [*_claims(runner, found), agreement_claim(runner.device, counts)]
    return result


class _Scene:
    """A scene with all its structures, traced by the device."""

    def __init__(self, runner: Runner, name: str, view: View) -> None:
        self.runner, self.name, self.view = runner, name, view
        self.size = runner.device_size(SIZE)

    def figures(self) -> dict[str, _Figures]:
        """Times, counts and passes, by machine and then by structure."""
        built = foley_structures(self.view.scene, self.name, self.runner.progress)
        return {machine: self._of(machine, built) for machine in self.runner.machines}

    def _of(self, machine: str, built: Mapping[str, Structure]) -> _Figures:
        figures: _Figures = {}
        calls: dict[str, Callable[[], object]] = {}
        is_large = self.view.scene.triangle_count > _LARGE
        for name, structure in built.items():
            is_brute = name == "brute"
            if machine == "multipass" and (name not in _MULTIPASS or (is_brute and is_large)):
                continue
            share = _BRUTE_SHARE if is_brute and is_large else 1
            rays = self.view.rays(max(8, self.size // share))
            try:
                tracer = self._tracer(structure, machine, self.runner.device)
                tracer.first_hit(*self.view.rays(8))  # compiles
                figures[name] = self._counted(structure, machine, rays)
            except RaystreamError as error:
                figures[name] = {"error": str(error)}
            else:
                calls[name] = partial(tracer.first_hit, *rays)
        rounds = 1 if self.runner.quick else _ROUNDS
        for name, seconds in time_in_turn(calls, rounds, patience=PATIENCE).items():
            figures[name] |= {"seconds": min(seconds), "rounds": len(seconds)}
        return figures

    def _counted(self, structure: Structure, machine: str, rays: Any) -> dict[str, Any]:
        """Counts per ray and passes, of the device and of the CPU."""
        cpu_machine = "multipass" if machine == "multipass" else "branching"
        sides = {}
        for side, device, its in (
            ("device", self.runner.device, machine),
            ("cpu", "cpu", cpu_machine),
        ):
            tracer = self._tracer(structure, its, device, counters=True)
            tracer.first_hit(*rays)
            counters = tracer.counters
            passes = None if counters.passes is None else len(counters.passes)
            sides[side] = {**mean_counts(counters), "passes": passes}
        return {"rays": rays[1].size // 3, **sides}

    def _tracer(
        self, structure: Structure, machine: str, device: str, counters: bool = False
    ) -> Tracer:
        options = {"scheduler": "double"} if machine == "multipass" else {}
        return Tracer.of_structure(
            structure, self.view.scene, device, machine=machine, counters=counters, **options
        )


def _count_rows(name: str, each: Mapping[str, _Figures]) -> list[Row]:
    return [
        (f"{name}, {structure}, {machine}: {what}", one["cpu"][what], one["device"][what])
        for machine, figures in each.items()
        for structure, one in figures.items()
        if "error" not in one
        for what in ("steps", "leaves", "tests", "passes")
        if one["cpu"][what]
    ]


def _refusals(name: str, each: Mapping[str, _Figures]) -> list[str]:
    return [
        f"{name}, {structure}, machine {machine}: {one['error']}"
        for machine, figures in each.items()
        for structure, one in figures.items()
        if "error" in one
    ]


def _milliseconds(one: Mapping[str, Any] | None) -> float | None:
    """Milliseconds for an image of Foley's size; None where the device refused."""
    if one is None or "error" in one:
        return None
    return float(one["seconds"]) / float(one["rays"]) * SIZE**2 * 1e3


def _work(one: Mapping[str, Any]) -> float:
    return float(one["device"]["steps"] + one["device"]["tests"])


def _table_1(runner: Runner, found: Mapping[str, dict[str, _Figures]], size: int) -> Table:
    theirs = published("foley", "table 1").values
    rows: list[Sequence[Cell]] = []
    for name, each in found.items():
        for machine, figures in each.items():
            for structure, one in figures.items():
                old, own = theirs[name].get(structure), _milliseconds(one)
                if own is None:
                    rows.append([name, structure, machine, old, *[None] * 4, "refused: see notes"])
                    continue
                ratio = None if old is None else own / old
                why = "not the paper's" if old is None else _why(runner, ratio)
                rate = SIZE**2 / own / 1e3
                passes = one["device"]["passes"]
                rows.append([name, structure, machine, old, own, ratio, rate, passes, why])
    return Table.of(
        "foley-table-1",
        f"Milliseconds to trace primary rays: {published('foley', 'table 1').source}",
        ["scene", "structure", "machine", "published", "ours", "ratio", "million rays/s"]
        + ["passes", "why they differ"],
        rows,
        runner.facts.note,
        f"Times are scaled to 512 x 512 rays; {size} x {size} were traced, by brute force in large "
        f"scenes {_BRUTE_SHARE} times fewer along each side. They are the best of up to {_ROUNDS} "
        "rounds in which structures take turns, and include the transfer of rays and hits.",
        _PASSES if "multipass" in runner.machines else CUDA_PASSES,
    )


def _why(runner: Runner, ratio: float | None) -> str:
    if ratio is None or is_near(ratio, 1.0):
        return ""
    what = "software" if runner.facts.is_software else "another device"
    return f"{what} instead of a graphics card of 2005: compare structures with each other"


def _relative_table(runner: Runner, found: Mapping[str, dict[str, _Figures]]) -> Table:
    theirs = published("foley", "table 1").values
    rows: list[Sequence[Cell]] = []
    for name, each in found.items():
        for machine, figures in each.items():
            base = figures["backtrack"]
            base_time = _milliseconds(base)
            for structure, one in figures.items():
                own = _milliseconds(one)
                if structure == "backtrack" or own is None or base_time is None:
                    continue
                old = theirs[name].get(structure)
                old = None if old is None else old / theirs[name]["backtrack"]
                work, times = _work(one) / _work(base), own / base_time
                why = f"steps and tests x {work:.3g}, time of each x {times / work:.3g}"
                if one["device"]["passes"] and base["device"]["passes"]:
                    ratio = one["device"]["passes"] / base["device"]["passes"]
                    why = f"passes x {ratio:.3g}, " + why
                what = f"{structure} / backtrack"
                rows.append(
                    [name, machine, what, old, times, None if old is None else times / old, why]
                )
    return Table.of(
        "foley-relative",
        "Comparison of structures: times over kd-backtrack's",
        ["scene", "machine", "structure", "published", f"ours, {runner.device}", "ratio"]
        + ["why they differ"],
        rows,
        "Why they differ: the product of the factors for the number of steps and tests, as the "
        "device counts them, and for the time of each is our value.",
    )


def _plot(runner: Runner, found: Mapping[str, dict[str, _Figures]]) -> Plot:
    theirs = published("foley", "table 1").values
    series = [
        Series(
            "published",
            list(found),
            [theirs[name]["grid"] / theirs[name]["backtrack"] for name in found],
        )
    ]
    for machine in runner.machines:
        heights: list[float | None] = []
        for each in found.values():
            grid, tree = (_milliseconds(each[machine].get(one)) for one in ("grid", "backtrack"))
            heights.append(None if grid is None or tree is None else grid / tree)
        series.append(Series(f"{runner.device}, {machine}", list(found), heights))
    return Plot(
        "foley-grid-over-kdtree",
        "The grid over kd-backtrack: below 1 the grid is better",
        "",
        "grid / backtrack",
        series,
        kind="bars",
        log_y=True,
        marks={"equal": 1.0},
    )


def _claims(runner: Runner, found: Mapping[str, dict[str, _Figures]]) -> list[Claim]:
    """Foley's comparisons of the grid with the kd-trees, by the device's times."""
    leads: dict[str, dict[str, float]] = {}
    for name, each in found.items():
        for machine in runner.machines:
            times = {
                one: _milliseconds(each[machine].get(one))
                for one in ("grid", "restart", "backtrack")
            }
            known = {one: value for one, value in times.items() if value is not None}
            if len(known) == len(times):
                leads.setdefault(name, {})[f"{name}, {machine}"] = lead(known)
    ahead = {case: x for name in _COMPLEX for case, x in leads.get(name, {}).items()}
    behind = leads.get("bunny", {})
    return [
        Claim.judged(
            "In the robots and the kitchen, the kd-trees are faster than a grid",
            "Foley 2005, Table 1, section 4.1",
            {case: ratio > 1.0 for case, ratio in ahead.items()},
            f"grid / better of the two on {runner.device}: {listed(ahead) or 'none was measured'}",
        ),
        Claim.judged(
            "In the bunny, a grid is faster than the stackless kd-trees",
            "Foley 2005, Table 1",
            {case: ratio < 1.0 for case, ratio in behind.items()},
            f"grid / better of the two on {runner.device}: {listed(behind) or 'none was measured'}",
        ),
    ]

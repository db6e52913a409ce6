"""The cost of shadows, mirrors and paths relative to ray casting (Purcell 2002, section 4.3).

Each scene is traced on the uniform grid, as in Purcell's simulator, with one light, and every
surface reflects a quarter: his shading spawns a reflected ray at each hit. On the multipass machine
each renderer is one loop, see `purcell.multipass_costs`.
"""

from __future__ import annotations

import dataclasses
from collections import Counter
from collections.abc import Mapping
from functools import partial
from types import MappingProxyType
from typing import Any, NamedTuple

from raystream.core.hits import Hits
from raystream.machines import RayCounters
from raystream.rendering.contexts import make_context
from raystream.rendering.integrator import Integrator
from raystream.rendering.render import RENDERERS, render
from raystream.rendering.sampling.sampler import Sampler
from raystream.scene.scene import Scene
from raystream.tracer import Tracer
from raystream_lab.cost_model import prices
from raystream_lab.published import published
from raystream_lab.purcell.image_counts import SIZE
from raystream_lab.purcell.multipass_costs import loop_cost, loop_runs
from raystream_lab.results import Cell, Claim, Result, Table, comparison, is_near, listed
from raystream_lab.runner import Runner
from raystream_lab.timing import median_times
from raystream_lab.views import View

#: Scenes, and options of their grids: Purcell's (section 4.1) for his scenes. In a one-level grid,
#: all robots share a few cells, and a ray tests 60,000 triangles.
_SCENES: Mapping[str, dict[str, Any]] = MappingProxyType(
    {
        "cornell": {},
        "bunny on a floor": {"min_resolution": 64},
        "robots": {"min_resolution": 24, "levels": 2},
        "forest top": {"min_resolution": 128},
        "building outside": {"min_resolution": 32},
    }
)

_QUICK_SCENES = ("cornell", "bunny on a floor")


class _Row(NamedTuple):
    """An extension: its renderer, and its name in the paper."""

    mode: str
    options: dict[str, Any]
    paper: str | None


_ROWS: Mapping[str, _Row] = MappingProxyType(
    {
        "shadow rays": _Row("shadow", {}, "shadow"),
        "shadow": _Row("shadow", {}, None),
        "whitted, 1 bounce": _Row("whitted", {"max_bounces": 1}, "whitted"),
        "whitted, 2 bounces": _Row("whitted", {"max_bounces": 2}, "whitted"),
        "path": _Row("path", {"preset": "arnold"}, "path"),
        "path, to lights": _Row("path", {"max_bounces": 2}, "path"),
    }
)

#: Share of light that every surface reflects.
_SHARE = 0.25

#: Width and height of path-traced images, and samples per pixel of scenes that are not the paper's.
_PATH_SIZE, _PATH_SAMPLES = 256, 16

#: The paper's scene, also measured on the multipass machine: all its images at `_PATH_SIZE`, so
#: that all pixels are in one loop.
_PAPER_SCENE = "bunny on a floor"

#: Rounds in which modes take turns, and the divisor of the size of timed images: at full size, the
#: forest's alone take three minutes.
_ROUNDS, _TIMED_SHARE = 2, 2

#: Width and height of the images that compile the kernels.
_WARM_SIZE = 32

#: Camera rays that are counted together.
_BAND = 1 << 16

Sums = dict[str, Counter[str]]


class _CountingTracer(Tracer):
    """A tracer that sums the counters of both queries."""

    def __init__(self, scene: Scene, **options: Any) -> None:
        super().__init__(scene, "grid", counters=True, **options)
        self.start()

    def start(self) -> None:
        """Count from here."""
        self.sums: Sums = {"first_hit": Counter(), "any_hit": Counter()}

    def first_hit(self, *rays: Any, **options: Any) -> Hits:
        """Trace and count."""
        hits = super().first_hit(*rays, **options)
        self._count("first_hit")["hits"] += int(hits.is_hit.sum())
        return hits

    def any_hit(self, *rays: Any, **options: Any) -> Any:
        """Trace and count."""
        answer = super().any_hit(*rays, **options)
        self._count("any_hit")
        return answer

    def _count(self, query: str) -> Counter[str]:
        sums, counters = self.sums[query], self.counters
        assert isinstance(counters, RayCounters)
        sums["rays"] += counters.steps.size
        sums["steps"] += counters.total["steps"]
        sums["tests"] += counters.total["tests"]
        return sums


def extensions(runner: Runner) -> Result:
    """The table of section 4.3, by counts and by time."""
    result = Result()
    rows: list[list[Cell]] = []
    relative: dict[str, dict[str, dict[str, float]]] = {}
    passes: dict[str, dict[str, float]] = {}
    for name, view in result.available(_QUICK_SCENES if runner.quick else _SCENES, runner.view):
        mirrors = _with_mirrors(view)
        found = _measure(runner, mirrors, _SCENES[name])
        if name == _PAPER_SCENE:
            passes = _multipass(runner, mirrors, _SCENES[name])
        base = found["raycast"]
        for row, ours in found.items():
            ratios = base if row == "raycast" else {key: n / base[key] for key, n in ours.items()}
            rows.append([name, row, *(ratios.get(key) for key in (*_COUNTED, "time"))])
            if row != "raycast":
                relative.setdefault(name, {})[row] = ratios
    compared = _compared(relative)
    near = {case: is_near(ours, theirs) for case, theirs, ours, _ in compared}
    by_rays = {
        f"{name}, {row}": ratios["instructions"] / ratios["rays"]
        for name, each in relative.items()
        for row, ratios in each.items()
    }
    source = published("purcell", "extensions").source
    result.tables = [
        comparison(
            "purcell-extensions",
            f"Extensions over the ray caster, the bunny on a floor: {source}",
            compared,
            "Shadow rays: those of the paper's hybrid, which rasterises the visible surfaces. "
            "Whitted: with one and with two bounces, since the paper does not give their number. "
            "Path: the preset arnold, with two diffuse bounces and the paper's 64 samples. Path, "
            "to lights: a path tracer that also samples a light at each surface, and has mirrors.",
        ),
        Table.of(
            "purcell-extensions-all",
            "Counts per camera ray: the ray caster's, and ratios to them",
            ["scene", "mode", *_COUNTED, "time"],
            rows,
            "The ray caster's time is in microseconds per ray. Times are of whole images, medians "
            "of rounds in which the modes take turns; instructions and words are by Table 1, "
            f"branching. Paths have {_PATH_SAMPLES} samples, those of the bunny as many as the "
            "paper's.",
        ),
    ]
    if passes:
        result.tables.append(_multipass_table(runner, passes))
    result.claims = [
        Claim.judged(
            "Costs of shadows, mirrors and paths relative to the ray caster agree with the paper "
            "within a quarter",
            source,
            near,
            "; ".join(f"not {case}" for case, held in near.items() if not held) or "all",
        ),
        _similar(passes, relative.get(_PAPER_SCENE, {})),
        Claim.judged(
            "Instructions are proportional to the number of rays (read as: within a quarter)",
            source,
            {case: is_near(one, 1.0) for case, one in by_rays.items()},
            "instructions over rays, both relative to the ray caster: " + listed(by_rays, ".2f"),
        ),
    ]
    return result


_COUNTED = ("rays", "steps", "tests", "instructions", "words")

#: Columns of the published table, and ours on the branching machine.
_PRICED = (("instructions", "instructions"), ("bandwidth", "words"))


def _compared(
    relative: dict[str, dict[str, dict[str, float]]],
) -> list[tuple[str, float, float, str]]:
    """The rows of the published table for its scene: case, published, ours and why they differ."""
    rows = []
    for row, ratios in relative.get(_PAPER_SCENE, {}).items():
        paper = _ROWS[row].paper
        if paper is None:
            continue
        theirs = published("purcell", "extensions").values[paper]
        why = _other_scene(theirs, {name: each[row] for name, each in relative.items()})
        for key, own in _PRICED:
            told = "" if is_near(ratios[own], theirs[key]) else why
            rows.append((f"{row}: {key}", theirs[key], ratios[own], told))
    return rows


def _other_scene(theirs: dict[str, float], found: dict[str, dict[str, float]]) -> str:
    """A scene in which instructions and bandwidth are both near; empty if there is none."""
    for name, ratios in found.items():
        if all(is_near(ratios[own], theirs[key]) for key, own in _PRICED):
            return f"scene {name} gives " + ", ".join(
                f"{key} {ratios[own]:.3g}" for key, own in _PRICED
            )
    return ""


def _similar(passes: dict[str, dict[str, float]], branching: dict[str, dict[str, float]]) -> Claim:
    """The ratios to the ray caster are similar on both machines."""
    ratios = {
        f"{row}: {key}": (passes[row][own] / passes["raycast"][own], branching[row][other])
        for row in passes
        if row in branching
        for key, own, other in (
            ("instructions", "instructions", "instructions"),
            ("bandwidth", "bytes", "words"),
        )
    }
    return Claim.judged(
        "Results from the multipass machine are similar (read as: ratios to the ray caster within "
        "a quarter of the branching machine's)",
        published("purcell", "extensions").source,
        {case: is_near(*both) for case, both in ratios.items()},
        "multipass and branching: "
        + ", ".join(f"{case} {a:.2f} and {b:.2f}" for case, (a, b) in ratios.items()),
    )


def _multipass(runner: Runner, view: View, options: dict[str, Any]) -> dict[str, dict[str, float]]:
    """Costs of each row on the multipass machine per camera ray, by name."""
    tracer: _CountingTracer | None = None
    found = {}
    size = runner.size(_PATH_SIZE)
    for row in ("raycast", *(row for row in _ROWS if row != "path, to lights")):
        samples = _samples_of(runner, row, view.name)

        def measure(row: str = row, samples: int = samples) -> dict[str, float]:
            nonlocal tracer
            tracer = tracer or _CountingTracer(view.scene, **options)
            sums, eye_count = _count(tracer, row, size, samples), size * size * samples
            mode = row if row in ("raycast", "shadow rays") else _ROWS[row].mode
            own = {} if row == "raycast" else _ROWS[row].options
            runs = loop_runs(tracer, mode, own, size, samples)
            return loop_cost(runs, _shading_runs(row, sums, eye_count), eye_count)

        name = f"{view.name}, {row}, multipass, {size} x {size} x {samples}"
        found[row] = runner.measure(name, measure)
    return found


def _multipass_table(runner: Runner, passes: dict[str, dict[str, float]]) -> Table:
    size, base = runner.size(_PATH_SIZE), passes["raycast"]
    theirs = published("purcell", "extensions")
    rows: list[list[Cell]] = []
    for row, ours in passes.items():
        paper = theirs.values[_ROWS[row].paper] if row in _ROWS and _ROWS[row].paper else {}
        ratios = base if row == "raycast" else {key: n / base[key] for key, n in ours.items()}
        rows.append(
            [
                row,
                ours["passes"] / _samples_of(runner, row, _PAPER_SCENE),
                *(ratios[key] for key in ("rays", "steps", "tests", "instructions")),
                paper.get("instructions"),
                ratios["bytes"],
                paper.get("bandwidth"),
            ]
        )
    return Table.of(
        "purcell-extensions-multipass",
        f"Renderers as loops of the multipass machine: {_PAPER_SCENE}, {size} x {size}",
        ["mode", "passes per sample", "rays", "steps", "tests", "instructions"]
        + ["published, branching", "bytes", "bytes, published, branching"],
        rows,
        "Counts per camera ray: the ray caster's, and ratios to them. Instructions and bytes are "
        "by Table 1, multipass, with the stencil of all pixels in each pass. The paper gives no "
        "numbers for this machine.",
        "Shadow rays are traced by a query; all other modes are one loop per sample, whose shadow "
        "rays search for the nearest hit, with the same kernels as all other rays.",
    )


def _with_mirrors(view: View) -> View:
    """Keep one light, and make all surfaces reflect."""
    scene = view.scene
    polished = [
        dataclasses.replace(
            material,
            diffuse=_scaled(material.diffuse, 1.0 - _SHARE),
            reflection=(_SHARE,) * 3,
            transmission=(0.0,) * 3,
        )
        for material in scene.materials
    ]
    made = Scene(scene.meshes, materials=polished, lights=scene.lights[:1], camera=view.camera)
    return view._replace(scene=made)


def _scaled(color: tuple[float, float, float], share: float) -> tuple[float, float, float]:
    red, green, blue = color
    return share * red, share * green, share * blue


def _measure(runner: Runner, view: View, options: dict[str, Any]) -> dict[str, dict[str, float]]:
    """Costs of each row per camera ray, by name."""
    tracer: _CountingTracer | None = None
    found = {}
    for row in ("raycast", *_ROWS):
        size, samples = _size_of(runner, row, view.name)

        def measure(row: str = row, size: int = size, samples: int = samples) -> dict[str, float]:
            nonlocal tracer
            tracer = tracer or _CountingTracer(view.scene, **options)
            sums = _count(tracer, row, size, samples)
            return _cost(row, sums, size * size * samples)

        found[row] = runner.measure(f"{view.name}, {row}, {size} x {size} x {samples}", measure)
    rounds = 1 if runner.quick else _ROUNDS
    size = max(runner.size(SIZE) // _TIMED_SHARE, 16)
    times = runner.measure(
        f"{view.name}, times, {size} x {size}, {rounds} rounds",
        lambda: _times(runner, Tracer(view.scene, "grid", **options), view.name, rounds),
    )
    for row, seconds in times.items():
        found[row]["time"] = seconds * 1e6
    return found


def _size_of(runner: Runner, row: str, name: str) -> tuple[int, int]:
    """Width and height, and samples per pixel."""
    size = _PATH_SIZE if row.startswith("path") else SIZE
    return runner.size(size), _samples_of(runner, row, name)


def _samples_of(runner: Runner, row: str, name: str) -> int:
    """Samples per pixel: paths in the paper's scene have its own number."""
    if not row.startswith("path"):
        return 1
    theirs: int = published("purcell", "paths").values["samples"]
    return 4 if runner.quick else theirs if name == _PAPER_SCENE else _PATH_SAMPLES


def _count(tracer: _CountingTracer, row: str, size: int, samples: int) -> Sums:
    """Sums of both queries for an image."""
    tracer.start()
    camera = tracer.scene.camera
    if row == "raycast":
        tracer.first_hit(*camera.rays(size, size))
        return tracer.sums
    renderer = RENDERERS[_ROWS[row].mode]
    assert isinstance(renderer, Integrator)
    options = renderer.check(renderer.complete(_ROWS[row].options))
    context = make_context(tracer, camera, (size, size), Sampler.of("sobol", 0, samples), options)
    tracer.start()  # looking for lights traces rays
    step = max(_BAND // size, 1)
    for sample in range(samples):
        for first in range(0, size, step):
            renderer.trace(context, range(first, min(first + step, size)), sample)
    return tracer.sums


def _cost(row: str, sums: Sums, eye_count: int) -> dict[str, float]:
    """Rays, steps, tests, instructions and words per camera ray."""
    near, lit = sums["first_hit"], sums["any_hit"]
    traced = {key: near[key] + lit[key] for key in ("rays", "steps", "tests", "hits")}
    if row == "shadow rays":
        traced = {key: lit[key] for key in traced}
    runs = {
        "set up": traced["rays"],
        "step": traced["steps"],
        "intersect": traced["tests"],
        **_shading_runs(row, sums, eye_count),
    }
    table = prices("branching")
    words = {name: one.read + one.written + one.memory for name, one in table.items()}
    return {
        **{key: traced[key] / eye_count for key in ("rays", "steps", "tests")},
        "instructions": sum(table[name].instructions * n for name, n in runs.items()) / eye_count,
        "words": sum(words[name] * n for name, n in runs.items()) / eye_count,
    }


def _shading_runs(row: str, sums: Sums, eye_count: int) -> dict[str, int]:
    """Runs of the kernels of Table 1 that make rays and shade.

    Of the shadow rays alone, rasterisation replaces camera rays and their hits.
    """
    near, lit = sums["first_hit"], sums["any_hit"]
    runs = {"color": near["hits"], "shadow": lit["rays"]}
    if row == "shadow rays":
        return runs
    sent = near["rays"] - eye_count
    return {
        "generate eye ray": eye_count,
        **runs,
        "path" if row.startswith("path") else "reflected": sent,
    }


def _times(runner: Runner, tracer: Tracer, name: str, rounds: int) -> dict[str, float]:
    """Median seconds of each row's image per camera ray."""
    calls, ray_counts = {}, {}
    for row in ("raycast", *(row for row in _ROWS if row != "shadow rays")):
        mode, own = ("raycast", {}) if row == "raycast" else _ROWS[row][:2]
        size, samples = _size_of(runner, row, name)
        size = max(size // _TIMED_SHARE, 16)
        draw = partial(render, tracer, mode, samples=samples, **own)
        draw(size=(_WARM_SIZE, _WARM_SIZE))  # compiles
        calls[row] = partial(draw, size=(size, size))
        ray_counts[row] = size * size * samples
    times = median_times(calls, rounds, warm_up=False)
    return {row: seconds / ray_counts[row] for row, seconds in times.items()}

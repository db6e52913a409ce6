"""The cost of shadows, mirrors and paths relative to ray casting (Purcell 2002, section 4.3).

Each scene is traced on the uniform grid and the branching machine, as in Purcell's simulator, with
one light, and every surface reflects a quarter: his shading spawns a reflected ray at each hit.
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
from raystream.rendering.integrator import Integrator, make_context
from raystream.rendering.render import RENDERERS, render
from raystream.rendering.sampling.sampler import Sampler
from raystream.scene.scene import Scene
from raystream.tracer import Tracer
from raystream_lab.cost_model import prices
from raystream_lab.published import published
from raystream_lab.purcell.image_counts import SIZE
from raystream_lab.results import Cell, Claim, Result, Table, comparison
from raystream_lab.runner import Runner
from raystream_lab.timing import median_times
from raystream_lab.views import View

__all__ = ["extensions"]

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
        "path, by chance": _Row("path", {"max_bounces": 2, "light_samples": False}, "path"),
        "path, to lights": _Row("path", {"max_bounces": 2}, "path"),
    }
)

#: Share of light that every surface reflects.
_SHARE = 0.25

#: Width and height of path-traced images, and samples per pixel; the paper has 64.
_PATH_SIZE, _PATH_SAMPLES = 256, 16

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
    compared: list[tuple[str, Cell, Cell, str]] = []
    near: dict[str, bool] = {}
    for name, view in result.available(_QUICK_SCENES if runner.quick else _SCENES, runner.view):
        found = _measure(runner, _with_mirrors(view), _SCENES[name])
        base = found["raycast"]
        for row, ours in found.items():
            ratios = base if row == "raycast" else {key: n / base[key] for key, n in ours.items()}
            rows.append([name, row, *(ratios.get(key) for key in (*_COUNTED, "time"))])
            paper = _ROWS[row].paper if row in _ROWS else None
            if paper is not None and name.startswith("bunny"):
                theirs = published("purcell", "extensions").values[paper]
                for key, own in (("instructions", "instructions"), ("bandwidth", "words")):
                    sent = f"{ours['rays']:.2f} rays per camera ray"
                    compared.append((f"{row}: {key}", theirs[key], ratios[own], sent))
                    near[f"{row}: {key}"] = abs(ratios[own] / theirs[key] - 1.0) <= 0.25
    source = published("purcell", "extensions").source
    result.tables = [
        comparison(
            "purcell-extensions",
            f"Extensions over the ray caster, the bunny on a floor: {source}",
            compared,
            "Shadow rays: those of the paper's hybrid, which rasterises the visible surfaces. "
            "Paths of two bounces hit lights by chance, or also sample one at each surface; the "
            "paper does not say which.",
        ),
        Table.of(
            "purcell-extensions-all",
            "Counts per camera ray: the ray caster's, and ratios to them",
            ["scene", "mode", *_COUNTED, "time"],
            rows,
            "The ray caster's time is in microseconds per ray. Times are of whole images, "
            "medians of rounds in which the modes take turns; instructions and words by Table 1, "
            "branching.",
        ),
    ]
    result.claims = [
        Claim.judged(
            "Costs of shadows, mirrors and paths relative to the ray caster agree with the paper "
            "within a quarter",
            source,
            near,
            "; ".join(f"not {case}" for case, held in near.items() if not held) or "all",
        )
    ]
    return result


_COUNTED = ("rays", "steps", "tests", "instructions", "words")


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
        size, samples = _size_of(runner, row)

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
        lambda: _times(runner, Tracer(view.scene, "grid", **options), rounds),
    )
    for row, seconds in times.items():
        found[row]["time"] = seconds * 1e6
    return found


def _size_of(runner: Runner, row: str) -> tuple[int, int]:
    """Width and height, and samples per pixel."""
    if row.startswith("path"):
        return runner.size(_PATH_SIZE), 4 if runner.quick else _PATH_SAMPLES
    return runner.size(SIZE), 1


def _count(tracer: _CountingTracer, row: str, size: int, samples: int) -> Sums:
    """Sums of both queries for an image."""
    tracer.sums = {"first_hit": Counter(), "any_hit": Counter()}
    camera = tracer.scene.camera
    if row == "raycast":
        tracer.first_hit(*camera.rays(size, size))
        return tracer.sums
    renderer = RENDERERS[_ROWS[row].mode]
    assert isinstance(renderer, Integrator)
    options = renderer.check(renderer.complete(_ROWS[row].options))
    context = make_context(tracer, camera, (size, size), Sampler.of("sobol", 0, samples), options)
    step = max(_BAND // size, 1)
    for sample in range(samples):
        for first in range(0, size, step):
            renderer.trace(context, range(first, min(first + step, size)), sample)
    return tracer.sums


def _cost(row: str, sums: Sums, eye_count: int) -> dict[str, float]:
    """Rays, steps, tests, instructions and words per camera ray."""
    near, lit = sums["first_hit"], sums["any_hit"]
    traced = {key: near[key] + lit[key] for key in ("rays", "steps", "tests", "hits")}
    sent = near["rays"] - eye_count
    runs = {
        "generate eye ray": eye_count,
        "set up": traced["rays"],
        "step": traced["steps"],
        "intersect": traced["tests"],
        "color": traced["hits"],
        "shadow": lit["rays"],
        "path" if row.startswith("path") else "reflected": sent,
    }
    if row == "shadow rays":  # rasterisation replaces camera rays and their hits
        traced = {key: lit[key] for key in traced}
        runs = {
            "set up": lit["rays"],
            "step": lit["steps"],
            "intersect": lit["tests"],
            "color": near["hits"],
            "shadow": lit["rays"],
        }
    table = prices("branching")
    words = {name: one.read + one.written + one.memory for name, one in table.items()}
    return {
        **{key: traced[key] / eye_count for key in ("rays", "steps", "tests")},
        "instructions": sum(table[name].instructions * n for name, n in runs.items()) / eye_count,
        "words": sum(words[name] * n for name, n in runs.items()) / eye_count,
    }


def _times(runner: Runner, tracer: Tracer, rounds: int) -> dict[str, float]:
    """Median seconds of each row's image per camera ray."""
    calls, ray_counts = {}, {}
    for row in ("raycast", *(row for row in _ROWS if row != "shadow rays")):
        mode, own = ("raycast", {}) if row == "raycast" else _ROWS[row][:2]
        size, samples = _size_of(runner, row)
        size = max(size // _TIMED_SHARE, 16)
        draw = partial(render, tracer, mode, samples=samples, **own)
        draw(size=(_WARM_SIZE, _WARM_SIZE))  # compiles
        calls[row] = partial(draw, size=(size, size))
        ray_counts[row] = size * size * samples
    times = median_times(calls, rounds, warm_up=False)
    return {row: seconds / ray_counts[row] for row, seconds in times.items()}

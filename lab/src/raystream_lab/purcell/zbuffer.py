"""Ray tracing against the Z-buffer by depth complexity (Purcell 2002, section 5.3)."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from raystream.scene.camera import Camera
from raystream.scene.procedural import building as _building
from raystream.scene.procedural import forest as _forest
from raystream.scene.scene import Scene
from raystream.tracer import Tracer
from raystream_lab.cost_model import cost, prices
from raystream_lab.published import published
from raystream_lab.purcell.image_counts import ImageCounts, count_image, counts_of
from raystream_lab.results import Cell, Claim, Plot, Result, Series, Table
from raystream_lab.runner import Runner
from raystream_lab.views import View, without_lawn

_SIZE = 512

#: Triangles of the generated scenes.
_TRIANGLES = (3_000, 10_000, 30_000, 100_000, 300_000, 1_000_000)
_LAYERS = (1, 2, 4, 8, 16, 32, 64)

#: Small triangles per layer; they cover about half of it.
_LAYER_TRIANGLES = 4000

#: Instructions of a vertex program that transforms and lights: the paper gives no number, so the
#: table shows both ends of a plausible range.
_VERTEX_INSTRUCTIONS = (4, 40)

#: Instructions of a fragment that only compares its depth.
_DEPTH_TEST = 1


class _Family(NamedTuple):
    """Scenes of growing depth complexity in one view."""

    name: str
    about: str


_FAMILIES = (
    _Family("layers", "parallel layers of small random triangles, each half covered"),
    _Family("forest inside", "the forest with more and more trees"),
    _Family("building inside", "the building with more and more rooms"),
)


def zbuffer(runner: Runner) -> Result:
    """Instructions of both methods, and their crossover."""
    result = Result()
    size = min(runner.size(_SIZE), _SIZE)
    rows: list[list[Cell]] = []
    crossings, growth = [], {}
    faster: dict[str, bool] = {}
    for family in _FAMILIES:
        found = [
            _measure(runner, family.name, number, size) for number in _numbers(runner, family.name)
        ]
        found.sort(key=lambda one: one["depth"])
        lines = {name: [one[name] for one in map(_costs, found)] for name in _costs(found[0])}
        depths = [one["depth"] for one in found]
        for one, *values in zip(found, *lines.values(), strict=True):
            rows.append([family.name, one["triangles"], one["depth"], one["v"], one["t"], *values])
        result.plots.append(_plot(family, depths, lines))
        for name in list(lines)[1:]:
            at = _crossing(depths, lines["ray tracing"], lines[name])
            crossings.append([family.name, name, at, _where(depths, at, lines, name)])
            faster[f"{family.name}, {name}"] = at is not None
        growth[family.name] = {name: _exponent(depths, values) for name, values in lines.items()}
    names = list(next(iter(growth.values())))
    result.tables = [
        Table.of(
            "purcell-zbuffer",
            f"Instructions per pixel, ray tracing and Z-buffer; {size} x {size}",
            ["scenes", "triangles", "depth complexity", "v", "t", *names],
            rows,
            *(f"{one.name}: {one.about}." for one in _FAMILIES),
            "Depth complexity: triangles that a pixel's ray hits, by counting all hits. Ray "
            "tracing: Table 1, branching, on the paper's grids; smaller scenes have as many cells "
            "per triangle. Z-buffer: each triangle's three vertices are processed by programs of "
            f"{_VERTEX_INSTRUCTIONS[0]} or {_VERTEX_INSTRUCTIONS[1]} instructions, and each "
            "fragment is shaded by the same colour kernel; deferred: only the nearest fragment is "
            "shaded.",
        ),
        Table.of(
            "purcell-crossover",
            "The depth complexity from which ray tracing takes fewer instructions",
            ["scenes", "against", "crossover", ""],
            crossings,
        ),
        Table.of(
            "purcell-growth",
            "Growth of instructions with depth complexity: exponent of a power law",
            ["scenes", *names],
            [[name, *values.values()] for name, values in growth.items()],
            "1 is linear, 0 constant. Exponents are fitted to the logarithms over all of a "
            "family's scenes.",
        ),
    ]
    result.claims = [
        Claim.judged(
            "The Z-buffer's cost grows linearly with depth complexity, ray tracing's more slowly",
            "Purcell 2002, section 5.3",
            {
                name: values["ray tracing"] < 0.5 * values[names[1]]
                for name, values in growth.items()
            },
            "; ".join(
                f"{name}: exponents {values['ray tracing']:.2f} (rays), {values[names[1]]:.2f}"
                for name, values in growth.items()
            ),
        ),
        Claim.judged(
            "At high depth complexity ray tracing is cheaper",
            "Purcell 2002, section 5.3",
            faster,
            "; ".join(
                f"{family}, {name}: "
                + (f"from {at:.3g}" if isinstance(at, float) else "not within the sweep")
                for family, name, at, _ in crossings
            ),
        ),
    ]
    return result


def _numbers(runner: Runner, family: str) -> tuple[int, ...]:
    numbers = _LAYERS if family == "layers" else _TRIANGLES
    return numbers[:4] if runner.quick else numbers


def _view(family: str, number: int) -> View:
    if family == "layers":
        return _layers(number)
    if family.startswith("forest"):
        scene = _forest.forest(number)
        return View(family, f"forest {number}", scene, _forest.inside_camera(scene), "")
    scene = _building.building(number)
    camera = _building.inside_camera(scene)
    return View(family, f"building {number}", without_lawn(scene), camera, "")


def _layers(count: int) -> View:
    """Layers of random triangles, one behind the other."""
    rng = np.random.default_rng(2002)
    side = math.sqrt(1.0 / _LAYER_TRIANGLES)
    middles = rng.random((count, _LAYER_TRIANGLES, 1, 3))
    # Each triangle covers half of its share of the area, so about 40 % stays uncovered.
    corners = middles + side * np.array([[-0.6, -0.5, 0], [0.6, -0.5, 0], [0, 0.66, 0]])
    corners[..., 2] = -np.arange(count).reshape(-1, 1, 1) / max(_LAYERS)
    scene = Scene.from_arrays(
        corners.reshape(-1, 3), np.arange(3 * count * _LAYER_TRIANGLES).reshape(-1, 3)
    )
    camera = Camera((0.5, 0.5, 1.0), (0.5, 0.5, 0.0), projection="orthographic", height=0.9)
    return View("layers", f"layers {count}", scene, camera, "")


def _grid(family: str, number: int) -> dict[str, Any]:
    """Purcell's cells for a million triangles, and as many per triangle in smaller scenes."""
    if family == "layers":
        return {}
    cells = published("purcell", "grids").values["min_resolution"][family.split()[0]]
    triangles = published("purcell", "triangles").values[family.split()[0]]
    return {"min_resolution": max(4, round(cells * (number / triangles) ** (1 / 3)))}


def _measure(runner: Runner, family: str, number: int, size: int) -> dict[str, Any]:
    def measure() -> dict[str, Any]:
        view = _view(family, number)
        grid = Tracer(view.scene, "grid", counters=True, **_grid(family, number))
        values: ImageCounts = count_image(grid, view, size)
        counts = Tracer(view.scene).count_hits(*view.rays(size))
        return {
            **values,
            "triangles": view.scene.triangle_count,
            "depth": float(np.mean(counts)),
        }

    found: dict[str, Any] = runner.measure(f"{family}, {number}, {size} x {size}", measure)
    return found


def _costs(one: dict[str, Any]) -> dict[str, float]:
    """Instructions per pixel of each method."""
    table = prices("branching")
    rays = one["rays"]
    traced = cost(counts_of(one), table).all_instructions / rays
    color, vertices = table["color"].instructions, 3 * one["triangles"] / rays
    cheap, dear = _VERTEX_INSTRUCTIONS
    fragments = one["depth"]
    deferred = fragments * _DEPTH_TEST + one["s"] * color
    return {
        "ray tracing": traced,
        f"Z-buffer, {cheap} per vertex": vertices * cheap + fragments * color,
        f"Z-buffer, {dear} per vertex": vertices * dear + fragments * color,
        f"deferred, {dear} per vertex": vertices * dear + deferred,
    }


def _crossing(depths: list[float], traced: list[float], other: list[float]) -> float | None:
    """Depth complexity beyond which ray tracing stays cheaper; the first scene's if always."""
    for k in reversed(range(len(depths))):
        if traced[k] >= other[k]:
            if k + 1 == len(depths):
                return None
            gaps = [math.log(traced[j] / other[j]) for j in (k, k + 1)]
            share = gaps[0] / (gaps[0] - gaps[1])
            return float(depths[k] * (depths[k + 1] / depths[k]) ** share)
    return float(depths[0])


def _where(depths: list[float], at: float | None, lines: dict[str, list[float]], name: str) -> str:
    if at is None:
        ratio = lines["ray tracing"][-1] / lines[name][-1]
        return f"none up to {depths[-1]:.3g}, where ray tracing takes {ratio:.2g} times as many"
    return "throughout" if at == depths[0] else ""


def _exponent(depths: list[float], values: list[float]) -> float:
    return float(np.polyfit(np.log(depths), np.log(values), 1)[0])


def _plot(family: _Family, depths: list[float], lines: dict[str, list[float]]) -> Plot:
    return Plot(
        f"purcell-zbuffer-{family.name.replace(' ', '-')}",
        f"{family.name}: instructions per pixel by depth complexity",
        "triangles hit by a pixel's ray",
        "instructions per pixel",
        [Series(name, list(depths), list(values)) for name, values in lines.items()],
        log_x=True,
        log_y=True,
    )

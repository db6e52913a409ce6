"""The cost of finding all hits of a ray, against their number."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from raystream.scene.camera import Camera
from raystream.scene.mesh import Mesh
from raystream.scene.scene import Scene
from raystream.tracer import Tracer
from raystream_lab.agreement import Row, agreement_claim, agreement_table
from raystream_lab.frame_timing import report_image
from raystream_lab.published import published
from raystream_lab.rayforce.scenes import REFERENCE, STRUCTURES, device_options
from raystream_lab.results import Cell, Claim, Plot, Result, Series, Table
from raystream_lab.runner import Runner
from raystream_lab.timing import median_times

LAYERS = (1, 2, 4, 8, 16, 32, 64)
_QUICK_LAYERS = (1, 8, 64)

#: Squares per side of each sheet.
CELLS = 8

SIZE = 192
ROUNDS = 5

QUERIES: dict[str, Callable[..., object]] = {
    "first_hit": lambda tracer, rays: tracer.first_hit(*rays),
    "any_hit": lambda tracer, rays: tracer.any_hit(*rays),
    "multi_hit, 1": lambda tracer, rays: tracer.multi_hit(*rays, max_hits=1),
    "multi_hit, 4": lambda tracer, rays: tracer.multi_hit(*rays, max_hits=4),
    "multi_hit, all": lambda tracer, rays: tracer.multi_hit(*rays),
}

#: Our reading of "low overhead".
LOW_OVERHEAD = 2.0


def layered_scene(count: int) -> Scene:
    """Parallel sheets, one behind the other, with equal numbers of triangles.

    Parameters
    ----------
    count : int
        Number of sheets of 2 x 2 units between z = 0 and z = 1.

    Returns
    -------
    Scene
        With a camera that looks through all of them; its rays hit no edge exactly.
    """
    side = np.linspace(-1.0, 1.0, CELLS + 1)
    x, y = np.meshgrid(side, side)
    corner = np.arange(CELLS * (CELLS + 1)).reshape(CELLS, CELLS + 1)[:, :-1].ravel()
    square = np.stack([corner, corner + 1, corner + CELLS + 2, corner + CELLS + 1], axis=1)
    faces = np.concatenate([square[:, [0, 1, 2]], square[:, [0, 2, 3]]])
    sheets = [
        Mesh(np.stack([x.ravel(), y.ravel(), np.full(x.size, z)], axis=1), faces)
        for z in np.linspace(0.0, 1.0, count)
    ]
    return Scene(sheets, camera=Camera((0.031, 0.017, -3.0), (0.0, 0.0, 0.5), fov=24.0))


def layers(runner: Runner) -> Result:
    """Five queries of the same rays through more and more layers."""
    counts = _QUICK_LAYERS if runner.quick else LAYERS
    found = {count: _measured(runner, count) for count in counts}
    source = published("rayforce", "structure").source
    ratios = {
        f"{count}": _ratio(each[REFERENCE], "multi_hit, 1", "first_hit")
        for count, each in found.items()
    }
    text = (
        "first-hit, any-hit and multi-hit traversal have low overhead: for one hit, multi-hit "
        f"takes at most {LOW_OVERHEAD:g} times as long as first-hit"
    )
    result = Result(
        tables=[_times(runner, found), _counts(found)],
        plots=[_plot_all(found), _plot_queries(found)],
        claims=[
            Claim.judged(
                text,
                source,
                {case: ratio <= LOW_OVERHEAD for case, ratio in ratios.items()},
                f"{REFERENCE}, times by layers: "
                + ", ".join(f"{ratio:.2f} ({case})" for case, ratio in ratios.items())
                + "; the meaning of low is our reading",
            )
        ],
    )
    if runner.device != "cpu":
        rows = _agreement_rows(found)
        title = "Layers: the device's counts against the CPU's"
        result.tables.append(
            agreement_table("rayforce-layer-agreement", title, runner.device, rows)
        )
        result.claims.append(agreement_claim(runner.device, rows))
        result.notes.append(runner.facts.note)
        return result
    result.images.append(
        report_image(
            runner,
            "rayforce layers",
            "16 layers, drawn as clear sheets",
            layered_scene(16),
            "xray",
            (240, 240),
            camera=Camera((-3.2, 1.4, -2.6), (0.0, 0.0, 0.5), fov=42.0),
        )
    )
    return result


def _measured(runner: Runner, count: int) -> dict[str, dict[str, Any]]:
    """Times and counts of each structure."""

    def measure() -> dict[str, dict[str, Any]]:
        scene = layered_scene(count)
        size = runner.device_size(SIZE)
        rays = scene.camera_for(1.0).rays(size, size)
        options = {name: device_options(runner, name) for name in STRUCTURES}
        tracers = {name: Tracer(scene, name, **chosen) for name, chosen in options.items()}
        calls = {
            f"{name}, {title}": partial(query, tracer, rays)
            for name, tracer in tracers.items()
            for title, query in QUERIES.items()
        }
        seconds = median_times(calls, 1 if runner.quick else ROUNDS)
        return {
            name: {
                "rays": size * size,
                "seconds": {title: seconds[f"{name}, {title}"] for title in QUERIES},
                **_counted(scene, name, rays, options[name]),
                **({} if runner.device == "cpu" else {"cpu": _counted(scene, name, rays, {})}),
            }
            for name in STRUCTURES
        }

    values: dict[str, dict[str, Any]] = runner.measure(f"{count} layers", measure)
    return values


def _counted(scene: Scene, structure: str, rays: Any, options: dict[str, Any]) -> dict[str, Any]:
    """Steps and tests for the nearest and for all hits, and the number of hits."""
    tracer = Tracer(scene, structure, counters=True, **options)
    tracer.first_hit(*rays)
    first = tracer.counters.total
    hits = int(tracer.count_hits(*rays).sum())
    total = tracer.counters.total
    return {
        "hits": hits,
        "first": [first["steps"] + first["link_nodes"], first["tests"]],
        "all": [total["steps"] + total["link_nodes"], total["tests"]],
    }


def _agreement_rows(found: dict[int, dict[str, dict[str, Any]]]) -> list[Row]:
    rows: list[Row] = []
    for count, each in found.items():
        for name, one in each.items():
            case, cpu = f"{count} layers, {name}", one["cpu"]
            rows.append((f"{case}: hits", cpu["hits"], one["hits"]))
            for query in ("first", "all"):
                rows += [
                    (f"{case}: {what}, {query}", theirs, ours)
                    for what, theirs, ours in zip(
                        ("steps", "tests"), cpu[query], one[query], strict=True
                    )
                ]
    return rows


def _ratio(one: dict[str, Any], query: str, other: str) -> float:
    return float(one["seconds"][query] / one["seconds"][other])


def _times(runner: Runner, found: dict[int, dict[str, dict[str, Any]]]) -> Table:
    rows: list[list[Cell]] = []
    for count, each in found.items():
        for name, one in each.items():
            rays = one["rays"]
            times: list[Cell] = [1e9 * one["seconds"][title] / rays for title in QUERIES]
            per_hit = 1e9 * one["seconds"]["multi_hit, all"] / one["hits"]
            rows.append([count, name, *times, per_hit])
    size = runner.device_size(SIZE)
    return Table.of(
        "rayforce-layers",
        f"Layers: nanoseconds per ray, {size} x {size} rays",
        ["layers", "structure", *QUERIES, "all, per hit"],
        rows,
        f"Sheets of {2 * CELLS**2} triangles, parallel and facing the camera; each ray hits all of "
        "them. With `max_hits` of 1 or 4, only the nearest hits are kept. Times are medians of "
        "rounds in which structures take turns; only the BVH has kernels for many rays at once.",
    )


def _counts(found: dict[int, dict[str, dict[str, Any]]]) -> Table:
    rows: list[list[Cell]] = [
        [
            count,
            name,
            one["hits"] / one["rays"],
            *(number / one["rays"] for number in (*one["first"], *one["all"])),
        ]
        for count, each in found.items()
        for name, one in each.items()
    ]
    return Table.of(
        "rayforce-layer-counts",
        "Layers: steps and tests per ray",
        ["layers", "structure", "hits", "steps, first hit", "tests, first hit"]
        + ["steps, all hits", "tests, all hits"],
        rows,
        "Steps are cells, inner nodes, or sectors and link nodes; tests are of triangles.",
    )


def _plot_all(found: dict[int, dict[str, dict[str, Any]]]) -> Plot:
    return Plot(
        "rayforce-layers",
        "All hits of a ray",
        "layers",
        "nanoseconds per ray",
        [
            Series(
                name,
                list(found),
                [
                    1e9 * each[name]["seconds"]["multi_hit, all"] / each[name]["rays"]
                    for each in found.values()
                ],
            )
            for name in STRUCTURES
        ],
        log_x=True,
        log_y=True,
    )


def _plot_queries(found: dict[int, dict[str, dict[str, Any]]]) -> Plot:
    ours = {count: each[REFERENCE] for count, each in found.items()}
    return Plot(
        "rayforce-layer-queries",
        f"Queries in the {REFERENCE}",
        "layers",
        "nanoseconds per ray",
        [
            Series(
                title,
                list(ours),
                [1e9 * one["seconds"][title] / one["rays"] for one in ours.values()],
            )
            for title in QUERIES
        ],
        log_x=True,
        log_y=True,
    )

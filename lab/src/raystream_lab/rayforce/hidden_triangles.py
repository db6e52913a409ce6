"""Whether the cost of a ray depends on hidden geometry."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np

from raystream.core.errors import RaystreamError
from raystream.core.hits import Hits
from raystream.scene.load import load
from raystream.scene.mesh import Mesh
from raystream.scene.scene import Scene
from raystream.structures.graph.structure import GraphStructure
from raystream.tracer import Tracer
from raystream_lab.agreement import Row, agreement_claim, agreement_table
from raystream_lab.frame_timing import report_image
from raystream_lab.published import published
from raystream_lab.rayforce.scenes import REFERENCE, STRUCTURES, device_options
from raystream_lab.results import Cell, Claim, Plot, Result, Series, Table, is_near
from raystream_lab.runner import Runner
from raystream_lab.timing import median_times

#: Hidden triangles per visible triangle.
FACTORS = (0, 1, 2, 4, 8, 16, 32, 64)
_QUICK_FACTORS = (0, 1, 8)

PLACES = ("behind a wall", "beside the view")

#: The visible scene.
VISIBLE = "spheres"

SIZE = 256
ROUNDS = 3

#: Spread of a hidden triangle's vertices, relative to the scene's size.
_SPREAD = 0.004


def scene_with_hidden(place: str, factor: int) -> Scene:
    """A scene in front of a wall, with small triangles that its camera cannot see.

    Parameters
    ----------
    place : {"behind a wall", "beside the view"}
        Behind the wall's plane, seen from the camera; or in front of it, to the camera's right.
    factor : int
        Hidden triangles per triangle of the scene.

    Raises
    ------
    ValueError
        If the place is unknown.
    """
    if place not in PLACES:
        raise ValueError(f"place: expected one of {', '.join(PLACES)}, got {place!r}")
    visible = load(VISIBLE)
    low, high = (bound.astype(np.float64) for bound in visible.bounds)
    middle, size = (low + high) / 2.0, float((high - low).max())
    _, up, backward = (np.rint(axis) for axis in _axes(visible))
    right = np.cross(up, backward)
    wall_at = middle - backward * (np.abs(backward) @ (high - low)) * 0.51
    corners = [wall_at + 4.0 * size * (a * right + b * up) for a, b in _SQUARE]
    meshes = [Mesh(mesh.vertices, mesh.faces) for mesh in visible.meshes]
    meshes.append(Mesh(np.array(corners), [[0, 1, 2], [0, 2, 3]], name="wall"))
    if factor:
        aside = -1.1 * backward if place == PLACES[0] else 1.3 * right
        count = factor * visible.triangle_count
        generator = np.random.default_rng(1)
        centres = low + generator.random((count, 1, 3)) * (high - low) + aside * size
        vertices = centres + _SPREAD * size * generator.normal(size=(count, 3, 3))
        meshes.append(Mesh(vertices.reshape(-1, 3), np.arange(3 * count).reshape(-1, 3)))
    return Scene(meshes, camera=visible.camera)


_SQUARE = ((-1, -1), (1, -1), (1, 1), (-1, 1))


def _axes(scene: Scene) -> tuple[Any, Any, Any]:
    """The camera's right, the scene's up, and the direction towards the camera, along axes."""
    up = np.asarray(scene.up, np.float64)
    low, high = scene.bounds
    away = np.asarray(scene.camera_for(1.0).eye, np.float64) - (low + high) / 2.0
    away -= up * (away @ up)
    backward = np.zeros(3)
    axis = int(np.argmax(np.abs(away)))
    backward[axis] = np.sign(away[axis])
    return np.cross(up, backward), up, backward


def hidden_triangles(runner: Runner) -> Result:
    """The same view with more and more hidden triangles."""
    factors = _QUICK_FACTORS if runner.quick else FACTORS
    found = {
        (place, factor): _measured(runner, place, factor) for place in PLACES for factor in factors
    }
    result = Result(
        tables=[_table(runner, found)],
        plots=[_plot(found, place, part) for place in PLACES for part in ("steps", "tests")],
        claims=[_claim(found, factors)],
    )
    if runner.device != "cpu":
        rows = _agreement_rows(found)
        title = "Hidden geometry: the device's counts against the CPU's"
        result.tables.append(
            agreement_table("rayforce-hidden-agreement", title, runner.device, rows)
        )
        result.claims.append(agreement_claim(runner.device, rows))
        result.notes.append(runner.facts.note)
        result.notes += [
            f"{factor} times as many, {place}, {name}: {reason}"
            for (place, factor), values in found.items()
            for name, reason in values.get("refused", {}).items()
        ]
        return result
    for place in PLACES:
        scene = scene_with_hidden(place, factors[-1])
        name = f"rayforce {place}"
        title = f"The view with {factors[-1]} times as many triangles {place}"
        result.images.append(report_image(runner, name, title, scene, "vis", (240, 240)))
    return result


def _measured(runner: Runner, place: str, factor: int) -> dict[str, Any]:
    def measure() -> dict[str, Any]:
        scene, size = scene_with_hidden(place, factor), runner.device_size(SIZE)
        rays = scene.camera_for(1.0).rays(size, size)
        alone = Tracer(scene_with_hidden(place, 0)).first_hit(*rays)
        values: dict[str, Any] = {"triangles": scene.triangle_count}
        for name in STRUCTURES:
            try:
                values[name] = _traced(runner, scene, name, rays, alone)
            except RaystreamError as error:
                if runner.device == "cpu" or name == REFERENCE:
                    raise
                values.setdefault("refused", {})[name] = str(error)
        return values

    values: dict[str, Any] = runner.measure(f"{factor} times as many, {place}", measure)
    return values


def _traced(runner: Runner, scene: Scene, name: str, rays: Any, alone: Hits) -> dict[str, Any]:
    """Counts and times of a structure; the CPU's counts, too, if another device traces it."""
    options = device_options(runner, name)
    tracer = Tracer(scene, name, progress=runner.progress, **options)
    rounds = 1 if runner.quick else ROUNDS
    seconds = median_times({name: partial(tracer.first_hit, *rays)}, rounds)[name]
    counting = Tracer(scene, name, counters=True, **options)
    hits = counting.first_hit(*rays)
    total, count = counting.counters.total, hits.t.size
    values: dict[str, Any] = {
        "price": _graph_cost(counting, total, count),
        **_per_ray(total, count),
        "nanoseconds": 1e9 * seconds / count,
        "changed": int(np.count_nonzero(hits.prim_id != alone.prim_id)),
    }
    if runner.device != "cpu":
        reference = Tracer(scene, name, counters=True)
        reference.first_hit(*rays)
        values["cpu"] = _per_ray(reference.counters.total, count)
    return values


def _per_ray(total: Mapping[str, int], count: int) -> dict[str, float]:
    return {
        "steps": (total["steps"] + total["link_nodes"]) / count,
        "tests": total["tests"] / count,
    }


def _graph_cost(tracer: Tracer, total: Mapping[str, int], count: int) -> float | None:
    """Cost per ray by the graph's build costs."""
    if not isinstance(tracer.structure, GraphStructure):
        return None
    options = tracer.structure.options
    sectors = options.crossing_cost * total["steps"]
    nodes = options.link_cost * total["link_nodes"]
    return float(sectors + nodes + options.intersection_cost * total["tests"]) / count


_Found = dict[tuple[str, int], dict[str, Any]]


def _present(values: dict[str, Any]) -> list[str]:
    """The structures that were traced."""
    return [name for name in STRUCTURES if name in values]


def _table(runner: Runner, found: _Found) -> Table:
    rows: list[list[Cell]] = []
    for (place, factor), values in found.items():
        for name in _present(values):
            one = values[name]
            rows.append(
                [place, factor, values["triangles"], name]
                + [one[part] for part in ("steps", "tests", "price", "nanoseconds", "changed")]
            )
    size = runner.device_size(SIZE)
    return Table.of(
        "rayforce-hidden",
        f"Work per ray as hidden geometry grows: {VISIBLE}, {size} x {size} rays",
        ["more triangles", "times", "triangles", "structure", "steps", "tests", "price"]
        + ["ns per ray", "pixels that changed"],
        rows,
        "Verdicts rest on counts, not on times. The price is the cost of a ray's sectors, link "
        "nodes and tests in the cost model of the graph's builder, which trades steps for tests. "
        "Times are those of the BVH's kernels for many rays, and of single rays in the other "
        "structures.",
    )


def _agreement_rows(found: _Found) -> list[Row]:
    return [
        (f"{place}, {factor} times, {name}: {part}", cpu[part], values[name][part])
        for (place, factor), values in found.items()
        for name in _present(values)
        for cpu in [values[name]["cpu"]]
        for part in ("steps", "tests")
    ]


def _claim(found: _Found, factors: tuple[int, ...]) -> Claim:
    least, *others = factors
    ratios = {
        f"{part}, {place}": [
            found[place, one][REFERENCE][part] / found[place, least][REFERENCE][part]
            for one in others
        ]
        for place in PLACES
        for part in ("steps", "tests", "price")
    }
    return Claim.judged(
        "performance depends only on geometric complexity along a ray: steps, tests and price of "
        f"the graph stay within a quarter of those with {least} hidden triangles, up to "
        f"{others[-1]} times the visible ones",
        published("rayforce", "structure").source,
        {case: all(is_near(one, 1.0) for one in each) for case, each in ratios.items()},
        "; ".join(f"{case}: {min(each):.2f} to {max(each):.2f}" for case, each in ratios.items()),
    )


def _plot(found: _Found, place: str, part: str) -> Plot:
    chosen = {factor: values for (where, factor), values in found.items() if where == place}
    return Plot(
        f"rayforce-hidden-{part}-{place.split()[0]}",
        f"{part.capitalize()} per ray, with more triangles {place}",
        "triangles in the scene",
        f"{part} per ray",
        [
            Series(
                name,
                [values["triangles"] for values in chosen.values()],
                [values[name][part] if name in values else None for values in chosen.values()],
            )
            for name in STRUCTURES
        ],
        log_x=True,
        log_y=True,
    )

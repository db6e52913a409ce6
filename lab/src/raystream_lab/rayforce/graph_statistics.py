"""Size and build time of the graph, and the work of rays in it."""

from __future__ import annotations

from typing import Any

import numpy as np

from raystream.core.rays import RayBatch
from raystream.machines.ray_block import blocks
from raystream.structures.graph.structure import GraphStructure
from raystream.tracer import Tracer
from raystream_lab.diffuse_bounces import cosine_directions
from raystream_lab.published import published
from raystream_lab.rayforce.scenes import REFERENCE, STRUCTURES, scenes
from raystream_lab.rayforce.start_walks import secondary_rays, start_walks
from raystream_lab.results import Cell, Claim, Plot, Result, Series, Table, listed
from raystream_lab.runner import Runner
from raystream_lab.views import View

#: Kinds of rays that are counted.
RAYS = ("from the eye", "from surfaces", "at random")

SIZE = 256

Rays = tuple[Any, Any]


def ray_sets(view: View, size: int) -> dict[str, Rays]:
    """Rays of three kinds: origins and directions of shape (N, 3).

    Parameters
    ----------
    view : View
    size : int
        Width and height of the image of camera rays.

    Returns
    -------
    dict
        ``from the eye``; ``from surfaces``, diffuse bounces of these; ``at random`` in the scene's
        box.
    """
    generator = np.random.default_rng(0)
    origins, directions = (np.reshape(one, (-1, 3)) for one in view.rays(size))
    origins = np.broadcast_to(origins, directions.shape)
    hits = Tracer(view.scene).first_hit(origins, directions)
    seen = hits[hits.is_hit]
    normals = np.asarray(seen.normals, np.float64)
    away = cosine_directions(normals, directions[hits.is_hit], generator)
    low, high = view.scene.bounds
    everywhere = generator.uniform(low, high, directions.shape)
    return dict(
        zip(
            RAYS,
            (
                (origins, directions),
                seen.spawn(away),
                (everywhere, generator.normal(size=directions.shape)),
            ),
            strict=True,
        )
    )


def graph_statistics(runner: Runner) -> Result:
    """Sectors, link nodes, bytes and build times; steps to the start sector, and from there."""
    result = Result()
    found: dict[str, dict[str, Any]] = {}
    for view in scenes(runner, result):
        found[view.name] = _measured(runner, view)
    result.tables = [
        _graphs(found),
        _walks(found),
        _displacement(found),
        _structures(found),
        _steps(runner, found),
    ]
    result.plots = [_plot(found, kind) for kind in RAYS[:2]]
    result.claims = [_efficient(found), _displacement_claim(found)]
    return result


def _efficient(found: dict[str, dict[str, Any]]) -> Claim:
    """The graph's memory against each of the other structures'."""
    ratios = {
        f"{name}, {structure}": values["structures"][REFERENCE]["bytes"] / one["bytes"]
        for name, values in found.items()
        for structure, one in values["structures"].items()
        if structure != REFERENCE
    }
    return Claim.judged(
        "the structure is efficient: its layout minimises storage (read as: the graph takes no "
        "more memory than each of the other structures)",
        published("rayforce", "structure").source,
        {case: ratio <= 1.0 for case, ratio in ratios.items()},
        f"bytes of the {REFERENCE} over those of the other: {listed(ratios)}; the layout is our "
        "reading, the poster gives no sizes",
    )


def _measured(runner: Runner, view: View) -> dict[str, Any]:
    def measure() -> dict[str, Any]:
        rays = ray_sets(view, runner.size(SIZE))
        values: dict[str, Any] = {"triangles": view.scene.triangle_count, "structures": {}}
        for name in STRUCTURES:
            tracer = Tracer(view.scene, name, counters=True, progress=runner.progress)
            again = Tracer(view.scene, name)  # the first one may have compiled
            report = again.structure.report
            values["structures"][name] = {
                "bytes": report.byte_count,
                "seconds": min(report.seconds, tracer.structure.report.seconds),
                "rays": {kind: _counted(tracer, one) for kind, one in rays.items()},
            }
            if isinstance(tracer.structure, GraphStructure):
                values["quality"] = tracer.structure.quality()
                values["bins"] = list(tracer.structure.graph.bins.shape)
                values["walks"] = {kind: _walk(tracer.structure, one) for kind, one in rays.items()}
                values["leaving"] = _displaced(tracer, view, runner.size(SIZE))
        return values

    values: dict[str, Any] = runner.measure(view.name, measure)
    return values


def _counted(tracer: Tracer, rays: Rays) -> dict[str, float]:
    """Mean counts per ray of a first-hit query."""
    tracer.first_hit(*rays)
    total, count = tracer.counters.total, max(tracer.counters.steps.size, 1)
    return {name: total[name] / count for name in ("steps", "link_nodes", "tests")}


def _walk(structure: GraphStructure, rays: Rays) -> dict[str, float]:
    """Sectors left between a bin's sector and the ray's start sector."""
    batch = RayBatch(*rays)
    (block,) = blocks(batch, structure.frame, np.zeros(len(batch), np.uint8), None)
    found = structure.start_sectors(block.rays)
    counts = found.step_counts[found.rows >= 0]
    if not len(counts):
        return {"mean": 0.0, "most": 0, "none": 0.0}
    return {
        "mean": float(counts.mean()),
        "most": int(counts.max()),
        "none": float(np.mean(counts == 0)),
    }


def _displaced(tracer: Tracer, view: View, size: int) -> dict[str, dict[str, float]]:
    """Walks of secondary rays by route, and the steps from there, by kind of ray."""
    graph = tracer.structure
    assert isinstance(graph, GraphStructure)
    found = {}
    for rays in secondary_rays(tracer, view, size):
        walks = start_walks(graph, rays)
        query = tracer.any_hit if rays.any_hit else tracer.first_hit
        query(rays.origins, rays.directions, t_max=rays.t_max)
        steps = tracer.counters.total["steps"] / max(len(rays.origins), 1)
        found[rays.kind] = {**walks._asdict(), "steps": steps}
    return found


def _displacement(found: dict[str, dict[str, Any]]) -> Table:
    rows: list[list[Cell]] = []
    for name, values in found.items():
        for kind, one in values["leaving"].items():
            saved = (one["in_turn"] - one["displaced"]) / (one["in_turn"] + one["steps"])
            rows.append(
                [name, kind, one["bins"], one["in_turn"], one["displaced"], one["steps"], saved]
            )
    return Table.of(
        "rayforce-displacement",
        "Sectors passed on the way to the start sector of rays that leave a hit, mean",
        ["scene", "rays", "from bins", "from bins, in turn", "by displacement", "steps from there"]
        + ["saved, of all"],
        rows,
        "ao: 32 any-hit rays from each first hit. Bounces: those of kajiya. In turn: from the "
        "sector of the previous ray, if it began in the same bin, as for rays without a known "
        "sector. By displacement: from the sector of the hit (Hits.sectors, near=), as ao, kajiya "
        "and path do. Saved: share of the sectors passed and visited in turn.",
    )


def _displacement_claim(found: dict[str, dict[str, Any]]) -> Claim:
    cases = {
        f"{name}, {kind}": one["displaced"] < 0.5 * one["in_turn"]
        for name, values in found.items()
        for kind, one in values["leaving"].items()
    }
    walks = [one for values in found.values() for one in values["leaving"].values()]
    most = max((one["displaced"] for one in walks), default=0.0)
    return Claim.judged(
        "Rays that begin in the sector of their hit pass less than half as many sectors on the way "
        "to their start",
        "Rayforce 2013, section 2; displacement from other origins",
        cases,
        f"at most {most:.2g} sectors by displacement",
    )


def _graphs(found: dict[str, dict[str, Any]]) -> Table:
    rows: list[list[Cell]] = []
    for name, values in found.items():
        quality = values["quality"]
        rows.append(
            [
                name,
                values["triangles"],
                int(quality["sectors"]),
                quality["empty sectors"] / max(quality["sectors"], 1.0),
                quality["references"] / values["triangles"],
                int(quality["link nodes"]),
                quality["link nodes"] / max(quality["link nodes unshared"], 1.0),
                quality["mean link depth"],
                quality["bytes"] / values["triangles"],
                " x ".join(map(str, values["bins"])),
            ]
        )
    return Table.of(
        "rayforce-graph",
        "The graphs",
        ["scene", "triangles", "sectors", "empty", "lists per triangle", "link nodes"]
        + ["of those without sharing", "link nodes behind a face", "bytes per triangle", "bins"],
        rows,
        "Bytes: those of sectors, link nodes, lists and bins, without the triangles' vertices. "
        "Link nodes behind a face: the number that a random ray visits from one sector to the "
        "next.",
    )


def _walks(found: dict[str, dict[str, Any]]) -> Table:
    return Table.of(
        "rayforce-walks",
        "From a bin's sector to the ray's start sector",
        ["scene", "rays", "sectors passed, mean", "most", "rays already there"],
        [
            [name, kind, walk["mean"], walk["most"], walk["none"]]
            for name, values in found.items()
            for kind, walk in values["walks"].items()
        ],
        "Not included in the steps below.",
    )


def _structures(found: dict[str, dict[str, Any]]) -> Table:
    rows: list[list[Cell]] = []
    for name, values in found.items():
        reference = values["structures"][REFERENCE]
        for structure, one in values["structures"].items():
            rows.append(
                [
                    name,
                    structure,
                    one["bytes"] / values["triangles"],
                    one["bytes"] / reference["bytes"],
                    one["seconds"],
                    one["seconds"] / reference["seconds"],
                ]
            )
    return Table.of(
        "rayforce-structures",
        "Memory and build time",
        ["scene", "structure", "bytes per triangle", f"bytes / {REFERENCE}'s", "build, s"]
        + [f"build / {REFERENCE}'s"],
        rows,
        "Bytes include a copy of the vertices in test order; the grid has no copy, and reads the "
        "scene's vertices. Build times are the shorter of two builds.",
    )


def _steps(runner: Runner, found: dict[str, dict[str, Any]]) -> Table:
    rows: list[list[Cell]] = [
        [name, kind, structure, one["steps"], one["link_nodes"] or None, one["tests"]]
        for name, values in found.items()
        for kind in RAYS
        for structure, each in values["structures"].items()
        for one in [each["rays"][kind]]
    ]
    size = runner.size(SIZE)
    return Table.of(
        "rayforce-steps",
        f"Work of a ray up to the nearest hit, {size} x {size} rays",
        ["scene", "rays", "structure", "steps", "link nodes", "tests"],
        rows,
        "A step is a sector of the graph, a cell of the grid, or an inner node of the others, in "
        "the BVH with up to eight children.",
    )


def _plot(found: dict[str, dict[str, Any]], kind: str) -> Plot:
    bars = [f"{name}, {part}" for name in found for part in ("steps", "tests")]
    series = []
    for structure in STRUCTURES:
        heights: list[float | None] = []
        for values in found.values():
            one = values["structures"][structure]["rays"][kind]
            heights += [one["steps"] + one["link_nodes"], one["tests"]]
        series.append(Series(structure, bars, heights))
    return Plot(
        f"rayforce-steps-{kind.split()[-1]}",
        f"Rays {kind}: steps, including link nodes, and tests",
        "",
        "per ray",
        series,
        kind="bars",
        log_y=True,
    )

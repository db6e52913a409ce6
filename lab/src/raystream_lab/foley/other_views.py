"""Other views of the scenes: how the comparison of grid and kd-trees depends on the view."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from raystream.scene.camera import Camera
from raystream.scene.scene import Scene
from raystream.structures import Structure, build_structure
from raystream_lab.cameras import orbit
from raystream_lab.foley.scenes import SIZE, foley_tree, mean_counts, trace_counters
from raystream_lab.published import published
from raystream_lab.results import Cell, Table
from raystream_lab.runner import Runner
from raystream_lab.views import View

_SWEEP_SIZE = SIZE // 4

#: Frames per animation.
_FRAMES = 10

_COMPARED = ("grid", "restart", "backtrack")

#: By view: ``grid``, ``restart`` and ``backtrack``, kernel runs per ray; ``hits``, their share.
ViewCosts = dict[str, dict[str, float]]


def kernel_runs(structure: str, each: Mapping[str, float]) -> float:
    """Runs of Foley's kernels per ray, except those that begin and end it.

    Parameters
    ----------
    structure : str
        ``"restart"``, ``"backtrack"`` and ``"stack"`` run Leaf and Continue per leaf.
    each : mapping
        ``steps``, ``leaves`` and ``tests`` per ray.
    """
    is_tree = structure in ("restart", "backtrack", "stack")
    return each["steps"] + each["tests"] + (2 * each["leaves"] if is_tree else 0.0)


def lead(each: Mapping[str, float]) -> float:
    """The grid's cost over that of the better stackless kd-tree."""
    return each["grid"] / min(each["restart"], each["backtrack"])


def other_views(runner: Runner, name: str, view: View) -> ViewCosts:
    """Kernel runs of grid and kd-trees in other views of a scene.

    Parameters
    ----------
    runner : Runner
    name : str
        The scene's, of `scenes.SCENES`.
    view : View
        Frames of its animation are used; without one, cameras around the scene.
    """
    size = min(_SWEEP_SIZE, runner.size(SIZE))
    resolution = published("foley", "scenes").values[name]["resolution"]
    found: ViewCosts = {}
    structures: dict[str, Structure] = {}
    latest: Scene | None = None
    for label, scene, camera in _views(view, runner.quick):

        def measure(scene: Scene = scene, camera: Camera = camera) -> dict[str, float]:
            nonlocal latest
            if scene is not latest:
                tree = foley_tree(scene, runner.progress)
                structures["grid"] = build_structure("grid", scene.triangles, resolution=resolution)
                structures["restart"] = tree.with_traversal("restart")
                structures["backtrack"] = tree
                latest = scene
            return _runs(structures, camera, size)

        found[label] = runner.measure(f"{name}, other views, {label}, {size} x {size}", measure)
    return found


def _views(view: View, quick: bool) -> Iterator[tuple[str, Scene, Camera]]:
    scene = view.scene
    if scene.camera_track is not None:
        first, last = scene.camera_track.times
        for moment in np.linspace(first, last, 2 if quick else _FRAMES).tolist():
            posed = scene.at(moment)
            yield f"t = {moment:.3g}", posed, posed.camera_for(1.0)
        return
    turns = range(0, 360, 180 if quick else 60)
    distances = (1.0,) if quick else (0.5, 0.7, 1.0)
    for label, camera in orbit(view.camera, scene.up, turns, (0.0, 40.0), distances):
        yield label, scene, camera


def _runs(structures: Mapping[str, Structure], camera: Camera, size: int) -> dict[str, float]:
    found = {}
    rays = camera.rays(size, size)
    for structure, one in structures.items():
        counters = trace_counters(one, *rays)
        found[structure] = kernel_runs(structure, mean_counts(counters))
        found["hits"] = counters.total["shadings"] / counters.steps.size
    return found


def other_views_table(found: Mapping[str, ViewCosts]) -> Table:
    """The views of each scene with the best, median and worst rank of the grid."""
    rows: list[list[Cell]] = []
    for name, views in found.items():
        ordered = sorted(views, key=lambda label: lead(views[label]))
        theirs = published("foley", "table 1").values[name]
        old = theirs["grid"] / min(theirs["restart"], theirs["backtrack"])
        ahead = sum(lead(each) < 1.0 for each in views.values())
        for label in (ordered[0], ordered[len(ordered) // 2], ordered[-1]):
            each = views[label]
            rows.append(
                [name, label, each["hits"], *(each[s] for s in _COMPARED), lead(each), old]
                + [f"{ahead} of {len(views)}"]
            )
    return Table.of(
        "foley-other-views",
        "Other views: kernel runs per ray in the best, median and worst view for the grid",
        ["scene", "view", "rays that hit", *_COMPARED, "grid / better tree", "published times"]
        + ["views where the grid is ahead"],
        rows,
        "Kernel runs: steps and tests; for kd-trees also Leaf and Continue per leaf. The bunny is "
        "seen from all sides, animated scenes along their camera's path.",
    )

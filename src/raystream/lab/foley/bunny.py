"""The bunny from elsewhere: whether a grid's lead over a kd-tree depends on the camera."""

from __future__ import annotations

from collections.abc import Mapping

from raystream.lab.cameras import orbit
from raystream.lab.foley.scenes import SIZE, counted, foley_tree
from raystream.lab.laboratory import Laboratory
from raystream.lab.published import published
from raystream.lab.results import Table
from raystream.lab.views import View
from raystream.structures import build_structure

__all__ = ["bunny_cameras", "bunny_table", "kernel_runs", "lead"]

_SWEEP_SIZE = SIZE // 4

#: By camera: ``grid``, ``restart`` and ``backtrack``, kernel runs a ray; ``hits``, their share.
Found = dict[str, dict[str, float]]


def kernel_runs(structure: str, each: Mapping[str, float]) -> float:
    """How often Foley's kernels run on a ray, but for those that begin and end it.

    Parameters
    ----------
    structure : str
        ``"restart"``, ``"backtrack"`` and ``"stack"`` run Leaf and Continue for each leaf.
    each : mapping
        ``steps``, ``leaves`` and ``tests`` of a ray.
    """
    is_tree = structure in ("restart", "backtrack", "stack")
    return each["steps"] + each["tests"] + (2 * each["leaves"] if is_tree else 0.0)


def bunny_cameras(lab: Laboratory, view: View) -> Found:
    """Kernel runs of grid and kd-trees from around a scene; measured once in a run."""
    size = min(_SWEEP_SIZE, lab.size(SIZE))
    turns = range(0, 360, 180 if lab.quick else 60)
    heights, distances = (0.0, 40.0), ((1.0,) if lab.quick else (0.5, 0.7, 1.0))

    def measure() -> Found:
        scene = view.scene
        resolution = published("foley", "scenes").values["bunny"]["resolution"]
        tree = foley_tree(scene, lab.progress)
        structures = {
            "grid": build_structure("grid", scene.triangles, resolution=resolution),
            "restart": tree.with_traversal("restart"),
            "backtrack": tree,
        }
        found: Found = {}
        for name, camera in orbit(view.camera, scene.up, turns, heights, distances):
            rays = camera.rays(size, size)
            found[name] = {}
            for structure, one in structures.items():
                counters = counted(one, *rays)
                total, count = counters.total, counters.steps.size
                sums = {
                    "steps": (total["steps"] + total["backtrack_steps"]) / count,
                    "leaves": total["leaves"] / count,
                    "tests": total["tests"] / count,
                }
                found[name][structure] = kernel_runs(structure, sums)
            found[name]["hits"] = total["shadings"] / count
        return found

    value: Found = lab.measure(f"bunny, other cameras, {size} x {size}", measure)
    return value


def lead(each: Mapping[str, float]) -> float:
    """Kernel runs of the grid over those of the better stackless kd-tree."""
    return each["grid"] / min(each["restart"], each["backtrack"])


def bunny_table(found: Found) -> Table:
    """The cameras in the order of the grid's lead: first, middle and last."""
    ordered = sorted(found, key=lambda camera: lead(found[camera]))
    places = {"least": ordered[0], "median": ordered[len(ordered) // 2], "most": ordered[-1]}
    ahead = sum(lead(each) < 1.0 for each in found.values())
    return Table.of(
        "foley-bunny-cameras",
        "The bunny from other places: kernel runs a ray",
        ["", "camera", "rays that hit", "grid", "restart", "backtrack", "grid / better"],
        [
            [
                place,
                camera,
                found[camera]["hits"],
                *(found[camera][s] for s in ("grid", "restart", "backtrack")),
                lead(found[camera]),
            ]
            for place, camera in places.items()
        ],
        f"Of {len(found)} cameras around it, the grid takes fewer runs with {ahead}.",
    )

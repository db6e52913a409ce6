"""The figures of Table 2, and why ours differ: the same schedule from another camera."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

from raystream.rendering.render import render
from raystream.tracer import Tracer
from raystream_lab.purcell.image_counts import SIZE, grid_tracer
from raystream_lab.purcell.scene_statistics import camera_sweep, other_cameras
from raystream_lab.results import NOT_EXPLAINED, is_near
from raystream_lab.runner import Runner
from raystream_lab.walks import Replay, Walks, record, replay

#: Figures of Table 2: our names, theirs, and titles.
FIGURES: Mapping[str, tuple[str, str]] = MappingProxyType(
    {
        "passes": ("total", "passes"),
        "traverse": ("traversal", "traversal passes"),
        "intersect": ("intersection", "intersection passes"),
        "other": ("other", "other passes"),
        "most_steps": ("most_steps", "most steps of a ray"),
        "most_tests": ("most_tests", "most tests of a ray"),
        "efficiency": ("efficiency", "SIMD efficiency"),
    }
)

#: The grid's kernels that loop.
_TRAVERSE, _INTERSECT = "traverse", "intersect"

#: Width and height of the image whose passes are counted kernel by kernel.
_SMALL = 16


def summary(walks: Walks, found: Replay) -> dict[str, Any]:
    """The figures of Table 2 for a schedule, by our names."""
    passes = found.passes
    search = passes[_TRAVERSE] + passes[_INTERSECT]
    return {
        "passes": len(found),
        "traverse": passes[_TRAVERSE],
        "intersect": passes[_INTERSECT],
        "other": len(found) - search,
        "most_steps": int(walks.counters.steps.max()),
        "most_tests": int(walks.counters.tests.max()),
        "efficiency": found.efficiency,
    }


def pass_reasons(
    runner: Runner, name: str, ours: Mapping[str, Any], theirs: Mapping[str, float]
) -> dict[str, str]:
    """Measured reasons for the figures of Table 2 that are off, by our names.

    Parameters
    ----------
    runner : Runner
    name : str
        A view.
    ours : mapping
        See `schedules.image_schedule`.
    theirs : mapping of str to float
        The view's row of Table 2.
    """
    far = [own for own, (key, _) in FIGURES.items() if not is_near(ours[own], theirs[key])]
    reasons: dict[str, str] = {}
    if "other" in far:
        far.remove("other")
        count = runner.measure(
            f"{name}, passes of a ray caster", lambda: _other_passes(runner, name), shared=True
        )
        reasons["other"] = f"the ray caster's loop has {count}, with a pass for eye rays"
    if not far:
        return reasons
    camera, tried = _nearest_schedule(runner, name, theirs)
    compared = {own: key for own, (key, _) in FIGURES.items() if own != "other"}
    near = sum(is_near(tried[own], theirs[key]) for own, key in compared.items())
    for own in far:
        told = f"camera {camera} gives {_number(tried[own])}"
        if near < len(compared):
            told = f"{NOT_EXPLAINED}: {told}, but {near} of {len(compared)} figures are near"
        reasons[own] = told
    return reasons


def _number(value: float) -> str:
    return f"{value:,}" if isinstance(value, int) else f"{value:.3g}"


def _nearest_schedule(
    runner: Runner, name: str, theirs: Mapping[str, float]
) -> tuple[str, dict[str, Any]]:
    """The camera whose longest walks are nearest to the paper's, and its passes."""
    view, size = runner.view(name), runner.size(SIZE)
    sweep = camera_sweep(runner, view)
    keys = ("most_steps", "most_tests")
    nearest = min(
        sweep, key=lambda camera: max(abs(sweep[camera][one] / theirs[one] - 1.0) for one in keys)
    )

    def measure() -> dict[str, Any]:
        camera = dict(other_cameras(view))[nearest]
        rays = view.seen_from(camera, nearest).rays(size)
        walks = record(grid_tracer(runner, view), *rays, progress=runner.progress)
        return summary(walks, replay(walks))

    found = runner.measure(
        f"{name}, schedule from camera {nearest}, {size} x {size}", measure, shared=True
    )
    return nearest, found


def _other_passes(runner: Runner, name: str) -> int:
    """Passes of a ray caster's loop that neither traverse nor intersect."""
    view = runner.view(name)
    tracer = Tracer.of_structure(
        grid_tracer(runner, view).structure, view.scene, machine="multipass"
    )
    image = render(tracer, "raycast", (_SMALL, _SMALL), camera=view.camera)
    passes = image.figures["passes"]
    return sum(count for kernel, count in passes.items() if kernel not in (_TRAVERSE, _INTERSECT))

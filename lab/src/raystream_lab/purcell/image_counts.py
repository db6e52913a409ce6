"""An image's rays on the grid, and the counts of Purcell's simulators."""

from __future__ import annotations

from typing import Any

import numpy as np

from raystream.machines import RayCounters
from raystream.structures.grid.structure import GridStructure
from raystream.tracer import Tracer
from raystream_lab.cost_model import Counts
from raystream_lab.published import published
from raystream_lab.runner import Runner
from raystream_lab.views import View

#: Width and height of Purcell's images, section 4.1.
SIZE = 1024

#: Divisor of the cells along each axis with ``quick``.
_QUICK_SHARE = 4

ImageCounts = dict[str, float]


def scene_of(view: View) -> str:
    """The paper's scene of a view."""
    return view.name.split()[0]


def grid_options(view: View, quick: bool = False) -> dict[str, Any]:
    """Options of the grid in Purcell 2002, section 4.1, for a view.

    Parameters
    ----------
    view : View
        One of `views.PURCELL_VIEWS`.
    quick : bool
        Fewer cells, for fewer triangles.
    """
    grids = published("purcell", "grids").values
    if view.name == "bunny on a floor":
        return {"resolution": tuple(grids["bunny"])}
    least = grids["min_resolution"][scene_of(view)]
    is_smaller = quick and scene_of(view) != "bunny"
    return {"min_resolution": least // _QUICK_SHARE if is_smaller else least}


def grid_tracer(runner: Runner, view: View, **options: Any) -> Tracer:
    """A tracer with counters [default: on Purcell's grid]."""
    chosen = options or grid_options(view, runner.quick)
    return runner.tracer(view, "grid", counters=True, **chosen)


def grid_of(tracer: Tracer) -> GridStructure:
    """The tracer's grid."""
    structure = tracer.structure
    assert isinstance(structure, GridStructure)
    return structure


def count_image(tracer: Tracer, view: View, size: int) -> ImageCounts:
    """Trace an image, and return means and maxima of its counts.

    Returns
    -------
    dict
        ``v``, ``t``, ``s`` as in Figure 6: means over all rays; ``entering``, the share that hits
        the scene's box; ``most_steps`` and ``most_tests`` of a ray; ``rays``.
    """
    hits = tracer.first_hit(*view.rays(size))
    counters = tracer.counters
    assert isinstance(counters, RayCounters)
    total, count = counters.total, size * size
    return {
        "rays": count,
        "v": total["steps"] / count,
        "t": total["tests"] / count,
        "s": float(np.mean(hits.is_hit)),
        "entering": float(np.mean(counters.steps > 0)),
        "most_steps": int(counters.steps.max()),
        "most_tests": int(counters.tests.max()),
    }


def counts_of(values: ImageCounts, passes: int = 0) -> Counts:
    """Runs of each kernel for a measured image."""
    rays = values["rays"]
    return Counts(
        int(rays),
        round(rays * values.get("entering", 1.0)),
        round(rays * values["v"]),
        round(rays * values["t"]),
        round(rays * values["s"]),
        passes,
    )

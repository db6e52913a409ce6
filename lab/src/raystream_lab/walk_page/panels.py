"""The structures that the page shows, and their drawings."""

from __future__ import annotations

from typing import Any, NamedTuple

from raystream.stepper.maps import GraphMap, GridMap, KdMap, map_of
from raystream.structures.kdtree.layout import LEAF_AXIS
from raystream.tracer import Tracer
from raystream_lab.walk_page.flat_scene import FlatScene

__all__ = ["Panel", "make_panels"]

#: Costs for detailed trees of small plans, with cells of one or two walls.
_TREE = {"traversal_cost": 2.0, "max_depth": 11, "max_leaf_size": 2}
_GRAPH = {"crossing_cost": 2.0, "link_cost": 1.0, "max_depth": 11, "max_leaf_size": 2}

#: Cells of the grid along the longer side of the plan.
_CELLS = 16


class Panel(NamedTuple):
    """A structure and traversal.

    Attributes
    ----------
    key : str
        Its name in links to the page.
    title : str
    tracer : Tracer
        With ``counters=True``.
    chart : GridMap, KdMap or GraphMap
    """

    key: str
    title: str
    tracer: Tracer
    chart: GridMap | KdMap | GraphMap

    def drawing(self) -> dict[str, Any]:
        """The structure's drawing in the plan."""
        chart = self.chart
        boxes = [[_short(n) for n in box[:, :2].ravel().tolist()] for box in chart.boxes]
        sizes = [chart.list_size(number) for number in range(len(boxes))]
        drawn: dict[str, Any] = {"boxes": boxes, "sizes": sizes}
        if isinstance(chart, GridMap):
            drawn["counts"] = list(chart.counts)
        if isinstance(chart, KdMap):
            drawn["axes"] = chart.axes.tolist()
            is_leaf = chart.axes == LEAF_AXIS
            drawn["children"] = [
                0 if leaf else child
                for leaf, child in zip(is_leaf.tolist(), chart.children.tolist(), strict=True)
            ]
            drawn["planes"] = [_short(n) for n in chart.planes.tolist()]
        if isinstance(chart, GraphMap):
            drawn["links"] = [
                sorted({one for face in faces for one in face}) for faces in chart.neighbors
            ]
        return drawn


def make_panels(plan: FlatScene) -> list[Panel]:
    """Build the five panels: the grid, the kd-tree with three traversals, the graph."""
    width, depth = (plan.walls.max(axis=(0, 1)) - plan.walls.min(axis=(0, 1))).tolist()
    side = max(width, depth) / _CELLS
    counts = max(1, round(width / side)), max(1, round(depth / side)), 1
    chosen: list[tuple[str, str, str, dict[str, Any]]] = [
        ("grid", "Grid", "grid", {"resolution": counts}),
        *(
            (f"kdtree-{name}", f"kd-tree, {name}", "kdtree", {"traversal": name, **_TREE})
            for name in ("stack", "restart", "backtrack")
        ),
        ("graph", "Sector graph", "graph", _GRAPH),
    ]
    panels = []
    for key, title, structure, options in chosen:
        tracer = Tracer(plan.scene, structure, counters=True, **options)
        chart = map_of(tracer.structure)
        assert isinstance(chart, GridMap | KdMap | GraphMap)
        panels.append(Panel(key, title, tracer, chart))
    return panels


def _short(number: float) -> float:
    return round(number, 4)

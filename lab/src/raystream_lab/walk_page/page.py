"""A self-contained HTML page that plays walks."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from importlib.resources import files
from os import PathLike
from typing import Any

from raystream.core.atomic_write import atomic_write
from raystream.kernels.tally import COLUMNS
from raystream.machines.records import RayState
from raystream.rendering.color import encode_srgb
from raystream.rendering.false_colors import color_ramp
from raystream.stepper.walk import Spot, walk
from raystream_lab.walk_page.descriptions import sentence, source
from raystream_lab.walk_page.flat_scene import FlatScene, teaching_scene
from raystream_lab.walk_page.heat_maps import fan_cost, place_cost
from raystream_lab.walk_page.panels import Panel, make_panels
from raystream_lab.walk_page.teaching_rays import FAN_ORIGIN, NamedRay, fan, teaching_rays

__all__ = ["page", "write_page"]

#: Styles and scripts of the page, in order.
_STYLES = ("page.css",)
_SCRIPTS = ("plan.js", "sidebar.js", "player.js")

#: Colours of heat maps, which the page interpolates.
_COLORS = 33

#: Directions of the fan's heat map; rows, columns and directions of the map of places.
_FAN = 180
_PLACES = (36, 48)
_PLACE_DIRECTIONS = 32


def page(
    plan: FlatScene | None = None,
    rays: Sequence[NamedRay] | None = None,
    *,
    fan_origin: tuple[float, float] | None = None,
) -> str:
    """Make the page: the plan, five structures, and each ray's walk through each of them.

    Parameters
    ----------
    plan : FlatScene, optional
        [default: `teaching_scene`]
    rays : sequence of NamedRay, optional
        [default: those of the teaching scene, or a fan for another plan]
    fan_origin : tuple of two float, optional
        Origin of the heat map of directions [default: the middle of another plan].

    Returns
    -------
    str
        HTML without external resources. Appending ``#ray=3&step=12`` to its address opens a ray at
        a step; more parameters are ``structure`` (``grid``, ``kdtree-stack``, ``kdtree-restart``,
        ``kdtree-backtrack``, ``graph``), ``heat`` (``fan``, ``places``), ``measure`` (``steps``,
        ``tests``), ``zoom=1`` and ``theme`` (``light``, ``dark``).

    Raises
    ------
    ValueError
        If there is no ray, or one is invalid.
    """
    if plan is None:
        plan, middle = teaching_scene(), FAN_ORIGIN
        rays = teaching_rays() if rays is None else rays
    else:
        x, y = ((plan.walls.min(axis=(0, 1)) + plan.walls.max(axis=(0, 1))) / 2.0).tolist()
        middle = x, y
    origin = middle if fan_origin is None else fan_origin
    rays = fan(origin, 12) if rays is None else rays
    if not rays:
        raise ValueError("rays: expected at least one, got none")
    content = _content(plan, rays, origin)
    return _assemble(content)


def write_page(
    path: str | PathLike[str],
    plan: FlatScene | None = None,
    rays: Sequence[NamedRay] | None = None,
    *,
    fan_origin: tuple[float, float] | None = None,
) -> None:
    """Write the page to a file atomically; see `page`."""
    text = page(plan, rays, fan_origin=fan_origin)
    with atomic_write(path) as file:
        file.write_text(text, encoding="utf-8", newline="\n")


def _assemble(content: dict[str, Any]) -> str:
    """Put styles, scripts and data into the template."""
    parts = {
        "style": "\n".join(map(_part, _STYLES)),
        "data": _json(content),
        "script": "\n".join(map(_part, _SCRIPTS)),
    }
    # Split once per part: inserted text is not searched for the next placeholder.
    rest, made = _part("page.html"), []
    for name, text in parts.items():
        before, rest = rest.split(f"<!-- {name} -->")
        made += [before, text]
    return "".join([*made, rest])


def _part(name: str) -> str:
    return files("raystream_lab.walk_page").joinpath(name).read_text(encoding="utf-8")


def _json(content: dict[str, Any]) -> str:
    """JSON that cannot terminate its HTML element, whatever the names."""
    text = json.dumps(content, separators=(",", ":"), allow_nan=False)
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def _content(
    plan: FlatScene, rays: Sequence[NamedRay], origin: tuple[float, float]
) -> dict[str, Any]:
    panels = make_panels(plan)
    table = _Strings()
    drawings = {panel.key: panel.drawing() for panel in panels}
    for key in ("kdtree-restart", "kdtree-backtrack"):
        drawings[key] = {"same": "kdtree-stack"}
    return {
        "plan": {
            "walls": [[_short(n) for n in wall.ravel().tolist()] for wall in plan.walls],
            "owners": plan.owners.tolist(),
            "names": list(plan.names),
        },
        "panels": [{"key": panel.key, "title": panel.title} for panel in panels],
        "drawings": drawings,
        "states": [state.name.lower().replace("_", " ") for state in RayState],
        "columns": list(COLUMNS),
        "rays": [_ray_content(plan, ray, panels, table) for ray in rays],
        "heat": _heat_content(plan, origin, panels),
        "strings": table.strings,
    }


class _Strings:
    """A table of unique strings."""

    def __init__(self) -> None:
        self.strings: list[str] = []
        self._numbers: dict[str, int] = {}

    def number(self, text: str) -> int:
        if text not in self._numbers:
            self._numbers[text] = len(self.strings)
            self.strings.append(text)
        return self._numbers[text]


def _ray_content(
    plan: FlatScene, ray: NamedRay, panels: Sequence[Panel], table: _Strings
) -> dict[str, Any]:
    return {
        "name": ray.name,
        "note": ray.note,
        "origin": list(ray.origin),
        "direction": list(ray.direction),
        "walks": {panel.key: _walk_content(plan, ray, panel, table) for panel in panels},
    }


def _walk_content(plan: FlatScene, ray: NamedRay, panel: Panel, table: _Strings) -> list[Any]:
    """Each step as an object without default values; player.js explains the keys."""
    walked = walk(panel.tracer, *plan.ray(ray.origin, ray.direction))
    made = []
    for step in walked.steps:
        one: dict[str, Any] = {
            "k": table.number(step.kernel),
            "s": int(step.after),
            "w": table.number(sentence(walked, step, panel.chart)),
            "r": table.number(source(walked, step)),
            "c": [[COLUMNS.index(name), n] for name, n in step.counts.items()],
        }
        if step.at is not None:
            one["a"] = _spot_content(step.at)
        if step.to is not None:
            one["b"] = _spot_content(step.to)
        if step.tested:
            one["x"] = list(step.tested)
        if step.prim_id >= 0:
            one["t"], one["p"] = _short(step.t), step.prim_id
        if step.stack:
            one["q"] = [_spot_content(spot) for spot in step.stack]
        made.append(one)
    return made


def _spot_content(spot: Spot) -> list[Any]:
    return [spot.number, _finite(spot.t_in), _finite(spot.t_out)]


def _heat_content(
    plan: FlatScene, origin: tuple[float, float], panels: Sequence[Panel]
) -> dict[str, Any]:
    fans = {panel.key: fan_cost(panel.tracer, plan, origin, _FAN) for panel in panels}
    places = {
        panel.key: place_cost(panel.tracer, plan, _PLACES, _PLACE_DIRECTIONS) for panel in panels
    }
    low, high = plan.walls.min(axis=(0, 1)).tolist(), plan.walls.max(axis=(0, 1)).tolist()
    measures = ("steps", "tests")
    return {
        "ramp": encode_srgb(color_ramp(_COLORS)).tolist(),
        "fan": {
            "origin": list(origin),
            "t": [_finite(t) for t in fans[panels[0].key].t.tolist()],
            **{
                name: {key: getattr(cost, name).tolist() for key, cost in fans.items()}
                for name in measures
            },
        },
        "places": {
            "box": [_short(n) for n in (*low, *high)],
            "shape": list(_PLACES),
            "directions": _PLACE_DIRECTIONS,
            **{
                name: {
                    key: [round(n, 1) for n in getattr(cost, name).ravel().tolist()]
                    for key, cost in places.items()
                }
                for name in measures
            },
        },
    }


def _short(number: float) -> float:
    return round(number, 4)


def _finite(number: float) -> float | None:
    return _short(number) if math.isfinite(number) else None

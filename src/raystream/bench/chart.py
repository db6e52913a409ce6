"""Charts as SVG: speeds, and raystream's speed relative to the best peer's."""

from __future__ import annotations

import math
import statistics
from xml.sax.saxutils import escape, quoteattr

from raystream.bench.goals import Verdict, judge
from raystream.bench.ray_sets import RAY_SETS
from raystream.bench.results import BenchResult

#: Pixels: a scene's row, a ray set's panel and the gap to the next one, the names' column, a
#: panel's head and axis, and the legend.
_ROW, _PANEL, _GAP, _NAMES, _HEAD, _AXIS, _LEGEND = 22, 132, 14, 128, 52, 34, 46

#: Panels side by side: as wide as a column of text.
_COLUMNS = 4

#: Colours that all kinds of colour vision tell apart (Okabe and Ito 2008): from the median's goal
#: up, from 1 up, below.
_GOOD, _FAIR, _POOR = "#009e73", "#0072b2", "#d55e00"
_INK, _FAINT, _RULE, _OTHER = "#222222", "#767676", "#dddddd", "#a8b0b8"

#: Marks of the axes, where they are within a panel's range.
_TICKS = (0.25, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0)

#: Least width of labels on an axis, as a factor.
_MARGIN = 1.15

#: The chart of speeds, in pixels: a bar's row, and a panel's width, names, longest bar and head.
_BAR, _WIDE, _LABELS, _LONGEST, _TITLE = 21, 318, 126, 124, 38

#: Its contenders, if they took part, and what is said where one has no such query.
_SHOWN = {
    "raystream": "raystream",
    "open3d": "Open3D",
    "embreex": "embreex (trimesh)",
    "embreex-robust": "embreex, robust",
    "mitsuba": "Mitsuba",
    "mitsuba-robust": "Mitsuba, robust",
}
_NO_BAR = "no such query"

#: Its panels.
_SPEEDS = {
    "primary": "Camera rays, first hit",
    "multi": "Camera rays, all hits, sorted",
    "shadow": "Shadow rays, any hit",
    "ao": "Ambient occlusion rays, any hit",
    "bounce": "Diffuse rays, first hit",
    "random": "Random rays, first hit",
}


class _Panel:
    """The place and the logarithmic axis of one ray set."""

    def __init__(self, verdict: Verdict, left: float, top: float) -> None:
        values = [1.0, *verdict.ratios.values()]
        if verdict.goal is not None:
            values += verdict.goal
        self.low, self.high = min(values) / _MARGIN, max(values) * _MARGIN
        self.left, self.top = left, top

    def x(self, ratio: float) -> float:
        """Place of a ratio, in pixels."""
        return self.left + _PANEL * math.log(ratio / self.low) / math.log(self.high / self.low)

    def ticks(self) -> list[float]:
        """Marks in the range, at least those that fit."""
        inside = [tick for tick in _TICKS if self.low <= tick <= self.high]
        return inside if len(inside) <= 4 else [tick for tick in inside if tick in (1, 4, 16)]


def draw_chart(result: BenchResult) -> str:
    """Draw the ratios of all scenes and ray sets, with the goals.

    Parameters
    ----------
    result : BenchResult

    Returns
    -------
    str
        An SVG. A panel for each ray set, a dot for each scene, and the median below.
    """
    verdicts = judge(result)
    scenes = [scene.scene for scene in result.scenes]
    width = _NAMES + _COLUMNS * (_PANEL + _GAP)
    band = _HEAD + _ROW * (len(scenes) + 1) + _AXIS
    height = -(-len(verdicts) // _COLUMNS) * band + _LEGEND
    shapes = []
    for number, verdict in enumerate(verdicts):
        line, column = divmod(number, _COLUMNS)
        top = line * band + _HEAD
        if column == 0:
            shapes += [_name(scene, top, row, "normal") for row, scene in enumerate(scenes)]
            shapes.append(_name("median", top, len(scenes), "bold"))
        panel = _Panel(verdict, _NAMES + column * (_PANEL + _GAP), top)
        shapes += _draw_panel(panel, verdict, scenes)
    shapes += _legend(height - _LEGEND + 14)
    return _svg(width, height, chart_text(result), shapes)


def draw_speeds(result: BenchResult) -> str:
    """Draw the speeds of raystream and its peers as bars, a panel for each set of rays.

    Parameters
    ----------
    result : BenchResult

    Returns
    -------
    str
        An SVG. Bars are geometric means over the scenes in which all contenders of a panel took
        part, in millions of rays per second.
    """
    speeds = {name: _mean_speeds(result, name) for name in _SPEEDS}
    shown = [label for label in _SHOWN if any(label in means for means in speeds.values())]
    panel = _TITLE + _BAR * len(shown) + 12
    width, height = 2 * _WIDE, 3 * panel + 54
    shapes, spoken = [], []
    for number, (name, means) in enumerate(speeds.items()):
        left, top = number % 2 * _WIDE, number // 2 * panel + _TITLE
        shapes.append(_text(left + 14, top - 10, _SPEEDS[name], weight="bold", size=15))
        for row, label in enumerate(shown):
            shapes += _bar(left, top + _BAR * row, label, means)
        listed = ", ".join(f"{_SHOWN[label]} {mean:.1f}" for label, mean in means.items())
        spoken.append(f"{_SPEEDS[name]}: {listed}")
    machine = result.machine
    unit = "Millions of rays per second; longer is faster."
    source = (
        f"Geometric means of {len(result.scenes)} scenes. {machine['cpu']}, {machine['threads']} "
        f"cores, {result.date}."
    )
    for lines, note in enumerate((source, unit)):
        shapes.append(_text(14, height - 14 - 18 * lines, note, color=_FAINT, size=13))
    return _svg(width, height, f"{unit} {source} {'; '.join(spoken)}", shapes)


def _mean_speeds(result: BenchResult, name: str) -> dict[str, float]:
    """Geometric means of the contenders' speeds, over the scenes that all of them traced."""
    found = [
        {label: speed for label in _SHOWN if (speed := rays.speed(label)) is not None}
        for scene in result.scenes
        for rays in scene.sets
        if rays.name == name
    ]
    labels = [label for label in _SHOWN if any(label in row for row in found)]
    rows = [row for row in found if len(row) == len(labels)]
    if not rows:
        return {}
    return {label: statistics.geometric_mean(row[label] for row in rows) for label in labels}


def _bar(left: float, top: float, label: str, means: dict[str, float]) -> list[str]:
    """A contender's name, bar and number."""
    is_own = label == "raystream"
    weight, y = ("bold" if is_own else "normal"), top + _BAR / 2 + 5
    x = left + 14 + _LABELS
    name = _text(x - 8, y, _SHOWN[label], anchor="end", weight=weight, size=14)
    if label not in means:
        return [name, _text(x, y, _NO_BAR, color=_FAINT, size=14)]
    length = _LONGEST * means[label] / max(means.values())
    color = _FAIR if is_own else _OTHER
    bar = (
        f'<rect x="{x}" y="{top + 2}" width="{length:.1f}" height="{_BAR - 4}" rx="2" '
        f'fill="{color}"/>'
    )
    number = f"{means[label]:.1f}"
    return [name, bar, _text(x + length + 6, y, number, weight=weight, size=14)]


def _svg(width: float, height: float, label: str, shapes: list[str]) -> str:
    """An image of its own background, which is readable on a dark page too."""
    return "\n".join(
        [
            '<svg xmlns="http://www.w3.org/2000/svg" font-family="sans-serif"',
            f' viewBox="0 0 {width} {height}" width="{width}" height="{height}"',
            f' role="img" aria-label={quoteattr(label)}>',
            f'<rect width="{width}" height="{height}" fill="#ffffff"/>',
            *shapes,
            "</svg>",
        ]
    )


def chart_text(result: BenchResult) -> str:
    """Say what the chart shows, for those who do not see it."""
    medians = "; ".join(f"{RAY_SETS[v.name].title} {v.median:.2f}" for v in judge(result))
    return f"raystream's speed relative to the best peer's, medians of the scenes: {medians}"


def _draw_panel(panel: _Panel, verdict: Verdict, scenes: list[str]) -> list[str]:
    middle, top = panel.left + _PANEL / 2, panel.top
    bottom = top + _ROW * (len(scenes) + 1)
    shapes = [_text(middle, top - 36, RAY_SETS[verdict.name].title, anchor="middle", weight="bold")]
    for tick in panel.ticks():
        x = panel.x(tick)
        color = _INK if tick == 1.0 else _RULE
        shapes.append(_line(x, top, x, bottom, color))
        shapes.append(_text(x, bottom + 15, f"{tick:g}", anchor="middle", color=_FAINT))
    if verdict.goal is not None:
        median, least = verdict.goal
        goals = f"goal {median:g}, least {least:g}"
        shapes.append(_text(middle, top - 20, goals, anchor="middle", color=_FAINT, size=11))
        for goal, dashes in ((median, ""), (least, "3 3")):
            x = panel.x(goal)
            shapes.append(_line(x, top - 8, x, bottom, _GOOD, dashes, wide=1.6))
    shapes.append(_line(panel.left, bottom - _ROW, panel.left + _PANEL, bottom - _ROW, _FAINT))
    for row, scene in enumerate(scenes):
        if scene in verdict.ratios:
            shapes += _dot(panel, verdict, verdict.ratios[scene], row, "normal")
    shapes += _dot(panel, verdict, verdict.median, len(scenes), "bold")
    return shapes


def _dot(panel: _Panel, verdict: Verdict, ratio: float, row: int, weight: str) -> list[str]:
    """A ratio as a dot and a number, beside it where there is room."""
    x, y = panel.x(ratio), panel.top + _ROW * (row + 0.5)
    color = _POOR if ratio < 1.0 else _FAIR
    if verdict.goal is not None and ratio >= verdict.goal.median:
        color = _GOOD
    is_left = x > panel.left + 0.62 * _PANEL
    place, anchor = (x - 8, "end") if is_left else (x + 8, "start")
    text = f"{ratio:.2f}" if ratio < 10.0 else f"{ratio:.1f}"
    dot = f'<circle cx="{x:.1f}" cy="{y:.1f}" r="4.5" fill="{color}"/>'
    halo = 'stroke="#ffffff" stroke-width="4" paint-order="stroke"'
    number = _text(place, y + 4, text, anchor=anchor, weight=weight, size=11, more=halo)
    return [dot, number]


def _legend(top: float) -> list[str]:
    shapes, x, y = [], 8.0, top
    for color, text in (
        (_GOOD, "at the goal of the median or above"),
        (_FAIR, "as fast as the best peer or faster"),
        (_POOR, "slower"),
    ):
        shapes.append(f'<circle cx="{x}" cy="{y - 4}" r="4.5" fill="{color}"/>')
        shapes.append(_text(x + 10, y, text))
        x += 34 + 6.6 * len(text)
    x, y = 8.0, top + 22.0
    for dashes, text in (("", "goal of the median"), ("3 3", "least goal")):
        shapes.append(_line(x, y - 12, x, y + 2, _GOOD, dashes, wide=1.6))
        shapes.append(_text(x + 8, y, text))
        x += 34 + 6.6 * len(text)
    return shapes


def _name(text: str, top: float, row: int, weight: str) -> str:
    return _text(_NAMES - 12, top + _ROW * (row + 0.5) + 4, text, anchor="end", weight=weight)


def _text(
    x: float,
    y: float,
    text: str,
    *,
    anchor: str = "start",
    weight: str = "normal",
    color: str = _INK,
    size: int = 12,
    more: str = "",
) -> str:
    return (
        f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}" font-weight="{weight}" '
        f'font-size="{size}" fill="{color}" {more}>{escape(text)}</text>'
    )


def _line(
    x1: float, y1: float, x2: float, y2: float, color: str, dashes: str = "", wide: float = 1.0
) -> str:
    pattern = f' stroke-dasharray="{dashes}"' if dashes else ""
    return (
        f'<line x1="{x1:.1f}" y1="{y1:.1f}" x2="{x2:.1f}" y2="{y2:.1f}" stroke="{color}" '
        f'stroke-width="{wide}"{pattern}/>'
    )

"""Chart: raystream's speed relative to the best peer's, as an SVG."""

from __future__ import annotations

import math
from xml.sax.saxutils import escape, quoteattr

from raystream.bench.goals import Verdict, judge
from raystream.bench.ray_sets import RAY_SETS
from raystream.bench.results import BenchResult

__all__ = ["chart_text", "draw_chart"]

#: Pixels: a scene's row, a ray set's panel and the gap to the next one, the names' column, a
#: panel's head and axis, and the legend.
_ROW, _PANEL, _GAP, _NAMES, _HEAD, _AXIS, _LEGEND = 22, 132, 14, 128, 52, 34, 46

#: Panels side by side: as wide as a column of text.
_COLUMNS = 4

#: Colours that all kinds of colour vision tell apart (Okabe and Ito 2008): from the median's goal
#: up, from 1 up, below.
_GOOD, _FAIR, _POOR = "#009e73", "#0072b2", "#d55e00"
_INK, _FAINT, _RULE = "#222222", "#767676", "#dddddd"

#: Marks of the axes, where they are within a panel's range.
_TICKS = (0.25, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0)

#: Least width of labels on an axis, as a factor.
_MARGIN = 1.15


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
    label = quoteattr(chart_text(result))
    return "\n".join(
        [
            '<svg xmlns="http://www.w3.org/2000/svg" font-family="sans-serif"',
            f' viewBox="0 0 {width} {height}" width="{width}" height="{height}"',
            f' role="img" aria-label={label}>',
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

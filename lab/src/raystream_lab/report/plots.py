"""Plots of the report, drawn with matplotlib."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from raystream.core.atomic_write import atomic_write
from raystream_lab.results import Plot

#: A palette for all kinds of colour vision (Okabe and Ito 2008).
_COLORS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#000000", "#8a8a8a")

_MARKERS = "os^Dv<>P"

_INCHES = (6.4, 3.8)
_DPI = 110

#: Lines of more points than this have no markers.
_MANY = 30


def draw(plot: Plot, path: Path) -> None:
    """Draw a plot as PNG.

    Parameters
    ----------
    plot : Plot
    path : Path

    Raises
    ------
    OSError
        If the file cannot be written.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=_INCHES, dpi=_DPI, layout="constrained")
    canvas = FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    if plot.kind == "lines":
        _lines(axes, plot)
    else:
        _bars(axes, plot)
    for number, (label, height) in enumerate(plot.marks.items()):
        axes.axhline(
            height, color="#666666", linewidth=1.0, linestyle=("--", ":", "-.")[number % 3]
        )
        axes.annotate(
            label,
            (1.0, height),
            xycoords=("axes fraction", "data"),
            xytext=(-4, 3),
            textcoords="offset points",
            ha="right",
            fontsize=8,
            color="#444444",
            bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.7, "pad": 1.0},
        )
    axes.set_title(plot.title, fontsize=10)
    axes.set_xlabel(plot.x_label, fontsize=9)
    axes.set_ylabel(plot.y_label, fontsize=9)
    axes.tick_params(labelsize=8)
    if plot.log_x:
        axes.set_xscale("log")
        _plain_numbers(axes.xaxis)
    if plot.log_y:
        axes.set_yscale("log")
        _plain_numbers(axes.yaxis)
    else:
        axes.set_ylim(bottom=0.0)
    axes.grid(axis="y" if plot.kind != "lines" else "both", color="#dddddd", linewidth=0.6)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
    if len(plot.series) > 1:
        beside = len(plot.series) > 5 or plot.kind != "lines"
        where: dict[str, Any] = (
            {"loc": "upper left", "bbox_to_anchor": (1.0, 1.0)} if beside else {"loc": "best"}
        )
        axes.legend(fontsize=8, frameon=False, **where)
    canvas.draw()
    # 64 colours take a quarter of the bytes.
    drawn = Image.fromarray(np.asarray(canvas.buffer_rgba())[..., :3])
    with atomic_write(path) as part:
        drawn.quantize(64).save(part, format="PNG", optimize=True)


def _plain_numbers(axis: Any) -> None:
    """Label a logarithmic axis with plain numbers, only some of them if it spans decades."""
    from matplotlib.ticker import LogFormatter

    class Plain(LogFormatter):
        def _num_to_string(self, x: float, vmin: float, vmax: float) -> str:  # noqa: ARG002
            return f"{x:g}"

    axis.set_major_formatter(Plain())
    axis.set_minor_formatter(Plain(minor_thresholds=(1.5, 0.5)))


def _lines(axes: Any, plot: Plot) -> None:
    for number, one in enumerate(plot.series):
        kept = [(x, y) for x, y in zip(one.x, one.y, strict=True) if y is not None]
        axes.plot(
            [x for x, _ in kept],
            [y for _, y in kept],
            label=one.label,
            color=_COLORS[number % len(_COLORS)],
            linestyle="-" if number < len(_COLORS) else "--",
            marker=_MARKERS[number % len(_MARKERS)] if len(kept) <= _MANY else None,
            markersize=4,
            linewidth=1.5,
        )


def _bars(axes: Any, plot: Plot) -> None:
    """Draw bars side by side or stacked, with the names of the first series."""
    names = plot.series[0].x
    places = range(len(names))
    is_stacked = plot.kind == "stacked"
    width = 0.8 if is_stacked else 0.8 / len(plot.series)
    base = [0.0] * len(names)
    for number, one in enumerate(plot.series):
        heights = [0.0 if y is None else y for y in one.y]
        shift = 0.0 if is_stacked else (number - (len(plot.series) - 1) / 2) * width
        axes.bar(
            [place + shift for place in places],
            heights,
            width,
            bottom=base if is_stacked else None,
            label=one.label,
            color=_COLORS[number % len(_COLORS)],
        )
        if is_stacked:
            base = [low + height for low, height in zip(base, heights, strict=True)]
    axes.set_xticks(list(places), [str(name) for name in names])
    if sum(len(str(name)) for name in names) > 60:
        axes.tick_params(axis="x", rotation=30)
        for label in axes.get_xticklabels():
            label.set_horizontalalignment("right")

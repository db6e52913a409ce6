"""Scale bars: a colour ramp with ticks, labels and a title, drawn below an image."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from raystream.rendering.color import decode_srgb

if TYPE_CHECKING:
    from PIL.ImageFont import FreeTypeFont, ImageFont

#: Greys of the background, of text and ticks, and of the frame around the ramp (sRGB).
_BACKGROUND, _TEXT, _FRAME = 24, 232, 128

#: Maximum number of intervals between ticks.
_MAX_STEPS = 10


@dataclass(frozen=True)
class _Tick:
    """A tick at a column of the image, with the columns of its label."""

    at: int
    label: str
    begin: float
    end: float


def draw_scale(
    width: int, top: float, is_cut: bool, title: str, ramp: NDArray[np.float32]
) -> NDArray[np.float32]:
    """Draw a scale bar from 0 to `top`.

    Parameters
    ----------
    width : int
        In pixels. It determines the font size; labels that do not fit are left out.
    top : float
        The value at the end of the ramp.
    is_cut : bool
        Whether larger values exist, which are clamped.
    title : str
    ramp : ndarray of shape (L, 3), float32
        Linear RGB.

    Returns
    -------
    ndarray of shape (S, width, 3), float32
        Linear RGB; S depends on the arguments.
    """
    from PIL import Image, ImageDraw, ImageFont

    font_size = max(13, round(width / 72))
    font = ImageFont.load_default(font_size)
    line_height = sum(font.getmetrics()) if hasattr(font, "getmetrics") else font_size
    margin = min(font_size // 2, width // 16)
    gap = font_size // 4
    left, right = margin, max(width - margin, margin + 1)
    if is_cut:
        title = ", ".join(filter(None, [title, f"drawn up to {_number(top)}"]))
    lines = _wrap(title, right - left, font)
    bar_begin = gap + line_height * len(lines) + gap
    bar_end = bar_begin + font_size
    ticks = _place_ticks(top, is_cut, (left, right), width, font)
    labels_begin = bar_end + 2 * gap
    height = labels_begin + line_height * bool(ticks) + gap

    canvas = Image.new("L", (width, height), _BACKGROUND)
    draw = ImageDraw.Draw(canvas)
    for i, line in enumerate(lines):
        draw.text((left, gap + i * line_height), line, _TEXT, font)
    draw.rectangle((left - 1, bar_begin - 1, right, bar_end), _FRAME)
    for tick in ticks:
        draw.line((tick.at, bar_end + 1, tick.at, bar_end + gap), _TEXT)
        draw.text((tick.begin, labels_begin), tick.label, _TEXT, font)
    scale = np.repeat(decode_srgb(np.asarray(canvas))[..., None], 3, axis=2)
    levels = np.linspace(0, len(ramp) - 1, right - left)
    scale[bar_begin:bar_end, left:right] = ramp[np.rint(levels).astype(int)]
    return scale


def round_ticks(top: float, step_count: int) -> list[float]:
    """Multiples of a round number (1, 2 or 5 times a power of ten) from 0 to `top`.

    Parameters
    ----------
    top : float
        Above 0.
    step_count : int
        Maximum number of intervals; at least 1.

    Returns
    -------
    list of float
        The finest scale within that maximum.
    """
    exponent = math.floor(math.log10(top / step_count)) - 1
    sizes = ((round_number, power) for power in range(exponent, 400) for round_number in (1, 2, 5))
    for round_number, power in sizes:
        step = float(f"{round_number}e{power}")
        count = math.floor(top / step * (1.0 + 1e-9))  # includes the top if it is a multiple
        if count <= step_count:
            return [float(f"{i * round_number}e{power}") for i in range(count + 1)]
    return [0.0]


def _place_ticks(
    top: float,
    is_cut: bool,
    bar: tuple[int, int],
    width: int,
    font: FreeTypeFont | ImageFont,
) -> list[_Tick]:
    """As many ticks as there is room for their labels."""
    space = font.getlength("0")
    last = bar[1] - 1 - bar[0]

    def tick(value: float, label: str) -> _Tick:
        at = bar[0] + round(min(value / top, 1.0) * last)
        length = font.getlength(label)
        begin = min(max(at - length / 2, 1), width - 1 - length)
        return _Tick(at, label, begin, begin + length)

    for step_count in range(_MAX_STEPS, 0, -1):
        ticks = [tick(value, _number(value)) for value in round_ticks(top, step_count)]
        if is_cut:  # the label at the end replaces those near it
            end = tick(top, f"{_number(top)}+")
            ticks = [one for one in ticks if one.end + space <= end.begin] + [end]
        if all(one.end + space <= other.begin for one, other in pairwise(ticks)):
            break
    else:
        ticks = ticks[-1:] if is_cut else ticks[:1]
    return [one for one in ticks if one.begin >= 0]


def _wrap(text: str, width: int, font: FreeTypeFont | ImageFont) -> list[str]:
    """Break text into lines; no lines if a word is wider than one."""
    lines: list[str] = []
    for word in text.split():
        if font.getlength(word) > width:
            return []
        longer = f"{lines[-1]} {word}" if lines else word
        if lines and font.getlength(longer) <= width:
            lines[-1] = longer
        else:
            lines.append(word)
    return lines


def _number(value: float) -> str:
    return f"{value:,.6g}" if value < 1e6 else f"{value:,.12g}"

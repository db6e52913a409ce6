"""Contrast of the viewer's page: text and marks are readable in both schemes (WCAG 2.2, AA)."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

import raystream as rs

THEME = Path(rs.__file__).parent / "web" / "shared" / "theme.css"

#: Text on a ground, and marks beside one: 4.5 and 3 to 1.
TEXT, MARK = 4.5, 3.0

PAIRS = [
    ("ink", "paper", TEXT),
    ("ink", "card", TEXT),
    ("ink", "faint", TEXT),
    ("soft", "paper", TEXT),
    ("soft", "card", TEXT),
    ("edge", "card", TEXT),  # a button under the pointer
    ("edge", "paper", TEXT),
    ("warm", "card", TEXT),
    ("on-chosen", "chosen", TEXT),
    ("on-hud", "hud", TEXT),
    ("soft-hud", "hud", TEXT),
    ("mark", "hud", TEXT),
    ("field-line", "card", MARK),
    ("field-line", "paper", MARK),
    ("error", "card", MARK),
]

#: Part of the ground below that is seen through the figures over the image.
CLEAR = 1 - 0.84


def colors(scheme: str) -> dict[str, tuple[int, ...]]:
    """The theme's colours in a scheme, by name."""
    found = {}
    for name, value in re.findall(r"--([\w-]+): ([^;]+);", THEME.read_text()):
        codes = re.findall(r"#([0-9a-f]{6})", value)
        if codes:
            code = codes[-1 if scheme == "dark" else 0]
            found[name] = tuple(bytes.fromhex(code))
    return found


def luminance(color) -> float:
    def linear(channel: float) -> float:
        share = channel / 255
        return share / 12.92 if share <= 0.04045 else ((share + 0.055) / 1.055) ** 2.4

    red, green, blue = map(linear, color)
    return 0.2126 * red + 0.7152 * green + 0.0722 * blue


def contrast(a, b) -> float:
    light, dark = sorted((luminance(a), luminance(b)), reverse=True)
    return (light + 0.05) / (dark + 0.05)


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_everything_can_be_read(scheme):
    known = colors(scheme)
    poor = {
        f"{front} on {back}": round(contrast(known[front], known[back]), 2)
        for front, back, least in PAIRS
        if contrast(known[front], known[back]) < least
    }
    assert not poor


def test_figures_can_be_read_over_any_picture():
    known = colors("light")
    over_white = [(1 - CLEAR) * channel + CLEAR * 255 for channel in known["hud"]]
    for front in ("on-hud", "soft-hud", "mark"):
        assert contrast(known[front], over_white) >= TEXT, front


def test_black_and_white_are_farthest_apart():
    assert contrast((0, 0, 0), (255, 255, 255)) == pytest.approx(21)

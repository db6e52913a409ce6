"""Draws graphics_passes.svg, beside it: a pass of the multipass machine on graphics pipelines."""

from __future__ import annotations

from pathlib import Path
from xml.sax.saxutils import escape

WIDTH, HEIGHT = 960, 470
MEMORY, STEP, COMPUTE = "#dbe9f6", "#e4f2dc", "#fbe8cf"


def box(x, y, width, height, fill, title, *lines):
    """A rectangle with a title and lines of text."""
    frame = f'x="{x}" y="{y}" width="{width}" height="{height}" rx="6"'
    parts = [
        f'<rect {frame} fill="{fill}" stroke="#444"/>',
        f'<text x="{x + 12}" y="{y + 23}" font-weight="bold">{escape(title)}</text>',
    ]
    parts += [
        f'<text x="{x + 12}" y="{y + 44 + 18 * row}" font-size="13">{escape(line)}</text>'
        for row, line in enumerate(lines)
    ]
    return "\n".join(parts)


def arrow(*points, label="", at=(0, 0)):
    """A line through points, with a head at the last, and its label."""
    path = " ".join(f"{x},{y}" for x, y in points)
    text = f'<text x="{at[0]}" y="{at[1]}" font-size="13" fill="#224">{escape(label)}</text>'
    return (
        f'<polyline points="{path}" fill="none" stroke="#224" stroke-width="1.6" '
        f'marker-end="url(#head)"/>\n{text}'
    )


def picture() -> str:
    words = "until no ray is active: the host looks after 8 passes, then after 16, 32, 64, 64 ..."
    note = f'<text x="250" y="440" font-size="14">{words}</text>'
    shapes = [
        box(
            20,
            20,
            205,
            105,
            MEMORY,
            "Gather arrays",
            "storage buffers:",
            "cells, nodes, lists,",
            "corners of triangles",
        ),
        box(
            255,
            20,
            205,
            105,
            MEMORY,
            "Streams",
            "textures, a texel a ray:",
            "origins, directions,",
            "state, found, place, span",
        ),
        box(
            490,
            20,
            205,
            105,
            MEMORY,
            "Scratch",
            "textures: state, found,",
            "place, span as the",
            "kernel leaves them",
        ),
        box(
            725,
            20,
            215,
            105,
            MEMORY,
            "Stencil",
            "a byte a ray: its state,",
            "which is the kernel",
            "that it waits for",
        ),
        box(
            20,
            235,
            205,
            130,
            COMPUTE,
            "0  Schedule (compute)",
            "counts rays by state,",
            "chooses one kernel, and",
            "writes the arguments of",
            "indirect draws: 1 or 0",
        ),
        box(
            255,
            235,
            205,
            130,
            STEP,
            "1  Kernel (draw)",
            "one triangle over the screen;",
            "where stencil = its state",
            "the fragment program runs,",
            "elsewhere nothing does",
        ),
        box(
            490,
            235,
            205,
            130,
            STEP,
            "2  Commit (draw)",
            "the same stencil test;",
            "copies what was written,",
            "as no pass may write",
            "what it reads",
        ),
        box(
            725,
            235,
            215,
            130,
            STEP,
            "3  Classify (draws)",
            "one for each next state:",
            "discards the other rays;",
            "the stencil operation moves",
            "those that are left",
        ),
        arrow((122, 125), (122, 150), (300, 150), (300, 235), label="reads", at=(130, 168)),
        arrow((345, 125), (345, 235), label="reads", at=(352, 190)),
        arrow((430, 235), (430, 165), (530, 165), (530, 125), label="writes", at=(440, 158)),
        arrow((570, 125), (570, 235), label="reads", at=(577, 190)),
        arrow((520, 235), (520, 205), (400, 205), (400, 125), label="writes", at=(448, 222)),
        arrow((660, 125), (660, 180), (765, 180), (765, 235), label="reads", at=(668, 174)),
        arrow((850, 235), (850, 125), label="writes", at=(857, 190)),
        arrow((225, 300), (255, 300)),
        arrow((460, 300), (490, 300)),
        arrow((695, 300), (725, 300)),
        arrow((832, 365), (832, 415), (122, 415), (122, 365)),
        note,
    ]
    head = (
        '<marker id="head" viewBox="0 0 10 10" refX="9" refY="5" markerWidth="7" markerHeight="7" '
        'orient="auto"><path d="M0,0 L10,5 L0,10 z" fill="#224"/></marker>'
    )
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT}" '
        f'font-family="sans-serif" font-size="15">\n<defs>{head}</defs>\n'
        f'<rect width="{WIDTH}" height="{HEIGHT}" fill="white"/>\n'
        + "\n".join(shapes)
        + "\n</svg>\n"
    )


if __name__ == "__main__":
    Path(__file__).with_suffix(".svg").write_text(picture(), encoding="utf-8")

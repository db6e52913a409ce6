"""Draws ray_loop.svg, beside it: the rays between the kernels of a renderer's loop, as counted.

Renders one sample of the built-in scene "spheres" with mirrors, glass and shadows, on the multipass
machine with a grid, and counts after each pass which rays went from which kernel to which.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np

import raystream as rs
from raystream.machines.records import RayState
from raystream.rendering.contexts import make_context
from raystream.rendering.ray_loops import MultipassBands
from raystream.rendering.render import RENDERERS
from raystream.rendering.sample_bands import trace_sample
from raystream.rendering.sampling.sampler import Sampler

SIZE = 256
WIDTH, HEIGHT = 960, 330
FILL, INK = "#e4f2dc", "#224"

#: Left and upper edge of each box.
PLACES = {
    "eye rays": (20, 120),
    "set up": (200, 120),
    "traverse": (400, 40),
    "intersect": (400, 200),
    "shade": (620, 120),
    "image": (820, 120),
}
BOX = 120, 64


def count_rays():
    """Rays by (kernel, next kernel), and passes by kernel."""
    scene = rs.load("spheres")
    tracer = rs.Tracer(scene, "grid", machine="multipass")
    renderer = RENDERERS["whitted"]
    options = renderer.check(renderer.complete({}))
    camera = scene.camera_for(1.0)
    context = make_context(tracer, camera, (SIZE, SIZE), Sampler.of("sobol", 0, 1), options)
    names = {
        RayState.STARTING: "set up",
        RayState.TRAVERSING: "traverse",
        RayState.INTERSECTING: "intersect",
        RayState.SHADING: "shade",
        RayState.DONE: "image",
        RayState.NO_ROOM: "shade",
    }
    rays: Counter[tuple[str, str]] = Counter()
    before: list[np.ndarray] = []

    def observe(snapshot):
        states = snapshot.streams["state"].copy()
        if snapshot.kernel is None:
            if not before:
                rays["eye rays", "set up"] += int(np.count_nonzero(states == RayState.STARTING))
        else:
            ran = before[-1] == snapshot.kernel.state
            for state, count in zip(*np.unique(states[ran], return_counts=True), strict=True):
                if state != RayState.NO_ROOM:
                    rays[snapshot.kernel.name, names[RayState(state)]] += int(count)
        before[:] = [states]

    bands = MultipassBands(context, tracer.loop_machine.observed_by(observe))
    trace_sample(renderer, replace(context, bands=bands), 0)
    return rays, bands.figures()["passes"]


def box(name, passes):
    """A kernel with its number of passes."""
    x, y = PLACES[name]
    note = f"{passes[name]:,} pass{'es' * (passes[name] > 1)}" if name in passes else "pixels"
    return (
        f'<rect x="{x}" y="{y}" width="{BOX[0]}" height="{BOX[1]}" rx="6" fill="{FILL}" '
        f'stroke="#444"/>\n<text x="{x + 12}" y="{y + 27}" font-weight="bold">{name}</text>\n'
        f'<text x="{x + 12}" y="{y + 48}" font-size="13">{note}</text>'
    )


def arrow(points, label, at):
    """A line through points, with a head at the last, and its label."""
    path = " ".join(f"{x},{y}" for x, y in points)
    return (
        f'<polyline points="{path}" fill="none" stroke="{INK}" stroke-width="1.6" '
        f'marker-end="url(#head)"/>\n'
        f'<text x="{at[0]}" y="{at[1]}" font-size="13" fill="{INK}">{label}</text>'
    )


#: Lines of the arrows, and the places of their labels.
ARROWS = {
    ("eye rays", "set up"): ([(140, 152), (196, 152)], (142, 142)),
    ("set up", "traverse"): ([(320, 140), (396, 90)], (305, 100)),
    ("set up", "shade"): ([(320, 152), (616, 152)], (540, 146)),
    ("traverse", "traverse"): ([(430, 40), (430, 16), (490, 16), (490, 36)], (500, 20)),
    ("traverse", "intersect"): ([(430, 104), (430, 196)], (362, 180)),
    ("intersect", "traverse"): ([(490, 200), (490, 108)], (496, 180)),
    ("intersect", "intersect"): ([(430, 264), (430, 286), (490, 286), (490, 268)], (500, 288)),
    ("traverse", "shade"): ([(520, 72), (660, 116)], (600, 82)),
    ("intersect", "shade"): ([(520, 232), (660, 188)], (600, 230)),
    ("shade", "set up"): ([(680, 184), (680, 312), (260, 312), (260, 188)], (270, 304)),
    ("shade", "image"): ([(740, 152), (816, 152)], (746, 142)),
}


def picture() -> str:
    rays, passes = count_rays()
    unknown = set(rays) - set(ARROWS)
    assert not unknown, unknown
    shapes = [box(name, passes) for name in PLACES]
    for pair, (points, at) in ARROWS.items():
        if rays[pair]:
            note = " new rays" if pair == ("shade", "set up") else ""
            shapes.append(arrow(points, f"{rays[pair]:,}{note}", at))
    head = (
        '<defs><marker id="head" markerWidth="9" markerHeight="8" refX="8" refY="4" orient="auto">'
        f'<path d="M0,0 L9,4 L0,8 z" fill="{INK}"/></marker></defs>'
    )
    body = "\n".join(shapes)
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{WIDTH}" height="{HEIGHT}" '
        f'viewBox="0 0 {WIDTH} {HEIGHT}" font-family="sans-serif" font-size="16">\n'
        f'<rect width="100%" height="100%" fill="white"/>\n{head}\n{body}\n</svg>\n'
    )


if __name__ == "__main__":
    Path(__file__).with_suffix(".svg").write_text(picture(), encoding="utf-8")

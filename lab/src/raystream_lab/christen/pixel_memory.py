"""Memory of a pixel against the number of iterations (Christen 2005, section 5.2.1).

His renderer keeps a colour and a weight, the iteration buffer, in 128 bits. Ours runs whole images
as one loop of the multipass machine, whose records also hold the pixel's rays.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np

from raystream.rendering.contexts import make_context
from raystream.rendering.integrator import Integrator
from raystream.rendering.ray_loops import MAX_BYTES
from raystream.rendering.render import RENDERERS
from raystream.rendering.sampling.sampler import Sampler
from raystream.rendering.shading.streams import Paths
from raystream.tracer import Tracer
from raystream_lab.christen.scenes import SCENES, christen_scene
from raystream_lab.published import published
from raystream_lab.results import Cell, Claim, Result, Table, comparison, is_near
from raystream_lab.runner import Runner

#: Numbers of iterations.
_ITERATIONS = (1, 2, 3, 4, 6, 8)

#: Components of a pixel's colour, float32.
_COLOR_BITS = 3 * 32


def pixel_memory(runner: Runner) -> Result:
    """Bytes of a pixel's records by the number of iterations, and bits of its result."""
    found: dict[str, dict[str, int]] = {
        letter: runner.measure(letter, partial(_measured, letter)) for letter in SCENES
    }
    source = published("christen", "memory")
    bits, theirs = result_bits(), source.values["bits_per_pixel"]
    same = {
        f"{letter}, {count} iterations": own == each[str(_ITERATIONS[0])]
        for letter, each in found.items()
        for count, own in each.items()
        if count != str(_ITERATIONS[0])
    }
    rows: list[list[Cell]] = [
        [letter, int(count), own] for letter, each in found.items() for count, own in each.items()
    ]
    return Result(
        tables=[
            comparison(
                "christen-pixel",
                f"Colour and weight of a pixel: {source.source}",
                [("bits", theirs, bits, "ours has a weight per colour component, his only one")],
            ),
            Table.of(
                "christen-pixel-memory",
                "Memory of a pixel in a loop of the multipass machine",
                ["scene", "iterations", "bytes per pixel"],
                rows,
                "All records are included: the ray, its place in the grid, its hit, the paths of "
                "two bounces, and a shadow ray to each light, although Christen's renderer has no "
                "shadow rays.",
            ),
        ],
        claims=[
            Claim.judged(
                "The memory of a pixel does not depend on the number of iterations",
                source.source,
                same,
                "; ".join(
                    f"{letter}: {', '.join(map(str, dict.fromkeys(each.values())))} bytes"
                    for letter, each in found.items()
                ),
            ),
            Claim.judged(
                f"{theirs} bits per pixel hold the result of all iterations, within a quarter",
                source.source,
                {"colour and weight": is_near(bits, theirs)},
                f"{bits} bits: three floats of colour and three of weight",
            ),
        ],
    )


def _measured(letter: str) -> dict[str, int]:
    tracer = Tracer(christen_scene(letter), "grid", machine="multipass", resolution=5)
    return {str(count): loop_bytes(tracer, count) for count in _ITERATIONS}


def loop_bytes(tracer: Tracer, iterations: int) -> int:
    """Bytes of a pixel of the renderer ``whitted`` as a loop.

    Parameters
    ----------
    tracer : Tracer
        With the multipass machine.
    iterations : int
        Surfaces on a path.
    """
    renderer = RENDERERS["whitted"]
    assert isinstance(renderer, Integrator)
    options: dict[str, Any] = {"max_bounces": iterations - 1, "min_weight": 0.0}
    chosen = renderer.check(renderer.complete(options))
    camera, sampler = tracer.scene.camera_for(1.0), Sampler.of("sobol", 0, 1)
    context = make_context(tracer, camera, (8, 8), sampler, chosen)
    bands = renderer.bands_of(context)
    assert bands is not None
    return round(MAX_BYTES / bands.pixels_at_once(renderer.stages, 8))


def result_bits() -> int:
    """Bits of a pixel's colour, and of the weight of its path."""
    weights = Paths.empty(1).weights
    return _COLOR_BITS + 8 * np.asarray(weights[:1]).nbytes

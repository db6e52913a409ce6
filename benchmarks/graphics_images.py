"""Images by fragment programs on the graphics device: seconds, passes, and what avoids work.

    python benchmarks/graphics_images.py
    python benchmarks/graphics_images.py --scenes cubes --modes shadow whitted --size 256

Renders each scene and mode as one loop of passes in four ways: kernels chosen on the device;
kernels chosen on the host by occlusion queries; the scene in textures; and rejection in the
programs, without the kernels' stencil test, which shows what passes cost without early rejection.
For comparison, the stages also run as whole queries of the same machine, with shading on the host;
and the loop runs on the CPU. Contenders take turns in each round; seconds are medians.

Then it measures the hybrid renderer (Purcell 2002, section 3.2): its first pass, which rasterises,
against the primary rays that it replaces; and the whole renderer. The adapter is printed: seconds
of a software adapter say nothing about graphics hardware.
"""

import argparse
import statistics
import time
from contextlib import contextmanager
from unittest import mock

import raystream as rs
from raystream.graphics import hybrid, visibility
from raystream.graphics.adapters import ADAPTER_VARIABLE, open_device
from raystream.graphics.multipass import loop_plan
from raystream.graphics.streams.stencil import Stencil

SCENES = {"three_boxes": "grid", "cubes": "grid", "spheres": "grid", "robots": "kdtree"}
MODES = {"raycast": {}, "shadow": {}, "whitted": {"max_bounces": 5}}
TRAVERSALS = {"kdtree": {"traversal": "restart"}}


class QueryTracer(rs.Tracer):
    """A tracer whose renderer calls its queries, stage by stage."""

    def first_hit(self, *rays, **options):
        """Find the nearest hits."""
        return super().first_hit(*rays, **options)


@contextmanager
def rejection_in_programs():
    """Let the stencil test of kernels always pass: the state in their records rejects the rest."""
    plain = loop_plan.fragment_pipeline
    kept = ("eye_rays", "commit", "classify", "resume")

    def without_test(opened, name, program, targets, stencil):
        if program.entry not in kept:
            stencil = Stencil()
        return plain(opened, name, program, targets, stencil)

    with mock.patch.object(loop_plan, "fragment_pipeline", without_test):
        yield


def contenders(scene, structure, mode, size, options):
    """Functions that render, by name."""
    own = TRAVERSALS.get(structure, {})

    def tracer(cls=rs.Tracer, device="graphics", **more):
        return cls(scene, structure, device, machine="multipass", **own, **more)

    def image(made):
        return lambda: rs.render(made, mode, size, **options)

    rejecting = tracer()

    def unrejected():
        with rejection_in_programs():
            return rs.render(rejecting, mode, size, **options)

    return {
        "loop='device'": image(tracer()),
        "loop='queries'": image(tracer(loop="queries")),
        "memory='textures'": image(tracer(memory="textures")),
        "rejection in programs": unrejected,
        "stages as queries": image(tracer(QueryTracer)),
        "CPU, loop": image(tracer(device="cpu")),
    }


def timed(ways, rounds):
    """Median seconds of each way, after one run, and what that run returned."""
    results = {name: way() for name, way in ways.items()}
    seconds = {name: [] for name in ways}
    for _ in range(rounds):
        for name, way in ways.items():
            started = time.perf_counter()
            way()
            seconds[name].append(time.perf_counter() - started)
    return {name: statistics.median(taken) for name, taken in seconds.items()}, results


def rows_of_images(arguments):
    """Yield the rows of the table of images."""
    size = arguments.size, arguments.size
    for name in arguments.scenes:
        scene = rs.load(name)
        for mode in arguments.modes:
            ways = contenders(scene, SCENES[name], mode, size, MODES[mode])
            seconds, images = timed(ways, arguments.rounds)
            for way, taken in seconds.items():
                passes = sum(images[way].figures.get("passes", {}).values())
                each = f"{1e3 * taken / passes:.2f}" if passes else ""
                yield name, mode, way, f"{passes or ''}", f"{taken:.3g}", each


def rows_of_hybrids(arguments):
    """Yield the rows of the table of the hybrid renderer."""
    size = arguments.size, arguments.size
    for name in arguments.scenes:
        scene = rs.load(name)
        compute = rs.Tracer(scene, "bvh", "graphics")
        rays = scene.camera_for(1.0).rays(*size)
        ways = {
            "first pass": lambda scene=scene: visibility(scene, size),
            "primary rays": lambda tracer=compute, rays=rays: tracer.first_hit(*rays),
            "hybrid": lambda tracer=compute: hybrid(tracer, size),
            "shadow": lambda tracer=compute: rs.render(tracer, "shadow", size),
        }
        for way, taken in timed(ways, arguments.rounds)[0].items():
            yield name, way, f"{taken:.3g}"


def show(rows):
    """Print a table."""
    widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
    for row in rows:
        print(
            "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip()
        )


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--scenes", nargs="+", default=SCENES, choices=SCENES)
    parser.add_argument("--modes", nargs="+", default=MODES, choices=MODES)
    parser.add_argument("--size", type=int, default=128, help="pixels along a side")
    parser.add_argument("--rounds", type=int, default=3)
    arguments = parser.parse_args()
    adapter = open_device().adapter
    print(f"adapter: {adapter}; {adapter.description} (another one: {ADAPTER_VARIABLE})")
    show([("scene", "mode", "way", "passes", "seconds", "ms/pass"), *rows_of_images(arguments)])
    print()
    show([("scene", "way", "seconds"), *rows_of_hybrids(arguments)])


if __name__ == "__main__":
    main()

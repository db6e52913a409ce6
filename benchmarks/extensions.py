"""What shadows, mirrors and paths cost beside the ray caster (Purcell 2002, section 4.3).

    python benchmarks/extensions.py --size 1024 --path-size 256 --samples 64

Each scene on the uniform grid and the branching machine, as Purcell's simulator had it, with one
light, and every surface a mirror of a quarter: his shading sends a reflected ray from each hit.
Ratios are to the ray caster's, for each ray from the eye:

rays, steps, tests
    Rays traced, cells looked at, triangles tested: counted.
instructions, words
    The same counts with the prices of Purcell's Table 1 (branching architecture).
time
    Of whole pictures without counting: medians of rounds in which the modes take turns.

``shadow rays`` are what Purcell's shadow caster traces, which finds visible surfaces by
rasterising; mode ``shadow`` traces those, too. Paths have two bounces; they find lights by chance
only, or by a ray to one at each surface as well. Prints the table of docs/renderers.rst.
"""

import argparse
import dataclasses
import statistics
import time
from collections import Counter

import numpy as np

import raystream as rs
from raystream.render.picture import RENDERERS
from raystream.render.sampled import make_setting
from raystream.render.sampling.sampler import Sampler

#: Scenes, and options of their grids: Purcell's, of section 4.1, where he has the scene. In one
#: level, all robots share a few cells, and 60,000 triangles are tested for a ray. The building
#: lies on a lawn of 570 m, for which 128 cells of its height would be 1.2 billion.
SCENES = {
    "cornell": {},
    "bunny": {"min_resolution": 64},
    "robots": {"min_resolution": 24, "levels": 2},
    "forest": {"min_resolution": 128},
    "building": {"min_resolution": 32},
}

#: Row: mode, options, and what Purcell's table says of instructions and bandwidth (the bunny's).
ROWS = {
    "shadow rays": ("shadow", {}, (0.85, 1.15)),
    "shadow": ("shadow", {}, None),
    "whitted, 1 bounce": ("whitted", {"max_bounces": 1}, (2.62, 3.00)),
    "whitted, 2 bounces": ("whitted", {"max_bounces": 2}, (2.62, 3.00)),
    "path, by chance": ("path", {"max_bounces": 2, "light_samples": False}, (3.24, 4.06)),
    "path, to lights": ("path", {"max_bounces": 2}, (3.24, 4.06)),
}

#: Degrees.
BUNNY_FOV = 33.0

#: What mirrors send on.
SHARE = 0.25

#: Instructions and words of 4 bytes, Table 1: to make an eye ray, to set up a ray, for a step and a
#: triangle, to colour a hit, and to send a shadow ray, a reflected one, and a path's next one.
PRICES = {
    "eye": (26, 4),
    "rays": (22, 7),
    "steps": (12, 1),
    "tests": (36, 10),
    "hits": (25, 24),
    "shadow": (10, 0),
    "reflected": (12, 0),
    "path": (11, 3),
}

#: Rays from the eye that are counted together.
BAND = 1 << 16


class CountingTracer(rs.Tracer):
    """A tracer on a grid that adds up what it was asked, for each of the two queries."""

    def __init__(self, scene, **options):
        super().__init__(scene, "grid", machine="branching", counters=True, **options)
        self.sums = {"first_hit": Counter(), "any_hit": Counter()}

    def first_hit(self, *rays, **options):
        return self._count("first_hit", super().first_hit(*rays, **options))

    def any_hit(self, *rays, **options):
        return self._count("any_hit", super().any_hit(*rays, **options))

    def _count(self, query, answer):
        sums, counters = self.sums[query], self.counters
        sums["rays"] += counters.steps.size
        sums["steps"] += counters.total["steps"]
        sums["tests"] += counters.total["tests"]
        if query == "first_hit":
            sums["hits"] += int(answer.is_hit.sum())
        return answer


def with_mirrors(name):
    """A scene with one light, on surfaces that mirror."""
    scene = rs.load(name)
    meshes, lights, camera = list(scene.meshes), scene.lights[:1], scene.camera_for(1.0)
    if name == "bunny":
        low, high = scene.bounds
        middle, height = (low + high) / 2, float(high[1] - low[1])
        # The floor makes the scene as wide and deep as Purcell's grid of 98 x 64 x 163 is.
        corners = np.array([[-1, 0, -1], [-1, 0, 1], [1, 0, 1], [1, 0, -1]]) * height / 2
        corners = corners * [98 / 64, 0, 163 / 64] + [middle[0], low[1], middle[2]]
        meshes.append(rs.Mesh(corners, [[0, 1, 2], [0, 2, 3]], name="floor"))
        lights = [rs.PointLight(tuple(middle + np.array([1, 2, 1]) * height), (6 * height**2,) * 3)]
        # From where as many rays hit as in his Figure 6, 0.82.
        eye = middle + np.array([0.2, 1.7, 1.3]) * height
        camera = rs.Camera(tuple(eye), tuple(middle), fov=BUNNY_FOV)
    polished = [
        dataclasses.replace(
            material,
            diffuse=tuple((1 - SHARE) * channel for channel in material.diffuse),
            reflection=(SHARE,) * 3,
            transmission=(0.0,) * 3,
        )
        for material in scene.materials
    ]
    return rs.Scene(meshes, materials=polished, lights=lights, camera=camera)


def count(tracer, mode, size, samples, options):
    """Sums of both queries for a picture."""
    tracer.sums = {"first_hit": Counter(), "any_hit": Counter()}
    camera = tracer.scene.camera
    if mode == "raycast":
        tracer.first_hit(*camera.rays(size, size))
        return tracer.sums
    renderer = RENDERERS[mode]
    options = renderer.check({**renderer.options, **options})
    setting = make_setting(tracer, camera, (size, size), Sampler.of("sobol", 0, samples), options)
    step = max(BAND // size, 1)
    for sample in range(samples):
        for row in range(0, size, step):
            renderer.trace(setting, range(row, min(row + step, size)), sample)
    return tracer.sums


def cost(row, sums, eye_count):
    """Rays, steps, tests, instructions and words for each eye ray."""
    near, lit = sums["first_hit"], sums["any_hit"]
    sent = near["rays"] - eye_count
    parts = {name: near[name] + lit[name] for name in ("rays", "steps", "tests", "hits")}
    parts.update(eye=eye_count, shadow=lit["rays"])
    parts["path" if row.startswith("path") else "reflected"] = sent
    if row == "shadow rays":  # hits are found, and eye rays made, by rasterising
        parts = {**lit, "hits": near["hits"], "shadow": lit["rays"]}
    prices = [sum(PRICES[part][k] * number for part, number in parts.items()) for k in (0, 1)]
    return [
        number / eye_count for number in (*(parts[k] for k in ("rays", "steps", "tests")), *prices)
    ]


def time_modes(scene, arguments, **options):
    """Median seconds of each row's picture for each eye ray, over the ray caster's."""
    tracer = rs.Tracer(scene, "grid", **options)
    modes = {"raycast": ("raycast", {}, None), **ROWS}
    del modes["shadow rays"]
    ratios = {row: [] for row in modes}
    for number in range(arguments.rounds + 1):  # the first one compiles
        seconds = {}
        for row, (mode, own, _) in modes.items():
            size, samples = size_of(row, arguments)
            started = time.perf_counter()
            rs.render(tracer, mode, (size, size), samples, **own)
            seconds[row] = (time.perf_counter() - started) / (size * size * samples)
        if number:
            for row, taken in seconds.items():
                ratios[row].append(taken / seconds["raycast"])
    return {row: statistics.median(values) for row, values in ratios.items()}


def size_of(row, arguments):
    """Pixels along a side, and samples of each."""
    if row.startswith("path"):
        return arguments.path_size, arguments.samples
    return arguments.size, 1


def measure(name, arguments):
    """Rows of the table for a scene."""
    scene = with_mirrors(name)
    tracer = CountingTracer(scene, **SCENES.get(name, {}))
    base = cost("raycast", count(tracer, "raycast", arguments.size, 1, {}), arguments.size**2)
    yield [name, "raycast", *(f"{number:.4g}" for number in base), "", ""]
    times = time_modes(scene, arguments, **SCENES.get(name, {})) if arguments.rounds else {}
    for row, (mode, own, published) in ROWS.items():
        size, samples = size_of(row, arguments)
        costs = cost(row, count(tracer, mode, size, samples, own), size * size * samples)
        ratios = [f"{a / b:.2f}" for a, b in zip(costs, base, strict=True)]
        taken = f"{times[row]:.2f}" if row in times else ""
        told = "{:.2f}, {:.2f}".format(*published) if published and name == "bunny" else ""
        yield [name, row, *ratios, taken, told]


def print_table(rows):
    """As reStructuredText."""
    widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
    rule = " ".join("=" * width for width in widths)
    print(rule)
    for k, row in enumerate(rows):
        if k == 1:
            print(rule)
        print(" ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip())
    print(rule)


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--size", type=int, default=1024)
    parser.add_argument("--path-size", type=int, default=256)
    parser.add_argument("--samples", type=int, default=64, help="of paths, for each pixel")
    parser.add_argument("--rounds", type=int, default=5, help="0: count only")
    parser.add_argument("--scenes", nargs="+", default=list(SCENES))
    arguments = parser.parse_args()
    counted = ["rays", "steps", "tests", "instructions", "words"]
    rows = [["scene", "mode", *counted, "time", "Purcell"]]
    for name in arguments.scenes:
        for row in measure(name, arguments):
            print(*row, sep="  ", flush=True)
            rows.append(row)
    print()
    print_table(rows)


if __name__ == "__main__":
    main()

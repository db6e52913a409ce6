"""How long an image takes compared with its rays alone.

    python benchmarks/render_stages.py cornell sponza --size 1024x768

Renders 8 samples of each pixel in modes ``ao``, ``kajiya`` and ``path``, and records all rays of
one sample that are sent to the tracer. Then it traces the same rays again, all rays of a kind and
bounce at once, as a user would: that is the time of the rays alone. The two take turns; the median
of the ratio shows what shading and bookkeeping add. ``--threads 1`` also prints the processor
seconds of each rendering stage.
"""

import argparse
import statistics
import time
from collections import defaultdict
from functools import partial

import numpy as np

import raystream as rs
from raystream.rendering import ao, contexts, integrator, path
from raystream.rendering.render import RENDERERS

#: Samples of an image; the printed time is that of one sample.
SAMPLES = 8

MODES = {"ao": {}, "kajiya": {}, "path": {"max_bounces": 8}}

#: Interior views for scenes without a camera of their own; see the samples' descriptions.
VIEWS = {
    "sponza": {"eye": (-9, 2, 0), "look_at": (8, 4, 0), "up": (0, 1, 0), "fov": 65},
    "sibenik": {"eye": (-17, -11, 0.5), "look_at": (0, -8, 0), "up": (0, 1, 0), "fov": 60},
    "conference": {
        "eye": (1250, 330, -800),
        "look_at": (100, 130, 100),
        "up": (0, 1, 0),
        "fov": 60,
    },
}


class Listener:
    """A tracer that records the rays of its queries."""

    def __init__(self, tracer):
        self.tracer, self.scene, self.batches = tracer, tracer.scene, []

    def __getattr__(self, name):
        return getattr(self.tracer, name)

    def first_hit(self, origins, directions, **options):
        """Query the tracer, and record the rays."""
        hits = self.tracer.first_hit(origins, directions, **options)
        self.batches.append(
            ("first_hit", origins.reshape(-1, 3).copy(), directions.reshape(-1, 3).copy(), None)
        )
        return hits

    def any_hit(self, origins, directions, t_max=np.inf, **options):
        """Query the tracer, and record the rays."""
        seen = self.tracer.any_hit(origins, directions, t_max=t_max, **options)
        self.batches.append(("any_hit", origins.copy(), directions.copy(), np.array(t_max)))
        return seen


def view_of(name, scene, aspect):
    """The view listed for a scene, else the scene's own camera."""
    for known, parts in VIEWS.items():
        if known in name:
            return rs.Camera(**parts)
    return scene.camera_for(aspect)


def rays_of(tracer, mode, size, camera, options):
    """All rays of one sample of an image: origins, directions, t_max, by query and bounce."""
    renderer = RENDERERS[mode]
    listener = Listener(tracer)
    chosen = renderer.check({**renderer.options, **options})
    numbers = integrator.Sampler.of("sobol", 0, 16)
    context = contexts.make_context(listener, camera, size, numbers, chosen)
    parts = defaultdict(list)
    rows = max(1, (1 << 16) // size[0])
    for first in range(0, size[1], rows):
        listener.batches = []
        renderer.trace(context, range(first, min(first + rows, size[1])), 0)
        seen = defaultdict(int)
        for query, *batch in listener.batches:
            parts[query, seen[query]].append(batch)
            seen[query] += 1
    return {key: _joined(batches) for key, batches in parts.items()}


def _joined(batches):
    origins, directions, t_max = zip(*batches, strict=True)
    longest = None if t_max[0] is None else np.concatenate(t_max)
    return np.concatenate(origins), np.concatenate(directions), longest


def ask(tracer, rays):
    """Trace rays."""
    for (query, _), (origins, directions, t_max) in rays.items():
        if query == "first_hit":
            tracer.first_hit(origins, directions)
        else:
            tracer.any_hit(origins, directions, t_max=t_max)


def seconds(function):
    """Seconds that a call takes."""
    started = time.perf_counter()
    function()
    return time.perf_counter() - started


STAGES = {
    "first_hit": (rs.Tracer, "first_hit"),
    "any_hit": (rs.Tracer, "any_hit"),
    "shading of paths": (path, "shade_paths"),
    "shading of paths in plain scenes": (path, "shade_plain_paths"),
    "shading of ao": (ao, "spawn_ao_rays"),
    "camera rays": (integrator, "camera_paths"),
    "adding light": (integrator, "add_unblocked"),
}


def profile(render):
    """Processor seconds of a rendering on one thread, by stage."""
    spent = dict.fromkeys(STAGES, 0.0)

    def timed(name, function):
        def call(*arguments, **options):
            started = time.thread_time()
            result = function(*arguments, **options)
            spent[name] += time.thread_time() - started
            return result

        return call

    kept = {name: getattr(*place) for name, place in STAGES.items()}
    for name, place in STAGES.items():
        setattr(*place, timed(name, kept[name]))
    started = time.thread_time()
    render()
    total = time.thread_time() - started
    for name, place in STAGES.items():
        setattr(*place, kept[name])
    return {**{name: value for name, value in spent.items() if value}, "whole": total}


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("scenes", nargs="*", default=["cornell"])
    parser.add_argument("--size", default="1024x768")
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--modes", nargs="*", default=list(MODES))
    parser.add_argument("--threads", type=int, default=rs.thread_count())
    arguments = parser.parse_args()
    rs.set_thread_count(arguments.threads)
    width, height = map(int, arguments.size.split("x"))
    for name in arguments.scenes:
        scene = rs.load(name)
        tracer = rs.Tracer(scene)
        camera = view_of(name, scene, width / height)
        for mode in arguments.modes:
            rays = rays_of(tracer, mode, (width, height), camera, MODES[mode])
            count = sum(len(origins) for origins, _, _ in rays.values())

            render = partial(rs.render, tracer, mode, (width, height), camera=camera, **MODES[mode])
            render(samples=2)
            ask(tracer, rays)
            asking = partial(ask, tracer, rays)
            pairs = [
                (seconds(partial(render, samples=SAMPLES)) / SAMPLES, seconds(asking))
                for _ in range(arguments.rounds)
            ]
            ratios = [picture / alone for picture, alone in pairs]
            picture, alone = (statistics.median(column) for column in zip(*pairs, strict=True))
            print(
                f"{name}, {mode}, {width}x{height}, {arguments.threads} threads: "
                f"{count / width / height:.2f} rays/pixel, {count / alone / 1e6:.1f} M/s alone; "
                f"image {picture:.2f} s, rays {alone:.2f} s, ratio "
                f"{statistics.median(ratios):.2f} ({min(ratios):.2f} to {max(ratios):.2f})"
            )
            if arguments.threads == 1:
                for stage, value in profile(partial(render, samples=1)).items():
                    print(f"    {stage:<18s} {value:7.3f} s")


if __name__ == "__main__":
    main()

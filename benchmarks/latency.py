"""Latency: single rays with `Tracer.cast`, and small batches, on one core.

    python benchmarks/latency.py
    python benchmarks/latency.py conference --structure kdtree

Traces rays of the scene's camera in random order. Prints the median time of a call in microseconds,
from converted arguments to the result; each call has its own rays.
"""

import argparse
import os
import time

os.environ.setdefault("RAYSTREAM_THREADS", "1")

import numpy as np

import raystream as rs

#: Rays per batch, and the number of batches that are timed.
BATCHES = {1: 5_000, 10: 5_000, 100: 3_000, 1_000: 1_000}


def camera_rays(scene, count):
    """Origins and directions, (count, 3) float32 each, in random order."""
    size = int(np.ceil(np.sqrt(count)))
    origins, directions = scene.camera.rays(size, size)
    origins = np.broadcast_to(origins, directions.shape).reshape(-1, 3)
    chosen = np.random.default_rng(26).permutation(len(origins))[:count]
    return origins[chosen].astype(np.float32), directions.reshape(-1, 3)[chosen].astype(np.float32)


def median(call, arguments):
    """Median time of a call in microseconds, after some calls that are not timed."""
    for one in arguments[:10]:
        call(*one)
    times = []
    for one in arguments:
        started = time.perf_counter_ns()
        call(*one)
        times.append(time.perf_counter_ns() - started)
    return float(np.median(times)) / 1000.0


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("scene", nargs="?", default="bunny")
    parser.add_argument("--structure", default="bvh")
    parser.add_argument("--casts", type=int, default=100_000)
    arguments = parser.parse_args()
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
    tracer = rs.Tracer(rs.load(arguments.scene), arguments.structure)
    origins, directions = camera_rays(tracer.scene, arguments.casts)
    kinds = {
        "tuples of floats": lambda rows: list(map(tuple, rows.tolist())),
        "float32 arrays": list,
        "float64 arrays": lambda rows: list(rows.astype(np.float64)),
    }
    for kind, convert in kinds.items():
        rays = list(zip(convert(origins), convert(directions), strict=True))
        print(f"cast, {kind:29s} {median(tracer.cast, rays):8.2f}")
    for size, count in BATCHES.items():
        starts = np.random.default_rng(size).integers(0, len(origins) - size + 1, count)
        rays = [(origins[k : k + size], directions[k : k + size]) for k in starts.tolist()]
        for name in ("first_hit", "any_hit"):
            print(f"{name}, {size:5,} rays, float32 {median(getattr(tracer, name), rays):17.2f}")


if __name__ == "__main__":
    main()

"""The five structures beside each other: speed of three queries, build time, memory.

    python benchmarks/structures.py --scenes conference kitchen sibenik robots building

All structures answer the same rays, one after another in each round, and medians of the rounds
count. Prints the table of docs/structures.rst; every answer is compared with the BVH's.
"""

import argparse
import statistics
import time

import numpy as np

import raystream as rs
from raystream.bench.ray_sets import make_ray_sets

SCENES = ("conference", "kitchen", "sibenik", "sponza", "bunny", "robots", "building", "forest")

STRUCTURES = {
    "bvh": {"structure": "bvh"},
    "bvh, single rays": {"structure": "bvh", "kernel": "single"},
    "kdtree": {"structure": "kdtree"},
    "graph": {"structure": "graph"},
    "grid": {"structure": "grid"},
}

#: Ray set, query.
QUERIES = {
    "first, primary": ("primary", "first_hit"),
    "first, bounce": ("bounce", "first_hit"),
    "any, shadow": ("shadow", "any_hit"),
    "multi, primary": ("primary", "multi_hit"),
    "multi, random": ("random", "multi_hit"),
}


def answer(tracer, rays, query):
    """What a tracer says, and the seconds that it takes."""
    started = time.perf_counter()
    found = getattr(tracer, query)(rays.origins, rays.directions, t_max=rays.t_max)
    return found, time.perf_counter() - started


def same(a, b):
    """Whether two answers are equal, bit for bit."""
    if isinstance(a, np.ndarray):
        return np.array_equal(a, b)
    return a.t.tobytes() == b.t.tobytes() and np.array_equal(a.prim_id, b.prim_id)


def measure(name, size, rounds, chosen):
    """Rows of the table for a scene."""
    scene = rs.load(name)
    tracers, builds = {}, {}
    for label in chosen:
        tracers[label] = rs.Tracer(scene, **STRUCTURES[label])
        builds[label] = [tracers[label].structure.report.seconds]
    for _ in range(2):
        for label in chosen:
            again = rs.Tracer(scene, **STRUCTURES[label])
            builds[label].append(again.structure.report.seconds)
    reference = rs.Tracer(scene)
    sets = {
        one.name: one.rays
        for one in make_ray_sets(
            reference, scene.camera_for(1.0), (size, size), sorted({s for s, _ in QUERIES.values()})
        )
    }
    seconds = {(label, title): [] for label in chosen for title in QUERIES}
    for title, (ray_set, query) in QUERIES.items():
        rays = sets[ray_set]
        expected, _ = answer(reference, rays, query)
        for k in range(rounds + 1):  # the first one warms up
            for label, tracer in tracers.items():
                found, taken = answer(tracer, rays, query)
                assert same(found, expected), (name, label, title)
                if k:
                    seconds[label, title].append(taken)
    for label, tracer in tracers.items():
        row = [name, label]
        for title, (ray_set, _) in QUERIES.items():
            count = sets[ray_set].origins.size // 3
            count = max(count, sets[ray_set].directions.size // 3)
            row.append(f"{count / statistics.median(seconds[label, title]) / 1e6:.3g}")
        row.append(f"{statistics.median(builds[label]):.2g}")
        row.append(f"{tracer.structure.report.byte_count / len(scene.triangles):.0f}")
        yield row


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--size", type=int, default=512)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--scenes", nargs="+", default=SCENES)
    parser.add_argument("--structures", nargs="+", default=list(STRUCTURES))
    arguments = parser.parse_args()
    columns = ["scene", "structure", *QUERIES, "build, s", "bytes a triangle"]
    rows = [columns]
    for name in arguments.scenes:
        for row in measure(name, arguments.size, arguments.rounds, arguments.structures):
            rows.append(row)
            print(*row, sep="  ", flush=True)
    widths = [max(len(row[k]) for row in rows) for k in range(len(columns))]
    rule = " ".join("=" * width for width in widths)
    print()
    for k, row in enumerate(rows):
        if k < 2:
            print(rule)
        print(" ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)))
    print(rule)


if __name__ == "__main__":
    main()

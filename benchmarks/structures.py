"""The five structures compared: speed of three queries, build time, memory.

    python benchmarks/structures.py --scenes conference kitchen sibenik robots building spheres
    python benchmarks/structures.py --ratio kdtree graph --rounds 12

All structures trace the same rays, one after another in each round, and the median of the rounds
counts. Prints the tables of docs/structures.rst; every answer is compared with the BVH's. With
``--ratio``, only two structures are compared, by the median of the ratio of their times in a round:
above 1, the second one is faster.
"""

import argparse
import statistics
import time

import numpy as np

import raystream as rs
from raystream.bench.ray_sets import make_ray_sets

SCENES = ("conference", "kitchen", "sibenik", "robots", "building", "spheres")

STRUCTURES = {
    "bvh": {"structure": "bvh"},
    "bvh, single rays": {"structure": "bvh", "kernel": "single"},
    "kdtree": {"structure": "kdtree"},
    "graph": {"structure": "graph"},
    "grid": {"structure": "grid"},
}

#: Ray set and query of each column.
QUERIES = {
    "first, primary": ("primary", "first_hit"),
    "first, bounce": ("bounce", "first_hit"),
    "any, shadow": ("shadow", "any_hit"),
    "multi, primary": ("primary", "multi_hit"),
    "multi, random": ("random", "multi_hit"),
}


def answer(tracer, rays, query):
    """The answer of a tracer, and the seconds taken."""
    started = time.perf_counter()
    found = getattr(tracer, query)(rays.origins, rays.directions, t_max=rays.t_max)
    return found, time.perf_counter() - started


def same(a, b):
    """Whether two answers are equal, bit for bit."""
    if isinstance(a, np.ndarray):
        return np.array_equal(a, b)
    return a.t.tobytes() == b.t.tobytes() and np.array_equal(a.prim_id, b.prim_id)


#: The same for ``--ratio``.
RATIO_QUERIES = {
    "multi, primary": ("primary", "multi_hit"),
    "multi, bounce": ("bounce", "multi_hit"),
    "multi, random": ("random", "multi_hit"),
    "first, primary": ("primary", "first_hit"),
    "first, bounce": ("bounce", "first_hit"),
    "any, random": ("random", "any_hit"),
}


def time_queries(scene, tracers, queries, size, rounds):
    """Seconds of every round, by structure and query; and the number of rays of each query."""
    reference = rs.Tracer(scene)
    names = sorted({ray_set for ray_set, _ in queries.values()})
    camera = scene.camera_for(1.0)
    sets = {one.name: one.rays for one in make_ray_sets(reference, camera, (size, size), names)}
    seconds = {(label, title): [] for label in tracers for title in queries}
    counts = {}
    for title, (ray_set, query) in queries.items():
        rays = sets[ray_set]
        counts[title] = max(rays.origins.size, rays.directions.size) // 3
        expected, _ = answer(reference, rays, query)
        for k in range(rounds + 1):  # the first round warms up
            for label, tracer in tracers.items():
                found, taken = answer(tracer, rays, query)
                assert same(found, expected), (label, title)
                if k:
                    seconds[label, title].append(taken)
    return seconds, counts


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
    seconds, counts = time_queries(scene, tracers, QUERIES, size, rounds)
    for label, tracer in tracers.items():
        row = [name, label]
        for title, count in counts.items():
            row.append(f"{count / statistics.median(seconds[label, title]) / 1e6:.3g}")
        row.append(f"{statistics.median(builds[label]):.2g}")
        row.append(f"{tracer.structure.report.byte_count / len(scene.triangles):.0f}")
        yield row


def compare(name, size, rounds, first, second):
    """A row of ratios for a scene."""
    scene = rs.load(name)
    tracers = {label: rs.Tracer(scene, **STRUCTURES[label]) for label in (first, second)}
    seconds, counts = time_queries(scene, tracers, RATIO_QUERIES, size, rounds)
    row = [name]
    for title in counts:
        pairs = zip(seconds[first, title], seconds[second, title], strict=True)
        row.append(f"{statistics.median(a / b for a, b in pairs):.2f}")
    return row


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--size", type=int, default=512)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--scenes", nargs="+", default=SCENES)
    parser.add_argument("--structures", nargs="+", default=list(STRUCTURES))
    parser.add_argument("--ratio", nargs=2, choices=STRUCTURES)
    arguments = parser.parse_args()
    columns = ["scene", "structure", *QUERIES, "build, s", "bytes/triangle"]
    if arguments.ratio:
        columns = ["scene", *RATIO_QUERIES]
    rows = [columns]
    for name in arguments.scenes:
        if arguments.ratio:
            new = [compare(name, arguments.size, arguments.rounds, *arguments.ratio)]
        else:
            new = measure(name, arguments.size, arguments.rounds, arguments.structures)
        for row in new:
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

"""Millions of hard rays: does a structure give the same bits as brute force?

    python benchmarks/agreement.py --rays 5000000 --structure bvh
    python benchmarks/agreement.py --rays 5000000 --structure bvh --device cuda

Runs every case of the test suite repeatedly with other seeds, more rays, and intervals of all kinds
(t_min above, at and below zero), and counts the rays whose answer differs in any bit of any query.
The figures in docs/decisions come from here.
"""

import argparse
import sys
import time
from collections import Counter
from pathlib import Path

import numpy as np

import raystream as rs

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
import cases


def differing(tracer, oracle, rays):
    """Whether any query gives different bits, for each ray."""
    wrong = np.zeros(len(rays["origins"]), bool)
    first, expected = tracer.first_hit(**rays), oracle.first_hit(**rays)
    for column in ("t", "u", "v", "prim_id"):
        a, b = getattr(first, column), getattr(expected, column)
        wrong |= a.view(np.int32) != b.view(np.int32)
    wrong |= tracer.any_hit(**rays) != oracle.any_hit(**rays)
    for crossings in ("triangles", "surfaces"):
        many = tracer.multi_hit(**rays, crossings=crossings)
        expected = oracle.multi_hit(**rays, crossings=crossings)
        wrong |= many.counts != expected.counts
        if np.array_equal(many.ray_splits, expected.ray_splits):
            for column in ("t", "u", "v", "prim_id"):
                a, b = getattr(many, column), getattr(expected, column)
                np.logical_or.at(wrong, many.ray_id, a.view(np.int32) != b.view(np.int32))
    return wrong


def limits(kind, t, rng):
    """Intervals around the first hits: above zero, below zero, from or up to a hit."""
    t = np.where(np.isfinite(t), t, 1.0)
    shift = t * rng.uniform(0.2, 1.8, len(t))
    return {
        "t_min = 0": (0.0, np.inf),
        "t_min > 0": (shift, np.inf),
        "t_min < 0": (-np.abs(shift) * 4, np.abs(shift)),
        "t_min = t of a hit": (t, np.inf),
        "t_max = t of a hit": (-np.inf, t),
    }[kind]


#: Options of the structures, used in turn: some make trees as deep as possible.
OPTIONS = {
    "bvh": [{"max_leaf_size": 2}],
    "grid": [
        {"resolution": (7, 3, 5)},
        {},
        {"resolution": 3, "levels": 2},
        {"min_resolution": 16},
    ],
    "graph": [
        {"crossing_cost": 0.1, "link_cost": 0.02, "max_leaf_size": 1},
        {},
        {"crossing_cost": 4.0, "link_cost": 1.0},
    ],
    "kdtree": [
        {"traversal": traversal, "layout": layout, "intersection_cost": cost}
        for traversal in ("stack", "restart", "backtrack", "short-stack")
        for layout, cost in (("compact", 12.0), ("foley", 100.0))
    ],
}

#: The ways to trace and build on a GPU.
CUDA_OPTIONS = {
    **OPTIONS,
    "bvh": [{"max_leaf_size": 2}, {"build": "device"}],
    "grid": [*OPTIONS["grid"], {"build": "device"}],
}


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--device", choices=("cpu", "cuda"), default="cpu")
    parser.add_argument("--rays", type=int, default=1_000_000)
    parser.add_argument("--structure", choices=OPTIONS, default="bvh")
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    cases.RAY_COUNT = 10_000
    done, wrong = Counter(), Counter()
    started = time.perf_counter()
    kinds = ["t_min = 0", "t_min > 0", "t_min < 0", "t_min = t of a hit", "t_max = t of a hit"]
    seed = arguments.seed
    while sum(done.values()) < arguments.rays:
        for number, make in enumerate(cases.CASES.values()):
            rng = np.random.default_rng([seed, sum(done.values())])
            case = make(rng)
            known = OPTIONS if arguments.device == "cpu" else CUDA_OPTIONS
            choices = known[arguments.structure]
            options = choices[(seed + number) % len(choices)]
            tracer = rs.Tracer(case.scene, arguments.structure, arguments.device, **options)
            oracle = rs.Tracer(case.scene, "brute")
            rays = {"origins": case.origins, "directions": case.directions}
            t = oracle.first_hit(**rays).t
            for kind in kinds:
                low, high = limits(kind, t, rng)
                bad = differing(tracer, oracle, {**rays, "t_min": low, "t_max": high})
                done[kind] += len(bad)
                wrong[kind] += int(np.count_nonzero(bad))
        seed += 1
    for kind in kinds:
        print(f"{kind:20s} {done[kind]:>10,} rays, {wrong[kind]} differ")
    print(f"{len(cases.CASES)} kinds of scene and ray, {time.perf_counter() - started:.0f} s")
    return 1 if any(wrong.values()) else 0


if __name__ == "__main__":
    sys.exit(main())

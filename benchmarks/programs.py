"""Programs and filters beside the queries that do the same, on every structure.

    python benchmarks/programs.py --scenes bunny kitchen --structures bvh kdtree graph

In each round all of them run one after another; the medians of the rounds count. Prints the
table of docs/decisions/0013-programs.rst: milliseconds, and how many times as long as the first
query of the group each takes.
"""

import argparse
import statistics
import time

import numpy as np

import raystream as rs
from raystream.bench.ray_sets import make_ray_sets

WIDTH, HEIGHT = 1024, 768


def count(hit, payload):  # noqa: ARG001
    payload[0] += 1


def balance(hit, payload):
    payload[0] += 1 if hit.is_entering else -1


def most(hit):
    return hit.prim_id % 64 != 0


def half(hit):
    return hit.prim_id % 2 == 0


#: Groups of queries; the first of a group is the one that others are compared with.
GROUPS = (
    {
        "count_hits": lambda tracer, rays: tracer.count_hits(*rays),
        "count_hits, filter ignores 1/64": lambda tracer, rays: tracer.count_hits(
            *rays, on_hit=most
        ),
        "counting program, any order": lambda tracer, rays: tracer.trace(
            *rays, on_hit=count, payload=np.int64, order="any"
        ),
        "counting program, front to back": lambda tracer, rays: tracer.trace(
            *rays, on_hit=count, payload=np.int64
        ),
        "program that uses is_entering, any order": lambda tracer, rays: tracer.trace(
            *rays, on_hit=balance, payload=np.int64, order="any"
        ),
        "multi_hit": lambda tracer, rays: tracer.multi_hit(*rays),
    },
    {
        "first_hit": lambda tracer, rays: tracer.first_hit(*rays),
        "first_hit, filter ignores 1/64": lambda tracer, rays: tracer.first_hit(*rays, on_hit=most),
        "first_hit, filter ignores 1/2": lambda tracer, rays: tracer.first_hit(*rays, on_hit=half),
    },
    {
        "any_hit": lambda tracer, rays: tracer.any_hit(*rays),
        "any_hit, filter ignores 1/64": lambda tracer, rays: tracer.any_hit(*rays, on_hit=most),
    },
)


def measure(tracer, rays, rounds):
    """Median seconds of each query."""
    seconds = {title: [] for group in GROUPS for title in group}
    for k in range(rounds + 1):  # the first one compiles
        for group in GROUPS:
            for title, query in group.items():
                started = time.perf_counter()
                query(tracer, rays)
                if k:
                    seconds[title].append(time.perf_counter() - started)
    return {title: statistics.median(taken) for title, taken in seconds.items()}


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--scenes", nargs="+", default=("bunny", "kitchen"))
    parser.add_argument("--structures", nargs="+", default=("bvh", "kdtree", "graph"))
    parser.add_argument("--set", default="primary", choices=("primary", "bounce", "random"))
    parser.add_argument("--rounds", type=int, default=9)
    arguments = parser.parse_args()
    for name in arguments.scenes:
        scene = rs.load(name)
        camera = scene.camera_for(WIDTH / HEIGHT)
        sets = make_ray_sets(rs.Tracer(scene), camera, (WIDTH, HEIGHT), [arguments.set])
        rays = next(one.rays for one in sets if one.name == arguments.set)
        for structure in arguments.structures:
            tracer = rs.Tracer(scene, structure)
            medians = measure(tracer, (rays.origins, rays.directions), arguments.rounds)
            for group in GROUPS:
                base = medians[next(iter(group))]
                for title in group:
                    figures = f"{medians[title] * 1e3:8.1f} {medians[title] / base:6.2f}"
                    print(f"{name:10} {structure:8} {title:42} {figures}", flush=True)


if __name__ == "__main__":
    main()

"""The graphics device against the CPU engine: Mrays/s of first hits.

    python benchmarks/graphics.py
    RAYSTREAM_SCENES=~/models python benchmarks/graphics.py --scenes bunny --size 512

All contenders trace the same rays, one after another in each round, and the median of the rounds
counts. The column "times the CPU" gives the speed relative to the CPU, as the median of the ratios
in a round. Answers are compared with the CPU's: the last column counts the rays for which a
different triangle was found. The adapter is printed: a software adapter says nothing about graphics
hardware, except that everything runs.
"""

import argparse
import statistics
import time

import numpy as np

import raystream as rs
from raystream.bench.contenders.base import Rays
from raystream.bench.ray_sets import make_ray_sets
from raystream.graphics.adapters import ADAPTER_VARIABLE, open_device
from raystream.graphics.errors import GraphicsError
from raystream.structures import names_with

SCENES = ("cornell", "spheres", "robots", "building")
RAY_SETS = ("primary", "bounce")

#: The contender with which the others are compared.
CPU = "cpu, bvh"

#: Machines of the graphics device, in this order. If a scene is too large or too slow for a machine
#: or structure, it is left out, and a line says why.
MACHINES = ("compute",)


def contenders(structures, machines):
    """Options of each contender's tracer."""
    yield CPU, {"structure": "bvh"}
    for machine in machines:
        for structure in structures:
            options = {"structure": structure, "device": "graphics", "machine": machine}
            yield f"{machine}, {structure}", options


def answer(tracer, rays):
    """The triangles that rays hit first, and the seconds that it takes."""
    started = time.perf_counter()
    found = tracer.first_hit(rays.origins, rays.directions, t_max=rays.t_max)
    return found.prim_id, time.perf_counter() - started


def warmed_up(tracers, rays, patience):
    """The tracers that can answer within `patience` times the CPU's time."""
    base = min(answer(tracers[CPU], rays)[1] for _ in range(3))
    ready = {}
    few = Rays(*(np.ascontiguousarray(rows[::16]) for rows in rays.rows()), rays.t_max)
    for label, tracer in tracers.items():
        try:
            taken = 16 * min(answer(tracer, few)[1] for _ in range(2))
        except GraphicsError as error:
            print(f"  {label}: left out: {error}", flush=True)
            continue
        if taken > patience * max(base, 0.01):
            print(f"  {label}: left out: about {taken / base:,.0f} times as long as the CPU")
            continue
        ready[label] = tracer
    return ready


def measure(name, arguments):
    """Rows of the table for a scene."""
    scene = rs.load(name)
    tracers = {}
    for label, options in contenders(arguments.structures, arguments.machines):
        try:
            tracers[label] = rs.Tracer(scene, **options)
        except GraphicsError as error:
            print(f"  {label}: left out: {error}", flush=True)
    size = arguments.size, arguments.size
    for one in make_ray_sets(tracers[CPU], scene.camera_for(1.0), size, RAY_SETS):
        ready = warmed_up(tracers, one.rays, arguments.patience)
        seconds, wrong = {label: [] for label in ready}, {}
        for _ in range(arguments.rounds):
            for label, tracer in ready.items():
                prim_ids, taken = answer(tracer, one.rays)
                seconds[label].append(taken)
                if label == CPU:
                    expected = prim_ids
                wrong[label] = int(np.count_nonzero(prim_ids != expected))
        count = expected.size
        for label, taken in seconds.items():
            speed = count / statistics.median(taken) / 1e6
            pairs = zip(seconds[CPU], taken, strict=True)
            ratio = statistics.median(base / own for base, own in pairs)
            yield name, one.name, label, f"{speed:.3g}", f"{ratio:.3g}", f"{wrong[label]}"


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--scenes", nargs="+", default=SCENES)
    parser.add_argument("--structures", nargs="+", default=names_with("graphics"))
    parser.add_argument("--machines", nargs="+", default=MACHINES)
    parser.add_argument("--size", type=int, default=256, help="pixels along a side")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument(
        "--patience", type=float, default=1000.0, help="contenders slower by more are left out"
    )
    arguments = parser.parse_args()
    adapter = open_device().adapter
    print(f"adapter: {adapter}; {adapter.description} (another one: {ADAPTER_VARIABLE})")
    rows = [("scene", "rays", "contender", "Mrays/s", "times the CPU", "differ")]
    for name in arguments.scenes:
        for row in measure(name, arguments):
            rows.append(row)
            print(*row, sep="  ", flush=True)
    widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
    rule = " ".join("=" * width for width in widths)
    print()
    for k, row in enumerate(rows):
        if k < 2:
            print(rule)
        print(" ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip())
    print(rule)


if __name__ == "__main__":
    main()

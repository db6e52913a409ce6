"""Compiling the engine: how long the first use of each kernel takes, without and with the cache.

    python benchmarks/compile.py --runs 3

A child process with an empty cache builds a small scene with each quality and traces a batch with
each kernel and query; another process does the same with the kernels that the first has compiled.
Prints the seconds of each step of both: with nothing compiled, and loaded from the cache.
"""

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np


def steps():
    """Seconds of each step, in the order in which a user would wait for them."""
    took = {}

    def run(name, step):
        started = time.perf_counter()
        result = step()
        took[name] = time.perf_counter() - started
        return result

    def load():
        import raystream

        return raystream, raystream.load("cornell")

    rs, scene = run("import, scene", load)
    from raystream.structures.bvh.batches import KERNELS

    # Enough rays for a probe of their coherence, and more than are traced singly.
    origins, directions = scene.camera.rays(64, 64)
    rays = np.float32(origins), np.float32(directions)
    for quality in ("balanced", "fast"):
        run(f"build, {quality}", lambda quality=quality: rs.Tracer(scene, quality=quality))
    for kernel in KERNELS:
        tracer = rs.Tracer(scene, kernel=kernel)
        run(f"first_hit, {kernel}", lambda tracer=tracer: tracer.first_hit(*rays))
        run(f"any_hit, {kernel}", lambda tracer=tracer: tracer.any_hit(*rays))
        run(f"multi_hit, {kernel}", lambda tracer=tracer: tracer.multi_hit(*rays))
        run(f"count_hits, {kernel}", lambda tracer=tracer: tracer.count_hits(*rays))
    parts = [mesh.vertices + 1.0 for mesh in scene.meshes]
    run("update", lambda: tracer.update(parts))
    return took


def child(folder):
    environment = {**os.environ, "RAYSTREAM_CACHE_DIR": str(folder)}
    command = [sys.executable, __file__, "--child"]
    started = time.perf_counter()
    done = subprocess.run(command, env=environment, check=True, stdout=subprocess.PIPE, text=True)
    return {**json.loads(done.stdout), "whole process": time.perf_counter() - started}


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--runs", type=int, default=1, help="runs, each with an empty cache")
    parser.add_argument("--child", action="store_true", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.child:
        print(json.dumps(steps()))
        return
    cold, warm = [], []
    with tempfile.TemporaryDirectory() as parent:
        for run in range(arguments.runs):
            folder = Path(parent) / str(run)
            cold.append(child(folder))
            warm.append(child(folder))
        size = sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())
    print(f"{'seconds':26s} {'compiled':>9s} {'loaded':>9s}")
    for name in cold[0]:
        one, other = (statistics.median(run[name] for run in runs) for runs in (cold, warm))
        print(f"{name:26s} {one:9.3f} {other:9.3f}")
    print(f"the cache: {size / 2**20:.1f} MiB")


if __name__ == "__main__":
    main()

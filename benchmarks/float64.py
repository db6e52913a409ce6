"""First and any hits in float64 against float32, each in its own process, in turn.

    python benchmarks/float64.py
    python benchmarks/float64.py sponza --rounds 9 --threads 1

The rays are those of the scene's camera (coherent), one bounce of them in a random direction, and
rays from anywhere in the scene's box (incoherent); all are float32. Times are medians of whole
calls in nanoseconds per ray: of wall-clock time, and of the processor time of all threads, which
other programs disturb less. Processes that wait are stopped.
"""

import argparse
import json
import os
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

import raystream as rs

PRECISIONS = ("float32", "float64")
SETS = ("camera", "bounce", "random")


def ray_sets(scene: rs.Scene) -> dict[str, np.ndarray]:
    """Rays of shape (2, N, 3): origins and directions."""
    rng = np.random.default_rng(0)
    tracer = rs.Tracer(scene)
    origins, directions = scene.camera.rays(1024, 768)
    hits = tracer.first_hit(origins, directions)
    ways = rng.normal(size=(*hits.t.shape, 3))
    ways = np.where((ways * hits.normals).sum(axis=-1, keepdims=True) < 0.0, -ways, ways)
    starts, ways = hits.spawn(ways)
    low, high = scene.bounds
    anywhere = low + (high - low) * rng.random((1 << 19, 3))
    around = rng.normal(size=(1 << 19, 3))
    pairs = (
        (np.broadcast_to(origins, directions.shape).reshape(-1, 3), directions.reshape(-1, 3)),
        (starts[hits.is_hit], ways[hits.is_hit]),
        (anywhere, around),
    )
    return {name: np.array(pair, np.float32) for name, pair in zip(SETS, pairs, strict=True)}


def work(name: str, precision: str, arrays: str, threads: int) -> None:
    """A contender's process: build, then time a query for each line of input."""
    rs.set_thread_count(threads)
    tracer = rs.Tracer(rs.load(name), precision=precision)
    rays = np.load(arrays)
    rays = {key: rays[key] for key in rays.files}
    print(json.dumps(tracer.structure.report.byte_count), flush=True)
    for line in sys.stdin:
        query, key = json.loads(line)
        origins, directions = rays[key]
        wall, processor = time.perf_counter(), time.process_time()
        getattr(tracer, query)(origins, directions)
        wall, processor = time.perf_counter() - wall, time.process_time() - processor
        count = len(origins) / 1e9
        print(json.dumps([wall / count, processor / count]), flush=True)


def compare(name: str, rounds: int, threads: int) -> None:
    """Print the times of a scene."""
    with tempfile.TemporaryDirectory() as folder:
        arrays = Path(folder) / "rays.npz"
        np.savez(arrays, **ray_sets(rs.load(name)))
        command = [sys.executable, __file__, name, "--threads", str(threads)]
        processes = {}
        for precision in PRECISIONS:
            arguments = [*command, "--work", precision, str(arrays)]
            pipe = subprocess.PIPE
            processes[precision] = subprocess.Popen(arguments, stdin=pipe, stdout=pipe, text=True)
            megabytes = json.loads(processes[precision].stdout.readline()) / 2**20
            print(f"{name}, {precision}: {megabytes:.1f} MB")
            os.kill(processes[precision].pid, signal.SIGSTOP)
        for query in ("first_hit", "any_hit"):
            for key in SETS:
                times = {precision: [] for precision in PRECISIONS}
                for _ in range(rounds + 2):  # the first two warm up, and choose kernels
                    for precision, process in processes.items():
                        os.kill(process.pid, signal.SIGCONT)
                        process.stdin.write(json.dumps([query, key]) + "\n")
                        process.stdin.flush()
                        times[precision].append(json.loads(process.stdout.readline()))
                        os.kill(process.pid, signal.SIGSTOP)
                report(name, query, key, times)
        for process in processes.values():
            os.kill(process.pid, signal.SIGCONT)
            process.stdin.close()
            process.wait()


def report(name: str, query: str, key: str, times: dict[str, list[list[float]]]) -> None:
    """Print the medians of a query."""
    medians = {p: np.median(np.array(rows[2:]), axis=0) for p, rows in times.items()}
    wall, processor = medians["float64"] / medians["float32"]
    of_rounds = [b[0] / a[0] for a, b in zip(*(rows[2:] for rows in times.values()), strict=True)]
    print(
        f"{name:12} {query:10} {key:8}"
        f" {medians['float32'][0]:6.0f} {medians['float64'][0]:6.0f} ns  x {wall:4.2f}"
        f"  processor {medians['float32'][1]:6.0f} {medians['float64'][1]:6.0f} ns"
        f"  x {processor:4.2f}  (rounds' median x {statistics.median(of_rounds):4.2f})",
        flush=True,
    )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scenes", nargs="*", default=["bunny", "conference", "sponza"])
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--threads", type=int, default=os.cpu_count())
    parser.add_argument("--work", nargs=2, help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.work:
        work(given.scenes[0], *given.work, given.threads)
    else:
        for scene in given.scenes:
            compare(scene, given.rounds, given.threads)

"""Simulated caches: how many references of a trace they process per second.

    python benchmarks/cache_speed.py --references 20 --billion

The traces are synthetic: random words in 4 MB, in which nearly every access misses a cache of 64
KB; random words in 48 MB; and one like a ray tracer's, in which neighbouring rays read a cell, an
entry of its list and a triangle's three vertices, 12 bytes each. Prints hit rates, and references
per second, both in wall-clock time and in the thread's processor time, which other programs on the
machine disturb less. With --billion, a billion references of the last kind go through a cache and
through the measurement of reuse distances, in chunks. Then it prints the process's peak memory
after the first 20 million, and its growth until the end.
"""

import argparse
import multiprocessing
import resource
import time

import numpy as np

from raystream_lab.caches import Cache, ReuseDistances

MILLION = 1_000_000
CHUNK, CHUNK_COUNT = MILLION, 20
KINDS = ("cells", "lists", "vertices")

#: Where the arrays of the ray tracer's trace begin.
LISTS, VERTICES = np.uint64(1 << 28), np.uint64(1 << 30)


def random_words(rng, count, size):
    return rng.integers(0, size // 4, count, dtype=np.uint64) * np.uint64(4), 0, 4


def like_rays(rng, count, triangle_count=200_000):
    """Steps near the previous one, and one in fifty to a random place."""
    steps = count // 5
    place = np.cumsum(rng.normal(0.0, 8.0, steps))
    jumps = np.cumsum(np.where(rng.random(steps) < 0.02, rng.integers(0, triangle_count, steps), 0))
    triangle = np.mod(place + jumps, triangle_count).astype(np.uint64)
    addresses = np.empty((steps, 5), np.uint64)
    addresses[:, 0] = triangle // np.uint64(2) * np.uint64(4)
    addresses[:, 1] = LISTS + triangle * np.uint64(4)
    corners = np.arange(0, 36, 12, dtype=np.uint64)
    addresses[:, 2:] = VERTICES + triangle[:, None] * np.uint64(36) + corners
    kinds = np.tile(np.array([0, 1, 2, 2, 2], np.uint8), steps)
    lengths = np.tile(np.array([4, 4, 12, 12, 12], np.uint8), steps)
    return addresses.ravel(), kinds, lengths


def simulators():
    return {
        "64 KB, direct-mapped": Cache(64 * 1024, 48, 1, kinds=KINDS),
        "64 KB, 4 ways": Cache(64 * 1024, 48, 4, kinds=KINDS),
        "64 KB, 16 ways": Cache(64 * 1024, 48, 16, kinds=KINDS),
        "64 KB, fully associative": Cache(64 * 1024, 48, None, kinds=KINDS),
        "reuse distances": ReuseDistances(48, kinds=KINDS),
    }


def total_of(simulator):
    if isinstance(simulator, Cache):
        return simulator.total
    first, *others = simulator.counts(64 * 1024).values()
    return sum(others, first)


def peak_memory():
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


def feed(simulator, trace):
    """Seconds of wall-clock time and of the thread's processor time."""
    clock, thread = time.perf_counter(), time.thread_time()
    simulator.access(*trace)
    return np.array([time.perf_counter() - clock, time.thread_time() - thread])


def speeds(rng, count, runs):
    traces = {
        "random, 4 MB": random_words(rng, count, 4 << 20),
        "random, 48 MB": random_words(rng, count, 48 << 20),
        "like rays": like_rays(rng, count),
    }
    print(f"{'million references per s':28s} {'trace':14s} {'clock':>8s} {'thread':>8s}   hit rate")
    for trace_name, trace in traces.items():
        for name, simulator in simulators().items():
            feed(simulator, trace)  # compiles, and warms up
            seconds = np.min([feed(simulator, trace) for _ in range(runs)], axis=0)
            rates = " ".join(f"{rate:8.1f}" for rate in len(trace[0]) / seconds / MILLION)
            print(f"{name:28s} {trace_name:14s} {rates}   {total_of(simulator).hit_rate:.2%}")


def long_run(name, count):
    """Rates, peak memory after the first chunks and at the end, and lines; in a new process."""
    rng = np.random.default_rng(2002)
    chunks = [like_rays(rng, CHUNK) for _ in range(CHUNK_COUNT)]
    simulator = simulators()[name]
    for chunk in chunks:
        feed(simulator, chunk)
    before, seconds, done = peak_memory(), np.zeros(2), 0
    while done < count:
        seconds += feed(simulator, chunks[done // CHUNK % CHUNK_COUNT])
        done += CHUNK
    return done / seconds / MILLION, before, peak_memory(), getattr(simulator, "line_count", "")


def billion(count):
    print(
        f"\n{'a billion, like rays':28s} {'clock':>8s} {'thread':>8s}    peak memory         lines"
    )
    for name in ("64 KB, direct-mapped", "reuse distances"):
        # A new process has not yet used more memory than this run will need.
        with multiprocessing.get_context("spawn").Pool(1) as pool:
            rates, before, after, lines = pool.apply(long_run, (name, count))
        both = " ".join(f"{rate:8.1f}" for rate in rates)
        grew = f"{before / 1e6:.1f} + {(after - before) / 1e6:.1f} MB"
        print(f"{name:28s} {both}    {grew:18s}  {lines}", flush=True)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--references", type=float, default=20.0, help="of each trace, in millions")
    parser.add_argument("--runs", type=int, default=3, help="runs, of which the fastest counts")
    parser.add_argument("--billion", action="store_true", help="do the long runs as well")
    arguments = parser.parse_args()
    rng = np.random.default_rng(2002)
    if arguments.references > 0:
        speeds(rng, int(arguments.references * MILLION), arguments.runs)
    if arguments.billion:
        billion(1000 * MILLION)


if __name__ == "__main__":
    main()

"""How much faster two workers with one thread each are than one worker.

    python benchmarks/cluster.py bunny --rays 20000000

Two clusters on this machine, one with one worker and one with two, take turns. Rays are generated
on the workers: they start on a sphere around the scene and go to random points in its box, so they
are incoherent. Their first hits are also counted there. Then an image is rendered, whose light is
sent back to this process. Prints median times in seconds, their ratio, and the processor time that
the workers used. The latter shows how much other programs on the machine changed the ratio: on an
idle machine with two cores, the speed-up is twice the ratio of the processor times.
"""

import argparse
import logging
import os
import statistics
import time

import dask.array as da
import numpy as np
from distributed import Client, LocalCluster

import raystream as rs


def make_rays(low, high, block_info=None):
    """A chunk of rays, shape (N, 6): origins and directions."""
    begin, end = block_info[None]["array-location"][0]
    numbers = np.random.default_rng(begin)
    middle, radius = (low + high) / 2, np.linalg.norm(high - low)
    away = numbers.standard_normal((end - begin, 3), np.float32)
    away /= np.linalg.norm(away, axis=1, keepdims=True)
    origins = middle + away * radius
    targets = low + numbers.random((end - begin, 3), np.float32) * (high - low)
    return np.concatenate([origins, targets - origins], axis=1).astype(np.float32)


def lazy_rays(scene, count, chunk):
    """Origins and directions that have not been computed yet."""
    low, high = scene.bounds.astype(np.float32)
    lengths = da.core.normalize_chunks((chunk, 6), (count, 6))
    meta = np.empty((0, 6), np.float32)
    rays = da.map_blocks(make_rays, low, high, chunks=lengths, dtype=np.float32, meta=meta)
    return rays[:, :3], rays[:, 3:]


def processor_seconds(client):
    """Processor time of all workers together, in seconds."""
    return sum(client.run(time.process_time).values())


def take_turns(work, clients, repeats):
    """Medians of seconds and of processor seconds, by number of workers."""
    seconds = {count: [] for count in clients}
    used = {count: [] for count in clients}
    for repeat in range(repeats + 1):
        for count, client in clients.items():
            before, began = processor_seconds(client), time.perf_counter()
            result = work(client)
            if repeat:  # the first run loads kernels and the scene
                seconds[count].append(time.perf_counter() - began)
                used[count].append(processor_seconds(client) - before)
            last = result
    return (
        {count: statistics.median(times) for count, times in seconds.items()},
        {count: statistics.median(times) for count, times in used.items()},
        last,
    )


def report(what, seconds, used):
    """Print a line of figures."""
    print(
        f"{what}: 1 worker {seconds[1]:.2f} s, 2 workers {seconds[2]:.2f} s: "
        f"{seconds[1] / seconds[2]:.2f} x; processor {used[1]:.2f} s and {used[2]:.2f} s: "
        f"at best {2 * used[1] / used[2]:.2f} x"
    )


def main():
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("scene", nargs="?", default="bunny")
    parser.add_argument("--rays", type=int, default=20_000_000)
    parser.add_argument("--chunk", type=int, default=500_000)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--mode", default="path")
    parser.add_argument("--size", default="1024x768")
    parser.add_argument("--samples", type=int, default=32)
    asked = parser.parse_args()
    scene = rs.load(asked.scene)
    size = tuple(int(length) for length in asked.size.split("x"))
    local = {"dashboard_address": "127.0.0.1:0", "worker_dashboard_address": "127.0.0.1:0"}
    local |= {"host": "127.0.0.1", "silence_logs": logging.ERROR, "threads_per_worker": 1}
    print(f"load of the machine: {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores")
    with (
        LocalCluster(n_workers=1, **local) as one,
        LocalCluster(n_workers=2, **local) as two,
        Client(one) as first,
        Client(two) as second,
    ):
        clients = {1: first, 2: second}
        tracers = {id(c): rs.cluster.Tracer(scene, c) for c in clients.values()}
        rays = lazy_rays(scene, asked.rays, asked.chunk)

        def count(client):
            hits = tracers[id(client)].first_hit(*rays)
            return client.compute(hits.is_hit.sum()).result()

        seconds, used, found = take_turns(count, clients, asked.repeats)
        report(f"{asked.rays:,} incoherent rays, {found:,} hits", seconds, used)
        local_tracer = rs.Tracer(scene)
        arguments = {"mode": asked.mode, "size": size, "samples": asked.samples}

        def picture(client):
            return rs.cluster.render(local_tracer, client=client, **arguments)

        seconds, used, _ = take_turns(picture, clients, asked.repeats)
        what = f"{asked.mode}, {asked.size}, {asked.samples} samples"
        report(what, seconds, used)
    print(f"load of the machine: {os.getloadavg()[0]:.1f}")


if __name__ == "__main__":
    main()

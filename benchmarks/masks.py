"""The time of queries with masks that all rays pass, against the same queries without.

    python benchmarks/masks.py
    python benchmarks/masks.py --rounds 15 --rays 100000

Each ray has a mask, and two meshes have different ones that it has bits of. A third is behind the
camera, and half of the rays lack its bit: each hit is asked for. They do not lack it where it says
"free": then no hit is. Queries with and without take turns. Prints medians of the rounds, in
processor time of one thread.
"""

import argparse
import statistics
import time

import numpy as np

import raystream as rs

QUERIES = ("first_hit", "any_hit", "count_hits", "multi_hit")
KERNELS = ("packet", "groups", "wavefront", "single")


def scenes():
    """Meshes of two masks, and a triangle of a third one; and the same, placed 64 times."""
    whole = rs.load("boxes")
    half = len(whole.meshes) // 2
    meshes = [one.with_mask(1 if k < half else 2) for k, one in enumerate(whole.meshes)]
    low, high = whole.bounds
    eye, ahead = (np.asarray(at, float) for at in (whole.camera.eye, whole.camera.look_at))
    behind = eye + 0.2 * (eye - ahead) + 1e-3 * (high - low).max() * np.eye(3)
    scene = whole.replace(meshes=[*meshes, rs.Mesh(behind, [[0, 1, 2]], mask=4)])
    places = np.tile(np.eye(3, 4), (65, 1, 1))
    places[:64, 0, 3], places[:64, 2, 3] = np.divmod(np.arange(64), 8) * (high - low)[[0, 2], None]
    places[64, 1, 3] = 1e3 * (high - low).max()
    instances = rs.Scene.instances(whole, places, masks=[*(1 + np.arange(64) % 2), 4])
    return {"boxes": scene, "boxes, 64 instances": instances}


def main():
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--rounds", type=int, default=9)
    parser.add_argument("--rays", type=int, default=65_536)
    options = parser.parse_args()
    side = int(options.rays**0.5)
    masks = np.full(side * side, 3, np.uint32)
    masks[::2] = 7
    given = {"without": {}, "with": {"mask": masks}, "free": {"mask": masks | 7}}
    for name, scene in scenes().items():
        origins, directions = scene.camera.rays(side, side)
        rays = np.broadcast_to(origins, directions.shape).reshape(-1, 3), directions.reshape(-1, 3)
        for kernel in KERNELS:
            tracer = rs.Tracer(scene, kernel=kernel)
            for query in QUERIES:
                ask = getattr(tracer, query)
                times = {label: [] for label in given}
                for _ in range(options.rounds + 1):
                    for label, mask in given.items():
                        started = time.thread_time()
                        ask(*rays, **mask)
                        times[label].append(time.thread_time() - started)
                without, *others = (statistics.median(one[1:]) for one in times.values())
                ratio, free = (one / without for one in others)
                told = f"{1e3 * without:.1f} ms, with masks {ratio:.3f}, free {free:.3f}"
                print(f"{name}, {kernel}, {query}: {told}", flush=True)


if __name__ == "__main__":
    main()

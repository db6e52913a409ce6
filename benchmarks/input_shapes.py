"""Time per ray of the same rays in the array shapes that users pass.

    python benchmarks/input_shapes.py bunny kitchen --size 1024x768

Measures first hits of a camera's rays in twelve arrangements, and of rays in random order.
Contenders take turns, and the median of the rounds counts. The ratio is to the fastest contender
with the same rays: the camera's in the order of rows or tiles; ten million, whose pixels are
flatter; and in random order, where it is to the fastest kernel. Times of a thousand rays, and of
one, are given in microseconds, as latency.
"""

import argparse
import statistics
import time

import numpy as np

import raystream as rs

#: Minimum number of rays in the large batches.
MANY = 10_000_000


def tiled(array):
    """Rays in the order of tiles of 16 x 16 pixels."""
    height, width, _ = array.shape
    tiles = array.reshape(height // 16, 16, width // 16, 16, 3).swapaxes(1, 2)
    return np.ascontiguousarray(tiles).reshape(-1, 3)


def arrangements(camera, width, height):
    """Yield (name, group, origins, directions); groups are compared with each other."""
    origins, directions = camera.rays(width, height)
    directions = np.ascontiguousarray(directions, np.float32)
    eye = np.asarray(origins, np.float32).reshape(-1, 3)[0].copy()
    origins = np.ascontiguousarray(np.broadcast_to(eye, directions.shape))
    both = origins, directions
    records = np.zeros((height, width, 8), np.float32)
    records[..., :3], records[..., 4:7] = both
    flat = [one.reshape(-1, 3) for one in both]
    order = np.random.default_rng(0).permutation(width * height)
    yield "image", "rows", *both
    yield "flat", "rows", *flat
    yield "strided", "rows", records[..., :3], records[..., 4:7]
    yield "float64", "rows", *(one.astype(np.float64) for one in both)
    yield "one origin", "rows", eye, directions
    yield "transposed", "rows", *(one.transpose(1, 0, 2) for one in both)
    yield "tiled", "rows", *map(tiled, both)
    rows = -(-MANY // width)
    large = np.ascontiguousarray(camera.rays(width, rows)[1], np.float32)
    yield "10 million", "many", eye, large.reshape(-1, 3)
    yield "10 million, image", "many", eye, large
    yield "random order", "random", *(one[order] for one in flat)
    yield "1,000 rays", "few", *(one[:1000] for one in flat)
    yield "1 ray", "few", *(one[:1] for one in flat)


def with_holes(tracer, camera, width, height):
    """Yield the rays of pixels with a hit: as a list, and in the order of tiles."""
    origins, directions = camera.rays(width, height)
    directions = np.ascontiguousarray(directions, np.float32)
    eye = np.asarray(origins, np.float32).reshape(-1, 3)[0].copy()
    is_hit = tracer.first_hit(eye, directions).is_hit
    yield "holes", "holes", eye, directions[is_hit]
    keep = tiled(np.repeat(is_hit[..., None], 3, axis=2))[:, 0]
    yield "holes, tiled", "holes", eye, tiled(directions)[keep]


def measure(scene, width, height, rounds):
    """Print the table of a scene."""
    tracer = rs.Tracer(scene)
    camera = scene.camera_for(width / height)
    batches = [
        *arrangements(camera, width, height),
        *with_holes(tracer, camera, width, height),
    ]
    contenders = [(name, group, tracer, rays) for name, group, *rays in batches]
    unordered = next(rays for name, _, *rays in batches if name == "random order")
    for kernel in ("groups", "wavefront"):
        other = rs.Tracer(scene, kernel=kernel)
        contenders.append((f"random order, {kernel}", "random", other, unordered))
    seconds = [[] for _ in contenders]
    for number in range(rounds + 2):
        for times, (_, _, one, rays) in zip(seconds, contenders, strict=True):
            started = time.perf_counter()
            one.first_hit(*rays)
            if number > 1:
                times.append(time.perf_counter() - started)
    rates, best = [], {}
    for (_, group, _, rays), times in zip(contenders, seconds, strict=True):
        rate = statistics.median(times) / (rays[1].size // 3)
        rates.append(rate)
        best[group] = min(rate, best.get(group, rate))
    print(f"{'input':26s} {'ns per ray':>10s} {'ratio':>6s}")
    for (name, group, _, rays), rate in zip(contenders, rates, strict=True):
        if group == "few":
            print(f"{name:26s} {rate * 1e6 * (rays[1].size // 3):8.1f} us")
        else:
            print(f"{name:26s} {rate * 1e9:10.2f} {rate / best[group]:6.2f}")


def main():
    """Measure the scenes given on the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scenes", nargs="*", default=["bunny"])
    parser.add_argument("--size", default="1024x768", help="multiples of 16 [default: 1024x768]")
    parser.add_argument("--rounds", type=int, default=7)
    options = parser.parse_args()
    width, height = map(int, options.size.split("x"))
    for name in options.scenes:
        print(f"{name}, {width} x {height}")
        measure(rs.load(name), width, height, options.rounds)


if __name__ == "__main__":
    main()

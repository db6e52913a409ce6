"""Spheres against Mitsuba's, and height fields against the mesh of the same triangles.

    python benchmarks/primitives.py
    python benchmarks/primitives.py --compared 10000 --side 1000 --rounds 9

Each contender runs in its own process; they take turns, round by round. Prints medians in millions
of rays per second, and the median and range of their ratios. Memory is what a process holds after
the build, beyond what it held before, and its peak during the build. The rays are those of a
camera, in rows, and rays in random directions from random places in the scene. Mitsuba needs
minutes and 18 GB for a million spheres, so it is given fewer. Needs mitsuba and libLLVM.
"""

from __future__ import annotations

import argparse
import json
import resource
import statistics
import subprocess
import sys
import time
from collections.abc import Callable
from typing import Any

import numpy as np

import raystream as rs

SIZE = (640, 480)
QUERIES = ("first_hit", "any_hit")

Rays = tuple[np.ndarray, np.ndarray]


def resident() -> float:
    """Megabytes that this process holds now."""
    with open("/proc/self/statm", encoding="ascii") as numbers:
        return int(numbers.read().split()[1]) * resource.getpagesize() / 1e6


def balls(count: int) -> tuple[np.ndarray, float]:
    """Centres in a cube, and a radius at which about half of the rays from inside hit a sphere."""
    rng = np.random.default_rng(0)
    return rng.uniform(-1.0, 1.0, (count, 3)).astype(np.float32), 1.6 / count**0.5


def hills(side: int) -> np.ndarray:
    """Heights in float32, smooth and rough."""
    at = np.arange(side) / 60.0
    smooth = np.sin(at)[:, None] * np.cos(0.7 * at) + 0.3 * np.sin(3.0 * at[:, None] + 2.0 * at)
    return (60.0 * smooth + np.random.default_rng(0).random((side, side))).astype(np.float32)


def camera_rays(camera: rs.Camera) -> Rays:
    """The rays of an image, float32."""
    origins, directions = camera.rays(*SIZE)
    origins = np.broadcast_to(origins, directions.shape).reshape(-1, 3)
    return np.ascontiguousarray(origins, np.float32), directions.reshape(-1, 3).astype(np.float32)


def rays_within(low: Any, high: Any) -> Rays:
    """Rays in random directions from random places in a box, float32."""
    rng = np.random.default_rng(1)
    origins = rng.uniform(low, high, (SIZE[0] * SIZE[1], 3))
    return origins.astype(np.float32), rng.normal(size=origins.shape).astype(np.float32)


def sphere_rays(count: int) -> dict[str, Rays]:
    """Rays by name."""
    del count
    camera = rs.Camera((0.0, 0.0, 4.0), (0.0, 0.0, 0.0))
    return {"camera": camera_rays(camera), "random": rays_within([-1] * 3, [1] * 3)}


def terrain_rays(side: int) -> dict[str, Rays]:
    """Rays by name."""
    camera = rs.Camera((side / 2, -side / 5, side / 3), (side / 2, side / 2, 0.0), up=(0, 0, 1))
    low, high = [0.0, 0.0, -60.0], [side, side, 120.0]
    return {"camera": camera_rays(camera), "random": rays_within(low, high)}


class Ours:
    """A tracer of a scene."""

    def __init__(self, make: Callable[[], rs.Tracer]) -> None:
        self.tracer = make()
        self.rays = lambda origins, directions: (origins, directions)

    def first_hit(self, rays: Rays) -> float:
        return float(self.tracer.first_hit(*rays).is_hit.mean())

    def any_hit(self, rays: Rays) -> float:
        return float(self.tracer.any_hit(*rays).mean())


def our_spheres(count: int) -> Ours:
    centers, radius = balls(count)
    return Ours(lambda: rs.Tracer(rs.Scene.spheres(centers, radius)))


def our_field(side: int) -> Ours:
    heights = hills(side)
    return Ours(lambda: rs.Tracer(rs.Scene.height_field(heights)))


def our_mesh(side: int) -> Ours:
    heights = hills(side)
    return Ours(lambda: rs.terrain(heights).tracer)


class MitsubaSpheres:
    """Mitsuba's own spheres, in its tree for them, with its own arrays."""

    def __init__(self, count: int) -> None:
        import drjit
        import mitsuba

        mitsuba.set_variant("llvm_ad_rgb")
        self.mi, self.dr = mitsuba, drjit
        centers, radius = balls(count)
        shape: dict[str, Any] = {"type": "scene"}
        for k, center in enumerate(centers.tolist()):
            shape[f"s{k}"] = {"type": "sphere", "center": center, "radius": radius}
        self.scene = mitsuba.load_dict(shape)

    def rays(self, origins: np.ndarray, directions: np.ndarray) -> Any:
        mi, unravel = self.mi, self.dr.unravel
        points, vectors = (mi.Float(np.ravel(one)) for one in (origins, directions))
        rays = mi.Ray3f(unravel(mi.Point3f, points), unravel(mi.Vector3f, vectors))
        self.dr.eval(rays)
        self.dr.sync_thread()
        return rays

    def first_hit(self, rays: Any) -> float:
        t = self.scene.ray_intersect_preliminary(rays, coherent=False).t
        self.dr.eval(t)
        self.dr.sync_thread()
        return float(np.isfinite(np.array(t)).mean())

    def any_hit(self, rays: Any) -> float:
        seen = self.scene.ray_test(rays)
        self.dr.eval(seen)
        self.dr.sync_thread()
        return float(np.array(seen).mean())


CONTENDERS: dict[str, tuple[Callable[[int], Any], Callable[[int], dict[str, Rays]]]] = {
    "spheres": (our_spheres, sphere_rays),
    "Mitsuba": (MitsubaSpheres, sphere_rays),
    "field": (our_field, terrain_rays),
    "mesh": (our_mesh, terrain_rays),
}


def contend(name: str, size: int) -> None:
    """A contender's process: build, then time a query for each line of input."""
    make, ray_sets = CONTENDERS[name]
    if name != "Mitsuba":
        make(50).first_hit(ray_sets(50)["random"])  # compiles
    before, started = resident(), time.perf_counter()
    contender = make(size)
    took = time.perf_counter() - started
    held = resident() - before
    most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / 1e6
    peak = max(most - before, held)
    rays = {key: contender.rays(*some) for key, some in ray_sets(size).items()}
    print(json.dumps({"build": took, "memory": held, "peak": peak}), flush=True)
    for line in sys.stdin:
        key, query = line.split()
        started = time.perf_counter()
        share = getattr(contender, query)(rays[key])
        print(json.dumps({"seconds": time.perf_counter() - started, "share": share}), flush=True)


def compare(names: tuple[str, ...], size: int, rounds: int) -> None:
    """Let the contenders take turns, and print a table."""
    command = [sys.executable, __file__, "--size", str(size), "--contender"]
    running = {}
    for name in names:
        running[name] = process = subprocess.Popen(
            [*command, name], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        assert process.stdout is not None
        built = json.loads(process.stdout.readline())
        print(
            f"{name}: {size:,}; {built['build']:.2f} s to build, {built['memory']:,.0f} MB, "
            f"at most {built['peak']:,.0f} MB",
            flush=True,
        )
    count = SIZE[0] * SIZE[1]
    print(f"{'rays':8} {'query':10} " + " ".join(f"{name:>10}" for name in running), end="")
    print("  Mrays/s; ratio (range)")
    for key in ("camera", "random"):
        for query in QUERIES:
            times: dict[str, list[float]] = {name: [] for name in running}
            shares = {}
            for _ in range(rounds + 1):
                for name, process in running.items():
                    assert process.stdin is not None
                    assert process.stdout is not None
                    process.stdin.write(f"{key} {query}\n")
                    process.stdin.flush()
                    answer = json.loads(process.stdout.readline())
                    times[name].append(answer["seconds"])
                    shares[name] = answer["share"]
            kept = {name: some[1:] for name, some in times.items()}  # the first round compiles
            rates = " ".join(f"{count / statistics.median(t) / 1e6:10.2f}" for t in kept.values())
            first, last = kept[names[0]], kept[names[-1]]
            ratios = [b / a for a, b in zip(first, last, strict=True)]
            print(
                f"{key:8} {query:10} {rates}  {statistics.median(ratios):.2f} "
                f"({min(ratios):.2f} to {max(ratios):.2f}); hit: "
                + ", ".join(f"{share:.3%}" for share in shares.values()),
                flush=True,
            )
    for process in running.values():
        assert process.stdin is not None
        process.stdin.close()
        process.wait()


def main() -> None:
    """Print both tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--spheres", type=int, default=1_000_000)
    parser.add_argument("--compared", type=int, default=100_000, help="spheres against Mitsuba")
    parser.add_argument("--side", type=int, default=4000, help="samples along each side")
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--only", choices=("spheres", "terrain"))
    parser.add_argument("--size", type=int, help=argparse.SUPPRESS)
    parser.add_argument("--contender", choices=CONTENDERS, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.contender:
        contend(options.contender, options.size)
        return
    if options.only != "terrain":
        compare(("spheres", "Mitsuba"), options.compared, options.rounds)
        compare(("spheres",), options.spheres, options.rounds)
    if options.only != "spheres":
        compare(("field", "mesh"), options.side, options.rounds)


if __name__ == "__main__":
    main()

"""A forest of a billion instanced triangles: raystream against Mitsuba's shape groups.

    python benchmarks/instances.py
    python benchmarks/instances.py --rounds 9 --side 32

A patch of trees is placed 4,096 times, rotated and mirrored. Each contender is a process that waits
while the other traces; they take turns, round by round. Prints medians of the rounds, and the
median and range of their ratios; the better of Mitsuba's two hints counts. If other programs are
running, the ratio of the processor times of all threads is more meaningful. The rays are those of a
camera above the trees, in rows, and rays in random directions from random places among the trees.
Needs mitsuba and libLLVM.
"""

from __future__ import annotations

import argparse
import json
import resource
import statistics
import subprocess
import sys
import time
from typing import Any

import numpy as np

import raystream as rs

SIZE = (1024, 576)
QUERIES = ("first_hit", "any_hit")


def forest(side: int) -> tuple[rs.Scene, np.ndarray]:
    """A patch of trees, and the transforms that place it."""
    patch = rs.load("forest", triangles=280_000)
    trees = patch.replace(meshes=patch.meshes[1:])
    low, high = trees.bounds
    pitch = 0.86 * (high - low)[[0, 2]]
    rng = np.random.default_rng(7)
    quarter, mirror = rng.integers(0, 2, (2, side * side))
    cosines, signs = 1.0 - quarter, 1.0 - 2.0 * mirror
    places = np.zeros((side * side, 3, 4))
    places[:, 0, 0], places[:, 0, 2] = signs * cosines, quarter
    places[:, 2, 0], places[:, 2, 2] = -signs * quarter, cosines
    places[:, 1, 1] = 1.0
    rows, columns = np.divmod(np.arange(side * side), side)
    places[:, 0, 3], places[:, 2, 3] = rows * pitch[0], columns * pitch[1]
    places[:, :, 3] -= places[:, :, :3] @ ((low + high) / 2 * [1, 0, 1])
    return trees, places


def ray_sets(places: np.ndarray) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Rays by name, float32."""
    far = places[:, :, 3].max(axis=0)
    camera = rs.Camera((0.2 * far[0], 55.0, 0.15 * far[2]), (0.7 * far[0], -60.0, 0.75 * far[2]))
    origins, directions = camera.rays(*SIZE)
    directions = np.ascontiguousarray(directions.reshape(-1, 3), np.float32)
    origins = np.broadcast_to(origins, (*SIZE[::-1], 3)).reshape(-1, 3)
    rng = np.random.default_rng(8)
    inside = rng.uniform([0, 0, 0], [far[0], 20.0, far[2]], directions.shape)
    around = rng.normal(size=directions.shape)
    around /= np.linalg.norm(around, axis=1, keepdims=True)
    return {
        "camera": (np.ascontiguousarray(origins, np.float32), directions),
        "random": (inside.astype(np.float32), around.astype(np.float32)),
    }


class Ours:
    """raystream with NumPy arrays."""

    modes = ("",)

    def __init__(self, trees: rs.Scene, places: np.ndarray) -> None:
        self.tracer = rs.Tracer(rs.Scene.instances(trees, places))

    def rays(self, origins: np.ndarray, directions: np.ndarray) -> Any:
        return origins, directions

    def first_hit(self, rays: Any, mode: str) -> float:  # noqa: ARG002
        return float(self.tracer.first_hit(*rays).is_hit.mean())

    def any_hit(self, rays: Any, mode: str) -> float:  # noqa: ARG002
        return float(self.tracer.any_hit(*rays).mean())


class Mitsuba:
    """Mitsuba's Embree with its own arrays, and with both of its hints."""

    modes = ("incoherent", "coherent")

    def __init__(self, trees: rs.Scene, places: np.ndarray) -> None:
        import drjit
        import mitsuba

        mitsuba.set_variant("llvm_ad_rgb")
        self.mi, self.dr = mitsuba, drjit
        group: dict[str, Any] = {"type": "shapegroup"}
        for k, mesh in enumerate(trees.meshes):
            shape = mitsuba.Mesh(f"mesh{k}", len(mesh.vertices), len(mesh.faces))
            parts = mitsuba.traverse(shape)
            parts["vertex_positions"] = np.ascontiguousarray(mesh.vertices, np.float32).ravel()
            parts["faces"] = np.ascontiguousarray(mesh.faces, np.uint32).ravel()
            parts.update()
            group[f"mesh{k}"] = shape
        scene: dict[str, Any] = {"type": "scene", "trees": group}
        for k, place in enumerate(places):
            matrix = mitsuba.ScalarTransform4f(np.vstack([place, [0, 0, 0, 1]]))
            shape = {"type": "ref", "id": "trees"}
            scene[f"patch{k}"] = {"type": "instance", "to_world": matrix, "shape": shape}
        self.scene = mitsuba.load_dict(scene)

    def rays(self, origins: np.ndarray, directions: np.ndarray) -> Any:
        mi, unravel = self.mi, self.dr.unravel
        points, vectors = (mi.Float(np.ravel(one)) for one in (origins, directions))
        rays = mi.Ray3f(unravel(mi.Point3f, points), unravel(mi.Vector3f, vectors))
        self.dr.eval(rays)
        self.dr.sync_thread()
        return rays

    def first_hit(self, rays: Any, mode: str) -> float:
        t = self.scene.ray_intersect_preliminary(rays, coherent=mode == "coherent").t
        self.dr.eval(t)
        self.dr.sync_thread()
        return float(np.isfinite(np.array(t)).mean())

    def any_hit(self, rays: Any, mode: str) -> float:
        seen = self.scene.ray_test(rays, coherent=mode == "coherent")
        self.dr.eval(seen)
        self.dr.sync_thread()
        return float(np.array(seen).mean())


CONTENDERS = {"raystream": Ours, "Mitsuba": Mitsuba}


def contend(name: str, side: int) -> None:
    """A contender's process: build, then time a query for each line of input."""
    trees, places = forest(side)
    started = time.perf_counter()
    contender = CONTENDERS[name](trees, places)
    took = time.perf_counter() - started
    rays = {key: contender.rays(*some) for key, some in ray_sets(places).items()}
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**10
    total = trees.triangle_count * len(places)
    print(json.dumps({"build": took, "memory": memory, "triangles": total}), flush=True)
    for line in sys.stdin:
        key, query = line.split()
        walls, processors = [], []
        for mode in contender.modes:
            started = time.perf_counter(), time.process_time()
            share = getattr(contender, query)(rays[key], mode)
            walls.append(time.perf_counter() - started[0])
            processors.append(time.process_time() - started[1])
        answer = {"seconds": min(walls), "processor": min(processors), "share": share}
        print(json.dumps(answer), flush=True)


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--side", type=int, default=64, help="patches along each side")
    parser.add_argument("--contender", choices=CONTENDERS, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.contender:
        contend(options.contender, options.side)
        return
    command = [sys.executable, __file__, "--side", str(options.side), "--contender"]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
    running = {}
    for name in CONTENDERS:
        running[name] = process = subprocess.Popen([*command, name], **pipes)
        built = json.loads(process.stdout.readline())
        print(
            f"{name}: {built['triangles']:,} triangles, {built['build']:.1f} s to build, "
            f"{built['memory']:,.0f} MB resident"
        )
    count = SIZE[0] * SIZE[1]
    print(f"\n{'rays':8} {'query':10} " + " ".join(f"{name:>10}" for name in running), end="")
    print("  Mrays/s; ratio (range), of processor times")
    for key in ("camera", "random"):
        for query in QUERIES:
            times: dict[str, list[float]] = {name: [] for name in running}
            spent: dict[str, list[float]] = {name: [] for name in running}
            shares = {}
            for _ in range(options.rounds + 1):
                for name, process in running.items():
                    process.stdin.write(f"{key} {query}\n")
                    process.stdin.flush()
                    answer = json.loads(process.stdout.readline())
                    times[name].append(answer["seconds"])
                    spent[name].append(answer["processor"])
                    shares[name] = answer["share"]
            rounds = {name: some[1:] for name, some in times.items()}  # the first round compiles
            rates = " ".join(
                f"{count / statistics.median(some) / 1e6:10.2f}" for some in rounds.values()
            )
            ratios = [b / a for a, b in zip(*rounds.values(), strict=True)]
            own, other = (statistics.median(some[1:]) for some in spent.values())
            print(
                f"{key:8} {query:10} {rates}  {statistics.median(ratios):.2f} "
                f"({min(ratios):.2f} to {max(ratios):.2f}), {other / own:.2f}; hit: "
                + ", ".join(f"{share:.4%}" for share in shares.values()),
                flush=True,
            )
    for process in running.values():
        process.stdin.close()
        process.wait()


if __name__ == "__main__":
    main()

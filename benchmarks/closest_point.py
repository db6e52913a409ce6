"""Closest points: raystream beside its peers, each in a process of its own, in turn.

    python benchmarks/closest_point.py
    python benchmarks/closest_point.py bunny --points 100000 --rounds 7

Points are float32: at random in the scene's box grown by half, near the surface (off it by a
thousandth of the box's diagonal), and on a grid in the box. Times are medians in seconds of whole
calls, from NumPy arrays to NumPy arrays of distances, positions and triangles. Processes that wait
are stopped. The largest difference of a distance from raystream's, in units of the diagonal, and
the number of points where it exceeds 1e-6, are printed with each.
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

#: Warp's queries take the greatest distance.
FAR = 1e30

#: Contenders slower than this in seconds join one round.
PATIENCE = 10.0


def raystream(vertices, faces, threads):
    import raystream as rs

    rs.set_thread_count(threads)
    tracer = rs.Tracer(rs.Scene.from_arrays(vertices, faces))
    return lambda points: tracer.closest_point(points).distance


def open3d(vertices, faces, threads):
    import open3d as o3d

    scene = o3d.t.geometry.RaycastingScene(nthreads=threads)
    scene.add_triangles(vertices, faces.astype(np.uint32))

    def query(points):
        found = scene.compute_closest_points(o3d.core.Tensor(points), nthreads=threads)
        positions = found["points"].numpy()
        found["primitive_ids"].numpy()
        return np.linalg.norm(positions - points, axis=1)

    return query


def warp(vertices, faces, threads):  # noqa: ARG001 - the CPU's kernels have one
    import warp as wp

    wp.config.quiet = True

    @wp.kernel
    def nearest(
        mesh: wp.uint64,
        points: wp.array(dtype=wp.vec3),
        positions: wp.array(dtype=wp.vec3),
        found: wp.array(dtype=wp.int32),
        distances: wp.array(dtype=wp.float32),
    ):
        i = wp.tid()
        query = wp.mesh_query_point_no_sign(mesh, points[i], FAR)
        positions[i] = wp.mesh_eval_position(mesh, query.face, query.u, query.v)
        found[i] = query.face
        distances[i] = wp.length(positions[i] - points[i])

    mesh = wp.Mesh(
        points=wp.array(vertices, dtype=wp.vec3, device="cpu"),
        indices=wp.array(faces.ravel().astype(np.int32), dtype=wp.int32, device="cpu"),
    )

    def query(points):
        given = wp.array(points, dtype=wp.vec3, device="cpu", copy=False)
        positions = wp.empty(len(points), dtype=wp.vec3, device="cpu")
        found = wp.empty(len(points), dtype=wp.int32, device="cpu")
        distances = wp.empty(len(points), dtype=wp.float32, device="cpu")
        outputs = [positions, found, distances]
        wp.launch(nearest, len(points), inputs=[mesh.id, given], outputs=outputs, device="cpu")
        positions.numpy()
        found.numpy()
        return distances.numpy()

    return query


def trimesh(vertices, faces, threads):  # noqa: ARG001
    import trimesh as tm

    mesh = tm.Trimesh(vertices, faces, process=False)
    finder = tm.proximity.ProximityQuery(mesh)
    return lambda points: finder.on_surface(points)[1]


def fcpw(vertices, faces, threads):  # noqa: ARG001 - as many as there are cores
    import fcpw as package

    scene = package.scene_3D()
    scene.set_object_count(1)
    scene.set_object_vertices(np.asfortranarray(vertices), 0)
    scene.set_object_triangles(np.asfortranarray(faces), 0)
    scene.build(package.aggregate_type.bvh_surface_area, True)

    def query(points):
        found = package.interaction_3D_list()
        limits = np.full(len(points), np.inf, np.float32)
        scene.find_closest_points(np.asfortranarray(points), limits, found)
        # The list is its result: making arrays of it does not count.
        return lambda: np.array([one.d for one in found])

    return query


def libigl(vertices, faces, threads):  # noqa: ARG001
    import igl

    vertices, faces = vertices.astype(np.float64), faces.astype(np.int64)
    tree = igl.AABB()
    tree.init(vertices, faces)
    return lambda points: np.sqrt(
        tree.squared_distance(vertices, faces, points.astype(np.float64))[0]
    )


CONTENDERS = {one.__name__: one for one in (raystream, open3d, warp, fcpw, libigl, trimesh)}


def work(name, threads):
    """Answer requests on the standard input."""
    query = None
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # what packages print
    for line in sys.stdin:
        request = json.loads(line)
        arrays = np.load(request["arrays"])
        try:
            if request["do"] == "build":
                started = time.perf_counter()
                query = CONTENDERS[name](arrays["vertices"], arrays["faces"], threads)
                query(arrays["vertices"][:1000].copy())
                answer = {"seconds": time.perf_counter() - started}
            else:
                points = arrays["points"]
                started = time.perf_counter()
                distances = query(points)
                answer = {"seconds": time.perf_counter() - started}
                if request["keep"]:
                    np.save(request["keep"], distances() if callable(distances) else distances)
        except Exception as error:
            answer = {"error": f"{type(error).__name__}: {error}"}
        answers.write(json.dumps(answer) + "\n")
        answers.flush()


class Worker:
    def __init__(self, name, threads):
        command = [sys.executable, __file__, "--work", name, "--threads", str(threads)]
        pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
        # Peers that print a greeting, or a reason, do so where it does not disturb.
        self.process = subprocess.Popen(command, **pipes, stderr=subprocess.DEVNULL, text=True)
        self.error = None

    def ask(self, **request):
        self.process.send_signal(signal.SIGCONT)
        self.process.stdin.write(json.dumps(request) + "\n")
        self.process.stdin.flush()
        line = self.process.stdout.readline()
        self.process.send_signal(signal.SIGSTOP)
        answer = json.loads(line) if line else {"error": "its process ended"}
        self.error = answer.get("error")
        return answer.get("seconds")

    def close(self):
        self.process.kill()
        self.process.wait()


def point_sets(vertices, faces, count):
    rng = np.random.default_rng(49)
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    size = high - low
    box = low - size / 4 + rng.random((count, 3)) * size * 1.5
    corners = vertices[faces].astype(np.float64)
    areas = np.linalg.norm(
        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
    )
    chosen = corners[rng.choice(len(faces), count, p=areas / areas.sum())]
    on = np.einsum("nk,nkx->nx", rng.dirichlet([1, 1, 1], count), chosen)
    near = on + rng.normal(size=(count, 3)) * np.linalg.norm(size) * 1e-3
    side = round(count ** (1 / 3))
    lines = [np.linspace(low[k], high[k], side) for k in range(3)]
    grid = np.stack(np.meshgrid(*lines, indexing="ij"), axis=-1).reshape(-1, 3)
    return {
        name: one.astype(np.float32) for name, one in (("box", box), ("near", near), ("grid", grid))
    }


def measure(scene, arguments, folder):
    import raystream as rs

    model = rs.load(scene)
    starts = np.cumsum([0, *(len(mesh.vertices) for mesh in model.meshes)])
    vertices = np.concatenate([mesh.vertices for mesh in model.meshes]).astype(np.float32)
    faces = np.concatenate(
        [mesh.faces + first for mesh, first in zip(model.meshes, starts, strict=False)]
    ).astype(np.int32)
    diagonal = float(np.linalg.norm(np.ptp(vertices, axis=0)))
    geometry = f"{folder}/{scene}.npz"
    np.savez(geometry, vertices=vertices, faces=faces)
    print(f"\n{scene}: {len(faces):,} triangles")
    workers = {name: Worker(name, arguments.threads) for name in arguments.contenders}
    for name, worker in workers.items():
        worker.ask(do="build", arrays=geometry)
        if worker.error:
            print(f"  {name}: {worker.error}")
    workers = {name: worker for name, worker in workers.items() if not worker.error}
    for kind, points in point_sets(vertices, faces, arguments.points).items():
        at = f"{folder}/{kind}.npz"
        np.savez(at, points=points)
        seconds = {name: [] for name in workers}
        names = list(workers)
        for number in range(arguments.rounds + 1):
            for name in names[number % len(names) :] + names[: number % len(names)]:
                if seconds[name] and seconds[name][0] > PATIENCE:
                    continue
                keep = "" if number else f"{folder}/{name}.npy"
                taken = workers[name].ask(do="query", arrays=at, keep=keep)
                if workers[name].error:
                    print(f"  {name}: {workers[name].error}")
                elif number or taken > PATIENCE:
                    seconds[name].append(taken)
        ours = np.load(f"{folder}/raystream.npy") if "raystream" in workers else None
        for name in names:
            if not seconds[name]:
                continue
            median = statistics.median(seconds[name])
            ratio = (
                median / statistics.median(seconds["raystream"]) if "raystream" in seconds else 0
            )
            off = np.abs(np.load(f"{folder}/{name}.npy") - ours) / diagonal
            print(
                f"  {kind:5} {name:10} {median:8.3f} s {len(points) / median / 1e6:8.2f} M/s"
                f" {ratio:7.2f} x   off {off.max():.1e}, {(off > 1e-6).sum():,} points"
            )
    for worker in workers.values():
        worker.close()


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("scenes", nargs="*", default=["bunny", "conference", "sponza"])
    parser.add_argument("--points", type=int, default=1_000_000)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--threads", type=int, default=len(os.sched_getaffinity(0)))
    parser.add_argument(
        "--contenders", nargs="*", default=["raystream", "open3d", "warp"], choices=CONTENDERS
    )
    parser.add_argument("--work")
    arguments = parser.parse_args()
    if arguments.work:
        work(arguments.work, arguments.threads)
        return
    with tempfile.TemporaryDirectory() as folder:
        for scene in arguments.scenes:
            measure(scene, arguments, Path(folder))


if __name__ == "__main__":
    main()

"""Adapters against trimesh and Open3D: times of the same calls, and wrong counts at edges.

    python benchmarks/adapters.py                      # a sphere of 81,920 triangles
    python benchmarks/adapters.py bunny.ply --rays 1000000

Runs alternate between a library and its adapter; times are medians. Structures are built in
advance. Rays are incoherent: they start around the model and go in all directions. The second table
counts wrong answers for rays that start outside a closed sphere and pass through its vertices and
edges towards the centre: each crosses the sphere exactly twice. Needs the packages that it
compares: trimesh with embreex, and Open3D.
"""

import argparse
import statistics
import sys
import time
from pathlib import Path

import numpy as np

import raystream as rs

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
from meshes import icosphere


def main():
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("scene", nargs="?", help="model file or scene [default: a sphere]")
    parser.add_argument("--rays", type=int, default=200_000)
    parser.add_argument("--runs", type=int, default=7)
    args = parser.parse_args()
    if args.scene:
        mesh = rs.load(args.scene).meshes[0]
        vertices, faces = np.asarray(mesh.vertices, float), mesh.faces
    else:
        vertices, faces = icosphere(6)
    center = (vertices.min(axis=0) + vertices.max(axis=0)) / 2
    size = np.ptp(vertices, axis=0).max()
    rng = np.random.default_rng(0)
    origins = center + size * rng.uniform(-1, 1, (args.rays, 3))
    directions = rng.normal(size=(args.rays, 3))

    print(f"{len(faces):,} triangles, {args.rays:,} rays, medians of {args.runs} runs\n")
    print(f"{'call':34} {'library':>10} {'adapter':>10} {'ratio':>7}")
    for pair in (trimesh_pair, open3d_pair):
        for name, theirs, ours in pair(vertices, faces, origins, directions):
            one, two = alternate(theirs, ours, args.runs)
            print(f"{name:34} {one * 1e3:8.1f} ms {two * 1e3:7.1f} ms {one / two:6.1f}x")
    edges()


def alternate(theirs, ours, runs):
    """Median times of two calls, which alternate."""
    times = [], []
    for run in range(runs + 1):
        for call, kept in zip((theirs, ours), times, strict=True):
            start = time.perf_counter()
            call()
            if run:  # the first run builds and compiles
                kept.append(time.perf_counter() - start)
    return [statistics.median(one) for one in times]


def trimesh_engines(vertices, faces):
    import trimesh
    from trimesh.ray.ray_pyembree import RayMeshIntersector as Embree

    from raystream.adapters.trimesh import RayMeshIntersector

    mesh = trimesh.Trimesh(vertices, faces, process=False)
    return Embree(mesh), RayMeshIntersector(mesh)


def trimesh_pair(vertices, faces, origins, directions):
    theirs, ours = trimesh_engines(vertices, faces)
    points = origins[: len(origins) // 4]
    for name, arguments in (
        ("intersects_first", (origins, directions)),
        ("intersects_any", (origins, directions)),
        ("intersects_location", (origins, directions)),
        ("contains_points", (points,)),
    ):
        yield (
            f"trimesh {name}",
            lambda name=name, a=arguments: getattr(theirs, name)(*a),
            lambda name=name, a=arguments: getattr(ours, name)(*a),
        )


def open3d_scenes(vertices, faces):
    import open3d

    from raystream.adapters.open3d import RaycastingScene

    scenes = open3d.t.geometry.RaycastingScene(), RaycastingScene()
    for scene in scenes:
        scene.add_triangles(
            open3d.core.Tensor(vertices.astype(np.float32)),
            open3d.core.Tensor(faces.astype(np.uint32)),
        )
    return (*scenes, open3d.core.Tensor)


def open3d_pair(vertices, faces, origins, directions):
    theirs, ours, tensor = open3d_scenes(vertices, faces)
    rays = tensor(np.hstack([origins, directions]).astype(np.float32))
    for name in ("cast_rays", "test_occlusions", "count_intersections", "list_intersections"):
        yield (
            f"Open3D {name}",
            lambda name=name: getattr(theirs, name)(rays),
            lambda name=name: getattr(ours, name)(rays),
        )
    points = tensor(origins[: len(origins) // 4].astype(np.float32))
    for name in ("compute_closest_points", "compute_signed_distance"):
        yield (
            f"Open3D {name}",
            lambda name=name: getattr(theirs, name)(points),
            lambda name=name: getattr(ours, name)(points),
        )


def edges():
    """Count crossings of a closed sphere by rays through its vertices and edge midpoints."""
    vertices, faces = icosphere(5)
    vertices = vertices.astype(np.float32).astype(float)
    rng = np.random.default_rng(1)
    targets = {
        "vertices": vertices,
        "edge midpoints": vertices[faces[:, [0, 1]]].mean(axis=1),
        "anywhere": vertices[faces].mean(axis=1) * 0.9,
    }
    engines = trimesh_engines(vertices, faces)
    print("\nrays at a closed sphere with a number of crossings other than two")
    print(f"{'aimed at':16} {'trimesh':>9} {'adapter':>9}   of")
    for name, aims in targets.items():
        origins = aims * 3 + 0.2 * rng.normal(size=aims.shape)
        wrong = []
        for engine in engines:
            index_ray = engine.intersects_location(origins, aims - origins)[1]
            counts = np.bincount(index_ray, minlength=len(aims))
            wrong.append(int((counts != 2).sum()))
        print(f"{name:16} {wrong[0]:9,} {wrong[1]:9,}   {len(aims):,}")


if __name__ == "__main__":
    main()

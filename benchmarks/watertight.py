"""Closed meshes: how many rays through vertices and edges are counted wrongly?

    python benchmarks/watertight.py --rays 1000000

Uses a sphere of 20,480 triangles (an icosphere divided five times), with rays from outside that are
aimed at its vertices, at edge midpoints and along the planes of its faces. Each crosses the sphere
twice, or not at all if it passes outside the silhouette; rays at vertices and midpoints continue
towards the inside, so exactly two is right. Tests every structure of raystream, and the other
libraries that are installed: Open3D, embreex through trimesh, Warp, and FCPW. These list triangles,
each in its own way; the count is what a user receives from a call for all hits.
"""

import argparse
import sys
import time
from importlib.util import find_spec
from pathlib import Path

import numpy as np

import raystream as rs

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
from conftest import TRACERS
from meshes import icosphere
from watertight import RAYS


def own(options):
    """Crossings of surfaces, counted by one of raystream's tracers."""

    def make(vertices, faces):
        tracer = rs.Tracer(rs.Scene.from_arrays(vertices, faces), **options)
        return lambda o, d: tracer.count_hits(o, d, crossings="surfaces")

    return make


def open3d(vertices, faces):
    import open3d

    scene = open3d.t.geometry.RaycastingScene()
    scene.add_triangles(
        open3d.core.Tensor.from_numpy(vertices), open3d.core.Tensor.from_numpy(np.uint32(faces))
    )

    def count(o, d):
        rays = open3d.core.Tensor.from_numpy(np.float32(np.hstack([o, d])))
        return scene.count_intersections(rays).numpy()

    return count


def trimesh(vertices, faces):
    import trimesh

    mesh = trimesh.Trimesh(vertices, faces, process=False)
    assert "pyembree" in type(mesh.ray).__module__, "trimesh does not find embreex"

    def count(o, d):
        _, ray = mesh.ray.intersects_id(o, d, multiple_hits=True)[:2]
        return np.bincount(ray, minlength=len(o))

    return count


def warp(vertices, faces):
    import warp as wp
    from warp_count import count_kernel

    wp.config.quiet = True
    mesh = wp.Mesh(
        points=wp.array(vertices, dtype=wp.vec3, device="cpu"),
        indices=wp.array(faces.ravel().astype(np.int32), dtype=wp.int32, device="cpu"),
    )

    def count(o, d):
        counts = np.zeros(len(o), np.int32)
        unit = np.float32(d / np.linalg.norm(d, axis=1, keepdims=True))
        arrays = [wp.array(a, dtype=wp.vec3, device="cpu") for a in (np.float32(o), unit)]
        out = wp.array(counts, dtype=wp.int32, device="cpu", copy=False)
        wp.launch(count_kernel, len(o), inputs=[mesh.id, *arrays], outputs=[out], device="cpu")
        return out.numpy()

    return count


def fcpw(vertices, faces):
    import fcpw

    scene = fcpw.scene_3D()
    scene.set_object_count(1)
    scene.set_object_vertices(np.asfortranarray(vertices), 0)
    scene.set_object_triangles(np.asfortranarray(faces.astype(np.int32)), 0)
    scene.build(fcpw.aggregate_type.bvh_surface_area, True)
    far = float(np.finfo(np.float32).max)

    def count(o, d):
        counts = np.empty(len(o), np.int32)
        unit = np.float32(d / np.linalg.norm(d, axis=1, keepdims=True))
        for i, (origin, direction) in enumerate(zip(np.float32(o), unit, strict=True)):
            ray = fcpw.ray_3D(origin, direction, far)
            found = fcpw.interaction_3D_list()
            scene.intersect(ray, found, False, True)
            counts[i] = len(found)
        return counts

    return count


#: Maximum number of rays for contenders that trace them one by one, or test every triangle.
FEWER = {"FCPW": 200_000, "brute": 20_000, "brute, multipass": 2_000, "grid, one cell": 20_000}


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--rays", type=int, default=1_000_000)
    parser.add_argument("--only", default="", help="names that contain this")
    parser.add_argument("--skip", default="?", help="names that do not contain this")
    arguments = parser.parse_args()
    vertices, faces = icosphere(5)
    vertices = np.float32(vertices)
    makers = {name: own(options) for name, options in TRACERS.items()}
    peers = {"Open3D": ("open3d", open3d), "trimesh, embreex": ("embreex", trimesh)}
    peers |= {"Warp": ("warp", warp), "FCPW": ("fcpw", fcpw)}
    makers |= {name: maker for name, (module, maker) in peers.items() if find_spec(module)}
    print(f"{len(faces):,} triangles; share and number of rays that are counted wrongly")
    for name, maker in makers.items():
        if arguments.only not in name or arguments.skip in name:
            continue
        count_of = maker(vertices, faces)
        ray_count = min(arguments.rays, FEWER.get(name, arguments.rays))
        texts, started = [], time.perf_counter()
        for kind, make in RAYS.items():
            origins, directions, allowed = make(vertices, faces, ray_count)
            counts = count_of(origins, directions)
            wrong = int(np.count_nonzero(~np.isin(counts, allowed)))
            texts.append(f"{kind} {wrong / ray_count:8.3%} ({wrong:,} of {ray_count:,})")
        print(f"{name:30s} {'; '.join(texts)}; {time.perf_counter() - started:.0f} s", flush=True)


if __name__ == "__main__":
    main()

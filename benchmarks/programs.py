"""Programs and filters against queries that do the same, on every structure; and cut-outs.

    python benchmarks/programs.py --scenes bunny kitchen --structures bvh kdtree graph
    python benchmarks/programs.py --scenes bunny kitchen --sets primary bounce --groups filters
    python benchmarks/programs.py --scenes leaves

In each round, all of them run one after another; the medians of the rounds count. Prints the tables
of docs/decisions/0013-programs.rst: milliseconds, and the time relative to the first query of the
group. The scene "leaves" is rendered instead: the crown of a tree made of squares, from which an
opacity texture cuts out leaves, against the same squares without the texture.
"""

import argparse
import statistics
import time

import numpy as np

import raystream as rs
from raystream.bench.ray_sets import make_ray_sets

WIDTH, HEIGHT = 1024, 768


def count(hit, payload):  # noqa: ARG001
    payload[0] += 1


def balance(hit, payload):
    payload[0] += 1 if hit.is_entering else -1


def most(hit):
    return hit.prim_id % 64 != 0


def half(hit):
    return hit.prim_id % 2 == 0


#: Groups of queries; the others of a group are compared with its first.
PROGRAMS = (
    {
        "count_hits": lambda tracer, rays: tracer.count_hits(*rays),
        "count_hits, filter ignores 1/64": lambda tracer, rays: tracer.count_hits(
            *rays, on_hit=most
        ),
        "counting program, any order": lambda tracer, rays: tracer.trace(
            *rays, on_hit=count, payload=np.int64, order="any"
        ),
        "counting program, front to back": lambda tracer, rays: tracer.trace(
            *rays, on_hit=count, payload=np.int64
        ),
        "program that uses is_entering, any order": lambda tracer, rays: tracer.trace(
            *rays, on_hit=balance, payload=np.int64, order="any"
        ),
        "multi_hit": lambda tracer, rays: tracer.multi_hit(*rays),
    },
)
FILTERS = (
    {
        "first_hit": lambda tracer, rays: tracer.first_hit(*rays),
        "first_hit, filter ignores 1/64": lambda tracer, rays: tracer.first_hit(*rays, on_hit=most),
        "first_hit, filter ignores 1/2": lambda tracer, rays: tracer.first_hit(*rays, on_hit=half),
        "first_hit, skips a triangle": lambda tracer, rays: tracer.first_hit(
            *rays, skip_prim_ids=np.zeros(np.shape(rays[1])[:-1], np.int32)
        ),
    },
    {
        "any_hit": lambda tracer, rays: tracer.any_hit(*rays),
        "any_hit, filter ignores 1/64": lambda tracer, rays: tracer.any_hit(*rays, on_hit=most),
    },
)
GROUPS = {"all": PROGRAMS + FILTERS, "programs": PROGRAMS, "filters": FILTERS}

#: Rendered with and without an opacity texture.
MODES = ("ao", "path")
LEAVES = 30_000


def leaves(is_cut):
    """A crown of squares, 6 by 12 cm, over a floor; with an opacity texture if they are cut out."""
    rng = np.random.default_rng(7)
    centers = rng.normal(size=(LEAVES, 3)) * [1.0, 1.0, 0.7] + [0.0, 0.0, 2.2]
    along = rng.normal(size=(LEAVES, 3))
    along *= 0.06 / np.linalg.norm(along, axis=1, keepdims=True)
    across = np.cross(along, rng.normal(size=(LEAVES, 3)))
    across *= 0.03 / np.linalg.norm(across, axis=1, keepdims=True)
    corners = [-along - across, along - across, along + across, across - along]
    vertices = np.stack([centers + corner for corner in corners], axis=1).reshape(-1, 3)
    faces = 4 * np.arange(LEAVES)[:, None, None] + [[0, 1, 2], [0, 2, 3]]
    texcoords = np.tile([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]], (LEAVES, 1))
    y, x = np.mgrid[-1:1:64j, -1:1:64j]
    outline = np.where(x * x + y * y * (1.2 + x) < 0.8, 255, 0).astype(np.uint8)
    looks = {"textures": {"opacity": rs.Texture(outline[:, :, None])}, "alpha_cutoff": 0.5}
    floor = [[-6, -6, 0], [6, -6, 0], [6, 6, 0], [-6, 6, 0]]
    meshes = [
        rs.Mesh(vertices, faces.reshape(-1, 3), texcoords=texcoords),
        rs.Mesh(floor, [[0, 1, 2], [0, 2, 3]], material_ids=[1, 1], texcoords=np.zeros((4, 2))),
    ]
    materials = [
        rs.Material(diffuse=(0.2, 0.5, 0.1), **(looks if is_cut else {})),
        rs.Material(diffuse=(0.6, 0.6, 0.6)),
    ]
    camera = rs.Camera((5, -4, 3), (0, 0, 1.8), up=(0, 0, 1), fov=45)
    return rs.Scene(meshes, materials=materials, background=(1, 1, 1), camera=camera)


def measure(groups, rounds, *arguments):
    """Median seconds of each query."""
    seconds = {title: [] for group in groups for title in group}
    for k in range(rounds + 1):  # the first round compiles
        for group in groups:
            for title, query in group.items():
                started = time.perf_counter()
                query(*arguments)
                if k:
                    seconds[title].append(time.perf_counter() - started)
    return {title: statistics.median(taken) for title, taken in seconds.items()}


def show(name, groups, medians):
    """Print the medians, and their ratios to the first of each group."""
    for group in groups:
        base = medians[next(iter(group))]
        for title in group:
            figures = f"{medians[title] * 1e3:8.1f} {medians[title] / base:6.2f}"
            print(f"{name:24} {title:42} {figures}", flush=True)


def render_leaves(rounds):
    """Render the leaves in each mode, opaque and cut out."""
    scenes = {"opaque": leaves(False), "cut out": leaves(True)}
    groups = [
        {
            f"{mode}, {how}": lambda mode=mode, scene=scene: rs.render(scene, mode, (320, 240))
            for how, scene in scenes.items()
        }
        for mode in MODES
    ]
    show("leaves", groups, measure(groups, rounds))


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--scenes", nargs="+", default=("bunny", "kitchen", "leaves"))
    parser.add_argument("--structures", nargs="+", default=("bvh", "kdtree", "graph"))
    parser.add_argument("--sets", nargs="+", default=("primary",))
    parser.add_argument("--groups", default="all", choices=tuple(GROUPS))
    parser.add_argument("--rounds", type=int, default=9)
    arguments = parser.parse_args()
    groups = GROUPS[arguments.groups]
    for name in arguments.scenes:
        if name == "leaves":
            render_leaves(arguments.rounds)
            continue
        scene = rs.load(name)
        camera = scene.camera_for(WIDTH / HEIGHT)
        sets = list(make_ray_sets(rs.Tracer(scene), camera, (WIDTH, HEIGHT), arguments.sets))
        for structure in arguments.structures:
            tracer = rs.Tracer(scene, structure)
            for one in sets:
                if one.name in arguments.sets:
                    rays = one.rays.origins, one.rays.directions
                    medians = measure(groups, arguments.rounds, tracer, rays)
                    show(f"{name} {structure} {one.name}", groups, medians)


if __name__ == "__main__":
    main()

"""Millions of hard rays: does a structure give the same bits as brute force?

    python benchmarks/agreement.py --rays 5000000 --structure bvh
    python benchmarks/agreement.py --rays 5000000 --structure bvh --device cuda
    python benchmarks/agreement.py --kind spheres
    python benchmarks/agreement.py --kind instances --ignoring masks

Runs every case of the test suite repeatedly with other seeds, more rays, and intervals of all kinds
(t_min above, at and below zero), and counts the rays whose answer differs in any bit of any query.
With `--kind`, the rays meet another kind of geometry or precision, by each of the BVH's kernels in
turn: the cases placed by several transforms, or in float64; spheres; or height fields. With
`--ignoring`, rays ignore what has other masks, or what a filter leaves out, and NumPy leaves that
out of brute force's hits. The figures in docs/decisions come from here.
"""

import argparse
import copy
import sys
import time
from collections import Counter
from pathlib import Path
from types import SimpleNamespace

import numpy as np

import raystream as rs

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
import cases
import field_rays
import sphere_rays
from instanced import moved, random_transforms

#: Rays of a batch.
RAY_COUNT = 10_000


def bits(values):
    """The bits of each number; equal numbers of other types stay equal."""
    return values.view(f"u{values.itemsize}") if values.dtype.kind == "f" else values


COLUMNS = ("t", "u", "v", "prim_id", "mesh_id", "instance_id")


class Kept:
    """A tracer whose hits NumPy chooses: ``keep(hits)`` says which, of those of `multi_hit`."""

    def __init__(self, tracer, keep):
        self.tracer, self.keep = tracer, keep

    def multi_hit(self, **query):
        """The hits that are kept."""
        found = self.tracer.multi_hit(**query)
        rows = np.flatnonzero(self.keep(found))
        counts = np.bincount(found.ray_id[rows], minlength=len(found.counts))
        splits = np.concatenate([[0], np.cumsum(counts)])
        columns = {name: getattr(found, name)[rows] for name in COLUMNS}
        return SimpleNamespace(counts=counts, ray_splits=splits, status=found.status, **columns)

    def any_hit(self, **rays):
        """Whether any is kept."""
        return self.multi_hit(**rays).counts > 0

    def first_hit(self, **rays):
        """The first ones that are kept."""
        found, first = self.multi_hit(**rays), self.tracer.first_hit(**rays)
        missing = self.tracer.first_hit(np.zeros(3), np.zeros(3))
        rows, is_hit = found.ray_splits[:-1], found.counts > 0
        chosen = {}
        for name in COLUMNS:
            column = np.full_like(getattr(first, name), getattr(missing, name))
            column[is_hit] = getattr(found, name)[rows[is_hit]]
            chosen[name] = column
        return SimpleNamespace(status=found.status, **chosen)


def differing(tracer, oracle, rays, options):
    """Whether any query gives different bits, for each ray."""
    wrong = np.zeros(len(rays["origins"]), bool)
    first, expected = tracer.first_hit(**rays, **options), oracle.first_hit(**rays)
    for column in (*COLUMNS, "status"):
        wrong |= bits(getattr(first, column)) != bits(getattr(expected, column))
    wrong |= tracer.any_hit(**rays, **options) != oracle.any_hit(**rays)
    for crossings in ("triangles", "surfaces"):
        asked = {**rays, **options, "crossings": crossings}
        many, expected = tracer.multi_hit(**asked), oracle.multi_hit(**rays, crossings=crossings)
        wrong |= many.counts != expected.counts
        wrong |= tracer.count_hits(**asked) != expected.counts
        if np.array_equal(many.ray_splits, expected.ray_splits):
            for column in COLUMNS:
                a, b = bits(getattr(many, column)), bits(getattr(expected, column))
                np.logical_or.at(wrong, many.ray_id, a != b)
    return wrong


def limits(kind, t, rng):
    """Intervals around the first hits: above zero, below zero, from or up to a hit."""
    t = np.where(np.isfinite(t), t, 1.0)
    shift = t * rng.uniform(0.2, 1.8, len(t))
    return {
        "t_min = 0": (0.0, np.inf),
        "t_min > 0": (shift, np.inf),
        "t_min < 0": (-np.abs(shift) * 4, np.abs(shift)),
        "t_min = t of a hit": (t, np.inf),
        "t_max = t of a hit": (-np.inf, t),
    }[kind]


#: Options of the structures, used in turn: some make trees as deep as possible.
OPTIONS = {
    "bvh": [{"max_leaf_size": 2}],
    "grid": [
        {"resolution": (7, 3, 5)},
        {},
        {"resolution": 3, "levels": 2},
        {"min_resolution": 16},
    ],
    "graph": [
        {"crossing_cost": 0.1, "link_cost": 0.02, "max_leaf_size": 1},
        {},
        {"crossing_cost": 4.0, "link_cost": 1.0},
    ],
    "kdtree": [
        {"traversal": traversal, "layout": layout, "intersection_cost": cost}
        for traversal in ("stack", "restart", "backtrack", "short-stack")
        for layout, cost in (("compact", 12.0), ("foley", 100.0))
    ],
}

#: The ways to trace and build on a GPU.
CUDA_OPTIONS = {
    **OPTIONS,
    "bvh": [{"max_leaf_size": 2}, {"build": "device"}],
    "grid": [*OPTIONS["grid"], {"build": "device"}],
}

#: The ways to trace other kinds on the CPU, and those of them that float64 has.
KERNELS = [{"kernel": name} for name in ("auto", "packet", "groups", "wavefront", "single")]
KERNELS_IN_FLOAT64 = [one for one in KERNELS if one["kernel"] != "wavefront"]


def triangles(rng):
    """The scenes and rays of all cases."""
    for make in cases.CASES.values():
        case = make(rng)
        yield case.scene, {"origins": case.origins, "directions": case.directions}


def instances(rng):
    """The cases' scenes, placed by transforms of all kinds, and the rays placed likewise."""
    for scene, rays in triangles(rng):
        low, high = scene.bounds
        places = random_transforms(rng, 5, float(np.abs([low, high]).max()))
        places[0] = np.eye(3, 4)
        placed = rng.integers(0, len(places), len(rays["origins"]))
        origins, directions = rays["origins"].copy(), rays["directions"].copy()
        for k, place in enumerate(places):
            rows = placed == k
            origins[rows] = moved(place, origins[rows])
            directions[rows] = moved(place, directions[rows], is_point=False)
        yield rs.Scene.instances(scene, places), {"origins": origins, "directions": directions}


def spheres(rng):
    """Spheres of all sizes, near and far."""
    for count, size, offset, radii, spread in sphere_rays.SETTINGS.values():
        centers = rng.uniform(-size, size, (count, 3)) + offset
        radii = np.exp(rng.uniform(*np.log(radii), count))
        targets = rng.integers(0, count, RAY_COUNT)
        origins, directions, *_ = sphere_rays.some_rays(rng, centers, radii, targets, spread)
        yield rs.Scene.spheres(centers, radii), {"origins": origins, "directions": directions}


def fields(rng):
    """Height fields of all shapes, with and without holes."""
    for shape, missing, place in field_rays.PLACES.values():
        heights = field_rays.random_heights(rng, *shape, missing)
        rays = field_rays.rays_at(rng, field_rays.mesh_of(heights, **place), RAY_COUNT)
        limited = {name: rays[name] for name in ("origins", "directions")}
        yield rs.Scene.height_field(heights, **place), limited


#: Masks of parts of scenes, and of rays.
MASKS = np.array([0b01, 0b10, 0b11], np.uint32)
RAY_MASKS = np.array([0b01, 0b10, 0b101, 0b1000, 2**32 - 1], np.uint32)


def masked(scene):
    """The scene in parts with masks, of which some coincide, and the masks of its hits."""
    placed, held = scene.placements, scene.geometry
    if placed is not None:
        masks = np.resize(MASKS, len(placed))
        scene = rs.Scene.instances(rs.Scene(scene.meshes), placed.transforms, masks=masks)
        return scene, lambda hits: masks[hits.instance_id]
    parts = [
        rs.Scene([rs.Mesh(one.vertices, one.faces[k::3], mask=mask) for one in scene.meshes])
        for k, mask in enumerate(MASKS.tolist())
        if scene.meshes
    ]
    for mask in MASKS[:2].tolist():
        for one in map(copy.copy, held.fields):
            one.mask = mask
            parts.append(rs.Scene.of_field(one))
    masks = [mask for part in parts for mask, n in _runs(part) for _ in range(n)]
    centers, radii = held.spheres.centers, held.spheres.radii
    for k, mask in enumerate(MASKS.tolist() if len(radii) else []):
        parts.append(rs.Scene.spheres(centers[k::3], radii[k::3], mask=mask))
        masks += [mask] * len(radii[k::3])
    table = np.array(masks, np.uint32)
    return rs.Scene.combine(parts), lambda hits: table[hits.prim_id]


def _runs(part):
    """The mask and the number of triangles of each mesh and height field of a scene."""
    yield from ((one.mask, one.triangle_count) for one in part.meshes)
    yield from ((one.mask, len(one)) for one in part.geometry.fields)


def is_kept(hit):
    """A filter, also of arrays of hits."""
    return (hit.prim_id + hit.instance_id) % 3 != 0


#: For each kind its scenes, and options of the BVH on the CPU, used in turn.
KINDS = {
    "triangles": (triangles, KERNELS),
    "float64": (triangles, [{"precision": "float64", **one} for one in KERNELS_IN_FLOAT64]),
    "instances": (instances, KERNELS),
    "spheres": (spheres, KERNELS),
    "fields": (fields, KERNELS),
}


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--device", choices=("cpu", "cuda"), default="cpu")
    parser.add_argument("--rays", type=int, default=1_000_000)
    parser.add_argument("--structure", choices=OPTIONS, default="bvh")
    parser.add_argument("--kind", choices=KINDS, help="by the kernels of the BVH on the CPU")
    parser.add_argument("--ignoring", choices=("masks", "filter"), help="leave out hits")
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    cases.RAY_COUNT = RAY_COUNT
    done, wrong, names = Counter(), Counter(), Counter()
    started = time.perf_counter()
    limited = ["t_min = 0", "t_min > 0", "t_min < 0", "t_min = t of a hit", "t_max = t of a hit"]
    seed, structure = arguments.seed, arguments.structure
    known = OPTIONS if arguments.device == "cpu" else CUDA_OPTIONS
    make, choices = KINDS[arguments.kind] if arguments.kind else (triangles, known[structure])
    while sum(done.values()) < arguments.rays:
        rng = np.random.default_rng([seed, sum(done.values())])
        for number, (scene, rays) in enumerate(make(rng)):
            options, query, keep = choices[(seed + number) % len(choices)], {}, None
            if arguments.ignoring == "masks":
                scene, masks_of = masked(scene)
                masks = np.resize(RAY_MASKS, len(rays["origins"]))
                query = {"mask": masks}
                keep = lambda hits, of=masks_of, own=masks: of(hits) & own[hits.ray_id] != 0  # noqa: E731
            elif arguments.ignoring == "filter":
                query, keep = {"on_hit": is_kept}, is_kept
            tracer = rs.Tracer(scene, structure, arguments.device, **options)
            precision = {key: options[key] for key in options if key == "precision"}
            oracle = rs.Tracer(scene, "brute", **precision)
            oracle = Kept(oracle, keep) if keep else oracle
            t = oracle.first_hit(**rays).t
            for kind in limited:
                low, high = limits(kind, t, rng)
                bad = differing(tracer, oracle, {**rays, "t_min": low, "t_max": high}, query)
                done[kind] += len(bad)
                wrong[kind] += int(np.count_nonzero(bad))
                if bad.any():
                    names[f"scene {number}, {options}"] += int(np.count_nonzero(bad))
        seed += 1
    for kind in limited:
        print(f"{kind:20s} {done[kind]:>10,} rays, {wrong[kind]} differ")
    for name, count in names.items():
        print(f"{count:,} differ: {name}")
    print(f"{number + 1} kinds of scene and ray, {time.perf_counter() - started:.0f} s")
    return 1 if any(wrong.values()) else 0


if __name__ == "__main__":
    sys.exit(main())

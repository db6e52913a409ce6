"""The oracle of scenes with instances: plain tracers of the objects, and rays moved by NumPy."""

from __future__ import annotations

import numpy as np

import raystream as rs

COLUMNS = ("t", "u", "v", "prim_id", "instance_id")


def random_rotation(rng) -> np.ndarray:
    matrix, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    return matrix


def random_transforms(rng, count: int, spread: float = 10.0) -> np.ndarray:
    """Rotations, mirror images, shears and scales that differ by axis."""
    transforms = np.empty((count, 3, 4))
    for k in range(count):
        scales = rng.uniform(0.2, 3.0, 3) * rng.choice([-1.0, 1.0], 3)
        shear = np.eye(3) + np.triu(rng.uniform(-0.5, 0.5, (3, 3)), 1)
        transforms[k, :, :3] = random_rotation(rng) @ shear @ np.diag(scales)
    transforms[:, :, 3] = rng.uniform(-spread, spread, (count, 3))
    return transforms


def moved(transform, points, is_point: bool = True) -> np.ndarray:
    """Points of shape (N, 3), or directions, by a transform; the sums in the kernels' order."""
    x, y, z = np.asarray(points, np.float64).T
    rows = [row[0] * x + row[1] * y + row[2] * z for row in transform]
    if is_point:
        rows = [row + shift for row, shift in zip(rows, transform[:, 3], strict=True)]
    return np.stack(rows, axis=1)


def all_hits(
    scene: rs.Scene,
    objects: list[rs.Scene],
    rays,
    crossings: str = "triangles",
    device: str = "cpu",
):
    """All hits of the instances, by t, then instance_id, then prim_id: splits and columns."""
    found = [[] for _ in range(6)]
    tracers = [rs.Tracer(one, "brute", device) for one in objects]
    firsts = np.cumsum([0, *(one.triangle_count for one in objects)])
    origins, directions = rays["origins"], rays["directions"]
    limits = {name: rays[name] for name in ("t_min", "t_max")}
    placed = scene.placements
    for k, (object_id, inverse) in enumerate(zip(placed.object_ids, placed.inverses, strict=True)):
        hits = tracers[object_id].multi_hit(
            moved(inverse, origins),
            moved(inverse, directions, is_point=False),
            crossings=crossings,
            **limits,
        )
        instance_id = np.full(len(hits.t), k, np.int32)
        prim_id = (hits.prim_id + firsts[object_id]).astype(np.int32)
        columns = (hits.ray_id, hits.t, instance_id, prim_id, hits.u, hits.v)
        for column, values in zip(found, columns, strict=True):
            column.append(values)
    ray_id, t, instance_id, prim_id, u, v = (np.concatenate([*one]) for one in found)
    order = np.lexsort((prim_id, instance_id, t, ray_id))
    splits = np.searchsorted(ray_id[order], np.arange(len(origins) + 1))
    columns = {"t": t, "u": u, "v": v, "prim_id": prim_id, "instance_id": instance_id}
    return splits, {name: values[order] for name, values in columns.items()}


def nearest(splits, columns):
    """The first hit of each ray, with misses as tracers report them."""
    count = len(splits) - 1
    is_hit = splits[1:] > splits[:-1]
    rows = splits[:-1][is_hit]
    misses = {"t": np.inf, "u": 0.0, "v": 0.0, "prim_id": -1, "instance_id": -1}
    first = {}
    for name, values in columns.items():
        first[name] = np.full(count, misses[name], values.dtype)
        first[name][is_hit] = values[rows]
    return first


def kept(splits, columns, limit: int):
    """The first hits of each ray, up to a limit."""
    ranks = np.arange(splits[-1]) - np.repeat(splits[:-1], np.diff(splits))
    rows = ranks < limit
    counts = np.minimum(np.diff(splits), limit)
    return np.concatenate([[0], np.cumsum(counts)]), {n: c[rows] for n, c in columns.items()}

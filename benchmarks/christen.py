"""Reflections without recursion against a recursive ray tracer (Christen 2005, section 5.2).

    python benchmarks/christen.py --size 256 --bounces 5

Renders five scenes with ``whitted``, with 1 to 5 bounces, and again with the tests' recursive
reference in float64, along the same camera rays. Differences are those of linear radiance, the
largest of a pixel's three channels. There are two references:

same rays
    queries a tracer for its hits (with another structure, which gives the same bits as ``brute``),
    so only recursion, weights and shading differ.
own rays
    finds hits in float64 by itself. This shows the effect of float32: a ray that starts a millionth
    of the scene away may hit another surface, and curved mirrors amplify a small difference with
    each bounce. Every pixel over the limit is examined again: the reference's rays are moved at
    random, by as much as float32 may move them. Pixels are *explained* if that changes the
    reference as much as raystream differs from it; the others are faults.
"""

import argparse
import sys
import time
from pathlib import Path

import numpy as np

import raystream as rs

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
from rendering.recursive_reference import MOVED, Reference

#: Christen's scenes A, B and C; then mirrors that face each other, and smooth mirrors and glass.
SCENES = ("three_boxes", "cubes", "boxes", "cornell_mirrors", "spheres")

COLUMNS = ("scene", "bounces", "same rays", "over", "own rays", "over", "explained", "faults")


def pictures(tracer, camera, size, bounces):
    """Pixels of shape (bounces + 1, H * W, 3)."""
    options = {"size": (size, size), "camera": camera, "min_weight": 0.0}
    images = [rs.render(tracer, "whitted", max_bounces=k, **options) for k in range(bounces + 1)]
    return np.stack([image.pixels.reshape(-1, 3) for image in images]).astype(np.float64)


def largest(a, b):
    """The largest difference over each pixel's channels."""
    return np.abs(a - b).max(axis=-1)


def spread(scene, rays, bounces, expected, trials):
    """How much the reference changes if float32 moves its rays: shape (bounces + 1, N)."""
    changes = np.zeros(expected.shape[:2])
    for seed in range(trials):
        moved = Reference(scene, moved=MOVED, seed=seed).render(*rays, bounces)
        changes = np.maximum(changes, largest(moved, expected))
    return changes


def compare(name, arguments):
    """Rows of the table for a scene."""
    scene = rs.load(name)
    camera, bounces, limit = scene.camera_for(1.0), arguments.bounces, arguments.limit
    rays = [array.reshape(-1, 3) for array in camera.rays(arguments.size, arguments.size)]
    ours = pictures(rs.Tracer(scene), camera, arguments.size, bounces)
    started = time.perf_counter()
    tracer = rs.Tracer(scene, arguments.structure)
    same = largest(ours, Reference(scene, tracer).render(*rays, bounces))
    expected = Reference(scene).render(*rays, bounces)
    own = largest(ours, expected)
    doubtful = np.flatnonzero((own > limit).any(axis=0))
    some = [array[doubtful] for array in rays]
    changes = np.zeros_like(own)
    changes[:, doubtful] = spread(scene, some, bounces, expected[:, doubtful], arguments.trials)
    print(f"{name}: {time.perf_counter() - started:.0f} s", file=sys.stderr)
    for k in range(1, bounces + 1):
        over = own[k] > limit
        explained = over & (own[k] <= limit + changes[k])
        yield [
            name,
            k,
            f"{same[k].max():.1e}",
            np.count_nonzero(same[k] > limit),
            f"{own[k].max():.1e}",
            np.count_nonzero(over),
            np.count_nonzero(explained),
            np.count_nonzero(over & ~explained),
        ]
        for pixel in np.flatnonzero((same[k] > limit) | (over & ~explained)):
            row, column = divmod(int(pixel), arguments.size)
            print(
                f"{name}, {k} bounces, row {row}, column {column}: same {same[k, pixel]:.1e}, "
                f"own {own[k, pixel]:.1e}, changes {changes[k, pixel]:.1e}",
                file=sys.stderr,
            )


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--size", type=int, default=256)
    parser.add_argument("--bounces", type=int, default=5)
    parser.add_argument("--limit", type=float, default=1e-5)
    parser.add_argument("--trials", type=int, default=16, help="random displacements of the rays")
    parser.add_argument("--structure", default="kdtree", help="of the tracer for the same rays")
    parser.add_argument("--scenes", nargs="+", default=SCENES)
    arguments = parser.parse_args()
    rows = [list(COLUMNS)]
    for name in arguments.scenes:
        rows += [[str(cell) for cell in row] for row in compare(name, arguments)]
    widths = [max(len(row[k]) for row in rows) for k in range(len(COLUMNS))]
    rule = " ".join("=" * width for width in widths)
    print(rule)
    for k, row in enumerate(rows):
        if k == 1:
            print(rule)
        print(" ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip())
    print(rule)


if __name__ == "__main__":
    main()

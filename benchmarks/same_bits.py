"""Whether two versions of raystream give the same bits: hits of 5 million rays, and 16 images.

    python benchmarks/same_bits.py --record before.json
    ... edit, or check out another version ...
    python benchmarks/same_bits.py --compare before.json

Records a digest of each column of each answer, for eight scenes, five kinds of rays, every
structure and kernel, and four queries; and digests of images of two scenes in eight modes.
``--compare`` prints the digests that differ, and exits with 1 if there are any. Uses only the
public interface, so that versions far apart can be compared. Scenes that are not available
(``RAYSTREAM_SCENES``) are left out when recording; comparing needs those that were recorded.
"""

import argparse
import hashlib
import json
import sys
from pathlib import Path

import numpy as np

import raystream as rs

SCENES = ("cornell", "spheres", "robots", "building", "bunny", "sponza", "conference", "sibenik")

#: Rays of a scene: all of them for the default tracer, few for each of the others.
RAYS = 5_000_000 // len(SCENES)
FEW = 4_000

TRACERS = {
    "bvh": {},
    "bvh, wavefront": {"kernel": "wavefront"},
    "bvh, packet": {"kernel": "packet"},
    "bvh, groups": {"kernel": "groups"},
    "bvh, stream": {"kernel": "stream"},
    "bvh, single": {"kernel": "single"},
    "bvh, fast": {"quality": "fast"},
    "kdtree, stack": {"traversal": "stack"},
    "kdtree, restart": {"traversal": "restart"},
    "kdtree, backtrack": {"traversal": "backtrack"},
    "graph": {},
    "grid": {},
    "bvh, multipass": {"machine": "multipass"},
    "grid, multipass": {"machine": "multipass"},
}

QUERIES = {
    "first_hit": {},
    "any_hit": {},
    "count_hits": {"crossings": "surfaces"},
    "multi_hit": {},
    "multi_hit, 3": {"max_hits": 3},
}

MODES = ("vis", "raycast", "shadow", "whitted", "path", "xray", "ao", "kajiya")
PICTURED = ("cornell", "spheres")


def digest(*arrays):
    """A digest of arrays' bytes."""
    whole = hashlib.sha256()
    for array in arrays:
        whole.update(np.ascontiguousarray(array).tobytes())
    return whole.hexdigest()[:16]


def ray_kinds(scene, count, rng):
    """Rays by kind: (origins, directions, t_min, t_max)."""
    corners = np.concatenate([mesh.vertices[mesh.faces] for mesh in scene.meshes])
    low, high = corners.reshape(-1, 3).min(0), corners.reshape(-1, 3).max(0)
    size = float((high - low).max())
    side = int(np.sqrt(count // 5))
    eye = low + (high - low) * [0.4, 0.55, 0.45]
    grid = np.stack(np.meshgrid(*[np.linspace(-1, 1, side)] * 2), -1)
    forward = np.concatenate([grid * 0.7, np.ones((side, side, 1))], -1)
    yield "primary", eye, forward, 0.0, np.inf
    inside = low + rng.random((count // 5, 3)) * (high - low)
    around = rng.normal(size=(count // 5, 3))
    yield "random", inside.astype(np.float32), around.astype(np.float32), 0.0, np.inf
    ends = low + rng.random((count // 5, 3)) * (high - low)
    yield "shadow", inside, ends - inside, 1e-4, 1.0
    # From far away, through vertices and edges.
    picked = corners[rng.integers(0, len(corners), count // 5)]
    at = np.where(rng.random((len(picked), 1)) < 0.5, picked[:, 0], picked[:, :2].mean(1))
    origins = (low + high) / 2 + around / np.linalg.norm(around, axis=1)[:, None] * size * 3
    yield "edges", origins, at - origins, 0.0, np.inf
    axis = np.eye(3)[rng.integers(0, 3, len(inside))] * rng.choice([-1.0, 1.0], (len(inside), 1))
    yield "axes", inside - axis * size * 1e4, axis * 10.0 ** rng.integers(-8, 8), 0.0, np.inf


def answers(tracer, query, options, rays):
    """The columns of an answer."""
    origins, directions, t_min, t_max = rays
    ask = getattr(tracer, query.partition(",")[0])
    found = ask(origins, directions, t_min=t_min, t_max=t_max, **options)
    if isinstance(found, np.ndarray):
        return {"answer": found}
    names = ("t", "u", "v", "prim_id", "status", "ray_splits")
    return {name: getattr(found, name) for name in names if hasattr(found, name)}


def hits_of(name, count):
    """Digests of a scene's hits, by their labels, and the number of rays traced."""
    scene = rs.load(name)
    found, traced = {}, 0
    for kind, *rays in ray_kinds(scene, count, np.random.default_rng(len(name))):
        few = [np.reshape(np.broadcast_to(a, rays[1].shape), (-1, 3))[:FEW] for a in rays[:2]]
        for label, options in TRACERS.items():
            tracer = tracer_of(scene, label, options)
            own = rays if label == "bvh" else (*few, *rays[2:])
            traced += rays[1].size // 3 if label == "bvh" else len(few[0])
            for query, more in QUERIES.items():
                columns = answers(tracer, query, more, own)
                for column, values in columns.items():
                    found[f"{name}: {kind}: {label}: {query}: {column}"] = digest(values)
    _TRACERS.clear()
    return found, traced


_TRACERS = {}


def tracer_of(scene, label, options):
    """A tracer of the scene, built once."""
    if label not in _TRACERS:
        _TRACERS[label] = rs.Tracer(scene, label.partition(",")[0], **options)
    return _TRACERS[label]


def pictures():
    """Yield digests of images, by scene and mode."""
    for name in PICTURED:
        scene = rs.load(name)
        for mode in MODES:
            image = rs.render(scene, mode, (96, 72), samples=2)
            yield f"picture: {name}: {mode}", digest(image.pixels)


def main():
    """Record digests, or compare them."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    group = parser.add_mutually_exclusive_group(required=True)
    group.add_argument("--record", type=Path, metavar="FILE")
    group.add_argument("--compare", type=Path, metavar="FILE")
    parser.add_argument(
        "--rays", type=int, default=RAYS, help="rays per scene [default: %(default)s]"
    )
    asked = parser.parse_args()
    before = json.loads(asked.compare.read_text()) if asked.compare else None
    found, traced = {}, 0
    for name in before["scenes"] if before else SCENES:
        try:
            hits, count = hits_of(name, before["rays"] if before else asked.rays)
        except (rs.RaystreamError, OSError) as error:
            if before:
                raise
            print(f"{name}: left out: {error}")
            continue
        found |= hits
        traced += count
        print(f"{name}: {count:,} rays, {len(hits):,} columns", flush=True)
    found |= dict(pictures())
    print(f"{traced:,} rays, {len(PICTURED) * len(MODES)} images, {len(found):,} digests")
    if asked.record:
        names = list(dict.fromkeys(key.partition(":")[0] for key in found if key[:8] != "picture:"))
        content = {"rays": asked.rays, "scenes": names, "digests": found}
        asked.record.write_text(json.dumps(content, indent=0) + "\n")
        return 0
    former = before["digests"]
    differing = [key for key in former if former[key] != found.get(key)]
    print(*(f"differs: {key}" for key in differing[:50]), sep="\n")
    print(f"{len(differing)} of {len(former):,} differ")
    return 1 if differing or former.keys() != found.keys() else 0


if __name__ == "__main__":
    sys.exit(main())

"""The identity of a query, used to recognize an interrupted run."""

from __future__ import annotations

import hashlib
import itertools
import json
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raystream._version import __version__
from raystream.ray_files.blocks import Blocks
from raystream.ray_files.ray_store import RayStore
from raystream.tracer import Tracer

#: Sampled blocks, and rays sampled from each.
SAMPLED_BLOCKS = 16
SAMPLED_RAYS = 256


def identify(
    tracer: Tracer, rays: RayStore, blocks: Blocks, query: str, options: dict[str, Any]
) -> dict[str, Any]:
    """Describe a query in JSON types.

    Parameters
    ----------
    tracer : Tracer
    rays : RayStore
    blocks : Blocks
    query : str
    options : dict
        Options of the query.

    Returns
    -------
    dict
    """
    return {
        "version": __version__,
        "query": query,
        "options": options,
        "scene_digest": scene_digest(tracer.structure.triangles, has_faces=True),
        "triangles": len(tracer.structure.triangles),
        "structure": tracer.structure.name,
        "machine": tracer.machine,
        "device": tracer.device,
        "ray_digest": ray_digest(rays, blocks),
        "shape": list(rays.shape),
        "block": list(blocks.lengths),
    }


def scene_digest(triangles: Any, has_faces: bool = False) -> str:
    """Hash the scene as rays see it: triangles, their order, their meshes and instances.

    With `has_faces`, also the file's faces that hits report.
    """
    digest = hashlib.sha256()
    if has_faces and triangles.attributes is not None:
        faces = triangles.attributes.face_ids
        digest.update(b"faces")
        _add_arrays(digest, [] if faces is None else [faces])
    placed = triangles.instances
    if triangles.kinds not in ((), ("instances",), ("instances", "worlds")):
        _add_arrays(digest, list(triangles.saved_arrays().values()))
        return digest.hexdigest()
    if placed is not None:
        _add_arrays(digest, (placed.object_ids, placed.transforms))
    for one in [triangles] if placed is None else triangles.objects:
        _add_arrays(digest, (one.corners, one.mesh_splits, one.center))
        digest.update(repr(float(one.scale)).encode())
    return digest.hexdigest()


def _add_arrays(digest: Any, arrays: Sequence[NDArray[Any]]) -> None:
    for array in arrays:
        digest.update(f"{array.shape} {array.dtype.str}".encode())
        digest.update(np.ascontiguousarray(array).data)


def ray_digest(rays: RayStore, blocks: Blocks) -> str:
    """Hash how rays are stored, and a sample of rays from all over the store.

    Changes to rays outside the sample go unnoticed: reading all rays takes as long as tracing
    them.
    """
    digest = hashlib.sha256()
    for name, array in sorted(rays.arrays.items()):
        text = json.dumps([name, array.shape, array.dtype.str, array.chunks])
        digest.update(text.encode())
    count = max(blocks.ray_count, 1)
    starts = sorted({count * part // SAMPLED_BLOCKS for part in range(SAMPLED_BLOCKS)})
    for start in starts:
        for block in itertools.islice(blocks.after(start), 1):
            for name, array in sorted(rays.read(_corner(block)).items()):
                digest.update(name.encode())
                digest.update(np.ascontiguousarray(array).data)
    return digest.hexdigest()


def _corner(block: Any) -> Any:
    """Return the box of the first rays of a block."""
    room, box = SAMPLED_RAYS, []
    for part in reversed(block.box):
        length = min(part.stop - part.start, max(room, 1))
        room //= max(length, 1)
        box.append(slice(part.start, part.start + length))
    return block._replace(box=tuple(reversed(box)))

"""Triangles that emit light, where they are in the scene: with instances, each several times."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.core.errors import RaystreamWarning
from raystream.core.instanced_triangles import InstancedTriangles
from raystream.core.spawn import plane_offset
from raystream.scene.lights import AreaLight
from raystream.scene.scene import Scene

#: Instances of more triangles than this, together, glow but are not sampled: a row of tables
#: takes about a hundred bytes.
MOST_EMITTERS = 1 << 22


class Emitters(NamedTuple):
    """Triangles that emit light, without degenerate ones, each where it is in the scene.

    Attributes
    ----------
    corners : ndarray of shape (A, 3, 3), float64
        Scene's local frame; the side that emits sees them counter-clockwise.
    prim_ids, instance_ids : ndarray of shape (A,), int32
    offsets : ndarray of shape (A,), float64
        Local frame: how far from a triangle rays must start or end, for the rounding in the space
        of its object; see `core.spawn`. 0 without instances.
    """

    corners: NDArray[np.float64]
    prim_ids: NDArray[np.int32]
    instance_ids: NDArray[np.int32]
    offsets: NDArray[np.float64]


def sampled_lights(scene: Scene) -> list[AreaLight]:
    """The scene's area lights; none if they are too many to be sampled.

    Warns
    -----
    RaystreamWarning
        If they have more than `MOST_EMITTERS` triangles in all instances.
    """
    lights = scene.area_lights
    held: Any = scene.triangles
    if held.instances is None:
        return lights
    prims = np.concatenate([np.empty(0, np.int64), *(one.prim_ids for one in lights)])
    owners = np.searchsorted(held.first_prims, prims, side="right") - 1
    counts = np.bincount(owners.astype(np.int64), minlength=len(held.objects))
    count = int(counts[held.instances.object_ids].sum())
    if count <= MOST_EMITTERS:
        return lights
    warnings.warn(
        f"lights: {count:,} triangles that emit light in all instances are more than "
        f"{MOST_EMITTERS:,}: they glow, but are not sampled as lights, so images are noisy, and "
        "other lights may be added; lights='file' adds none",
        RaystreamWarning,
        stacklevel=3,
    )
    return []


def emitters_of(scene: Scene, lights: Sequence[AreaLight]) -> Emitters:
    """The triangles of some of a scene's area lights, sorted by instance and prim_id."""
    prims = np.unique(np.concatenate([np.empty(0, np.int32), *(one.prim_ids for one in lights)]))
    prims = prims.astype(np.int32)
    held: Any = scene.triangles
    if len(prims) and held.instances is not None:
        return _in_instances(held, prims)
    corners = np.zeros((0, 3, 3))
    if len(prims):  # intersect1d would sort the scene's, too
        prims = prims[np.isin(prims, held.solid_numbers())]
        corners = held.object_corners()[prims].astype(np.float64)
    return Emitters(corners, prims, np.zeros(len(prims), np.int32), np.zeros(len(prims)))


def _in_instances(triangles: InstancedTriangles, prims: NDArray[np.int32]) -> Emitters:
    first, objects = triangles.first_prims, triangles.objects
    own = [  # of each object
        found[np.isin(found - first[k], one.solid_numbers())]
        for k, one in enumerate(objects)
        for found in [
            prims[np.searchsorted(prims, first[k]) : np.searchsorted(prims, first[k + 1])]
        ]
    ]
    ids = triangles.instances.object_ids
    counts = np.array([len(one) for one in own], np.int64)[ids]
    lit = np.flatnonzero(counts)
    instance_ids = np.repeat(lit, counts[lit]).astype(np.int32)
    prim_ids = np.concatenate([np.empty(0, np.int32), *(own[ids[k]] for k in lit)])
    return _placed(triangles, prim_ids.astype(np.int32), instance_ids)


def _placed(
    triangles: InstancedTriangles, prim_ids: NDArray[np.int32], instance_ids: NDArray[np.int32]
) -> Emitters:
    inside = triangles.corners_at(prim_ids, instance_ids)
    world = triangles.points_to_world(inside, instance_ids)
    corners = (world - triangles.center) * triangles.scale
    linear = triangles.instances.transforms[instance_ids, :, :3]
    mirrored = np.linalg.det(linear) < 0.0
    corners[mirrored] = corners[mirrored][:, [0, 2, 1]]
    # The triangle test's rounding in object space, as long as it may be in the scene.
    stretch = np.linalg.norm(linear, axis=(1, 2)) * triangles.scale
    stretch /= triangles.scales_at(instance_ids)
    inside = inside * triangles.corner_scales(instance_ids)[:, None, None]
    extent, reach = np.ptp(inside, axis=1).max(axis=1), np.abs(inside).max(axis=(1, 2))
    offsets = stretch * plane_offset(extent, reach, triangles.reaches_at(instance_ids))
    return Emitters(corners, prim_ids, instance_ids, offsets)

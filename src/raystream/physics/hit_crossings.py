"""Crossings of spheres, height fields and triangles in float64: entry or exit, by hits alone."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from raystream.core.hits import MultiHits
from raystream.core.primitives import Primitives
from raystream.core.rays import RayBatch
from raystream.kernels.ray import PAD
from raystream.kernels.solids import Solids, solids_of
from raystream.physics.pairing import ROUNDING, Crossings
from raystream.physics.thickness import direction_lengths

#: How far the test of triangles in float64 may shift a ray sideways, as `PAD` in float32.
_PAD_F64 = 2.0**-49


def solids_with(primitives: Primitives) -> Solids:
    """The solids of a scene: its meshes, height fields, all spheres, and shapes of each kind.

    Height fields are open, and so are shapes without a distance.
    """
    found = solids_of(primitives.triangles)
    spheres = bool(len(primitives.spheres))
    of_fields, of_spheres = [False] * len(primitives.fields), [True] * spheres
    of_shapes = [one.functions.has_distance for one in primitives.shapes]
    with np.errstate(over="ignore"):
        volume = 4.0 / 3.0 * np.pi * float((primitives.spheres.radii**3).sum())
    empty = [one.is_empty for one in primitives.fields]
    empty += [*[False] * spheres, *(not len(one) for one in primitives.shapes)]
    # Volumes order solids that hold each other: of shapes, those of their boxes do.
    boxes = [float(np.ptp(one.bounds, axis=1).prod(axis=1).sum()) for one in primitives.shapes]
    open_fields = [np.inf] * len(of_fields)
    return Solids(
        np.append(found.is_closed, [*of_fields, *of_spheres, *of_shapes]).astype(bool),
        np.append(found.is_flipped, np.zeros(len(empty), bool)),
        np.append(found.is_empty, empty).astype(bool),
        np.append(found.has_slivers, np.zeros(len(empty), bool)),
        np.append(found.volumes, [*open_fields, *([volume] * spheres), *boxes]),
        found.is_closed_together and all(empty[: len(of_fields)]) and all(of_shapes),
    )


def classify_hits(
    batch: RayBatch, rows: slice, hits: MultiHits, is_flipped: NDArray[np.bool_], out: Crossings
) -> None:
    """Write `mesh_id`, `kind` and `slack` of crossings.

    Parameters
    ----------
    batch : RayBatch
    rows : slice
        The rays of these hits.
    hits : MultiHits
    is_flipped : ndarray of shape (M,), bool
        See `Solids`.
    out : Crossings
    """
    store: Any = hits._triangles
    out.mesh_id[:] = hits.mesh_id
    rays, lengths = hits.ray_id, direction_lengths(batch, rows)
    directions = batch.directions[rows].astype(np.float64)
    # Step 1: the sides of the surfaces from which rays come.
    with np.errstate(invalid="ignore", divide="ignore"):
        directions = directions / lengths[:, None]
    cosine = np.einsum("nk,nk->n", hits._world_normals(), directions[rays])
    exits = (cosine > 0.0) != is_flipped[out.mesh_id]
    # Step 2: of two hits of one sphere, the second is the exit, however much it was grazed.
    ids = hits.instance_id
    order = np.lexsort((np.arange(len(rays)), hits.prim_id, ids, rays))
    first, second = order[:-1], order[1:]
    is_pair = (hits.prim_id[first] == hits.prim_id[second]) & (rays[first] == rays[second])
    is_pair &= ids[first] == ids[second]
    is_pair &= store.sphere_rows(hits.prim_id[first]) >= 0
    exits[first[is_pair]], exits[second[is_pair]] = False, True
    out.kind[:] = exits
    # Step 3: what rounding may have moved t by, as `pairing.classify_crossing` has it.
    is_wide = store.number_type is np.float64
    extent, far = store.reaches_at(ids)
    near = np.abs(batch.origins[rows].astype(np.float64) - store.center).max(axis=1, initial=0.0)
    reach = store.world_lengths(extent + far if is_wide else extent, ids) + near[rays]
    with np.errstate(invalid="ignore", divide="ignore"):
        aside = (_PAD_F64 if is_wide else float(PAD)) * reach / lengths[rays]
        rounding = 2.0**-51 if is_wide else ROUNDING
        out.slack[:] = aside / np.abs(cosine) + rounding * np.abs(hits.t)

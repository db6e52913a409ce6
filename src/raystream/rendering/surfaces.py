"""What shading kernels take of surfaces that rays hit: the hits, and tables of their triangles."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from raystream.core.hits import Hits, MultiHits
from raystream.rendering.shading.placed_tables import ObjectTables, placed_tables
from raystream.rendering.shading.primitive_tables import MeshTables, primitive_tables
from raystream.rendering.shading.streams import ShadingBatch
from raystream.rendering.shading.tables import SceneArrays, SceneTables
from raystream.scene.scene import Scene

if TYPE_CHECKING:
    from raystream.rendering.integrator import Band, PathStream, RenderContext


class Surfaces(NamedTuple):
    """What shading kernels take of a stream whose rays have been traced.

    Attributes
    ----------
    batch : ShadingBatch
        The paths at the surfaces that they hit.
    tables : SceneTables
        Of the scene; or with instances, of the triangles that are hit.
    kept : object
        To be kept while kernels use them.
    """

    batch: ShadingBatch
    tables: SceneTables
    kept: object


def surfaces_of(stream: PathStream, band: Band) -> Surfaces:
    """The stream's paths at the surfaces that they hit, as shading kernels take them."""
    assert stream.hits is not None
    tables, rows, kept = tables_at(band.context, stream.hits)
    batch = ShadingBatch(len(stream), stream.paths, rows, band.first_pixel, band.radiance)
    return Surfaces(batch, tables, kept)


def tables_at(
    context: RenderContext, hits: Hits | MultiHits
) -> tuple[SceneTables, tuple[Any, ...], object]:
    """The tables of the surfaces that are hit, the hits' columns for them, and what to keep."""
    kept: object = None
    tables, columns = context.tables, (hits.t, hits.u, hits.v, hits.prim_id)
    if isinstance(context.objects, MeshTables):
        tables, columns, kept = primitive_tables(context.tables, context.objects, hits)
    elif context.objects is not None:
        tables, columns, kept = placed_tables(context.tables, context.objects, hits)
    # Shading is in float32, of triangles whose corners were rounded, as offsets of rays allow for.
    *places, prim_id = columns
    return tables, (*(one.astype(np.float32, copy=False) for one in places), prim_id), kept


def objects_of(scene: Scene, arrays: SceneArrays) -> ObjectTables | MeshTables | None:
    """The tables of the objects of a scene with instances, or of the meshes beside primitives."""
    triangles: Any = scene.triangles
    if triangles.has_primitives:
        return MeshTables.of(arrays)
    return None if triangles.instances is None else ObjectTables.of(triangles, arrays)

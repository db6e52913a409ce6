"""The callbacks of JAX: what runs outside of compiled functions, and derivatives around it."""

from __future__ import annotations

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.dtypes import canonicalize_dtype
from numpy.typing import NDArray

from raystream.core.crossing import (
    HitRows,
    check_vertices,
    inverse_rows,
    points_at,
    vertex_ids,
    vertex_slopes,
)
from raystream.core.padded_hits import pad
from raystream.tracer import Tracer

Columns = tuple[Any, Any, Any, Any, Any]


# ---- On the host, with NumPy.


def _checked(tracer: Tracer, vertices: tuple[Any, ...], rank: int) -> tuple[int, ...]:
    """Check vertices, if there are any; returns the shape that a batch of them has in this rank."""
    if not vertices:
        return ()
    given = np.asarray(vertices[0])
    own = [mesh.vertices for mesh in tracer.scene.meshes]
    check_vertices(own, given, lambda array, dtype: array.astype(dtype))
    return given.shape[:-2] + (1,) * (rank - given.ndim + 2)


def _host(tracer: Tracer, arrays: tuple[Any, ...]) -> dict[str, Any]:
    origins, directions, t_min, t_max = map(np.asarray, arrays[:4])
    batch = _checked(tracer, arrays[4:], t_max.ndim)
    # Of a batch in which only limits or vertices differ, they give the rays their shape.
    shape = np.broadcast_shapes(
        origins.shape[:-1], directions.shape[:-1], t_min.shape, t_max.shape, batch
    )
    if shape != np.broadcast_shapes(origins.shape[:-1], directions.shape[:-1]):
        origins = np.broadcast_to(origins, (*shape, 3))
    return {"origins": origins, "directions": directions, "t_min": t_min, "t_max": t_max}


def _first_on_host(tracer: Tracer, *rays: Any) -> tuple[NDArray[Any], ...]:
    hits = tracer.first_hit(**_host(tracer, rays))
    return _in_jax_types(hits.t, hits.u, hits.v, hits.prim_id, hits.instance_id)


def _in_jax_types(*columns: NDArray[Any]) -> tuple[NDArray[Any], ...]:
    """Columns without float64, unless JAX has that."""
    return tuple(one.astype(canonicalize_dtype(one.dtype), copy=False) for one in columns)


def _any_on_host(tracer: Tracer, *rays: Any) -> NDArray[np.bool_]:
    return tracer.any_hit(**_host(tracer, rays))


def _count_on_host(tracer: Tracer, crossings: Any, *rays: Any) -> NDArray[np.int32]:
    return tracer.count_hits(**_host(tracer, rays), crossings=crossings).astype(np.int32)


def _multi_on_host(
    tracer: Tracer, max_hits: int, crossings: Any, *rays: Any
) -> tuple[NDArray[Any], ...]:
    found = tracer.multi_hit(**_host(tracer, rays), max_hits=max_hits, crossings=crossings)
    return _in_jax_types(*pad(found, max_hits))


def _corners_on_host(tracer: Tracer, dtype: Any, *rows: Any) -> NDArray[Any]:
    hits: Any = HitRows(*np.broadcast_arrays(*rows))
    return tracer.structure.triangles.touching_corners(hits).astype(dtype)


def _vertex_ids_on_host(tracer: Tracer, prim_id: Any, *vertices: Any) -> NDArray[np.int32]:
    ids = np.asarray(prim_id)
    batch = _checked(tracer, vertices, ids.ndim)
    ids = np.broadcast_to(ids, np.broadcast_shapes(ids.shape, batch))
    return vertex_ids(tracer.scene, ids)


def _slopes_on_host(tracer: Tracer, dtype: Any, *ids: Any) -> NDArray[Any]:
    return vertex_slopes(tracer.scene, *np.broadcast_arrays(*ids)).astype(dtype)


# ---- In JAX.


def _ask(host: Any, results: Any, rays: tuple[Any, ...], vertices: Any = None) -> Any:
    """Call back with rays of one rank, so that a batch axis is the first of all arrays."""
    rank = max(rays[0].ndim, rays[1].ndim) - 1
    widths = rank + 1, rank + 1, rank, rank
    padded = [
        one.reshape((1,) * (width - one.ndim) + one.shape)
        for one, width in zip(rays, widths, strict=True)
    ]
    padded += [] if vertices is None else [vertices]
    return jax.pure_callback(host, results, *padded, vmap_method="expand_dims")


def _shape(rays: tuple[Any, ...], *more: int) -> tuple[int, ...]:
    leading = jnp.broadcast_shapes(rays[0].shape[:-1], rays[1].shape[:-1])
    return (*leading, *more)


def _columns(tracer: Tracer, shape: tuple[int, ...]) -> Any:
    dtype = canonicalize_dtype(tracer.structure.triangles.number_type)
    number, index = jax.ShapeDtypeStruct(shape, dtype), jax.ShapeDtypeStruct(shape, jnp.int32)
    return number, number, number, index, index


def any_hit(tracer: Tracer, rays: tuple[Any, ...]) -> Any:
    """See `Tracer.any_hit`."""
    result = jax.ShapeDtypeStruct(_shape(rays), jnp.bool_)
    return _ask(partial(_any_on_host, tracer), result, jax.lax.stop_gradient(rays))


def count_hits(tracer: Tracer, crossings: str, rays: tuple[Any, ...]) -> Any:
    """See `Tracer.count_hits`; int32."""
    result = jax.ShapeDtypeStruct(_shape(rays), jnp.int32)
    return _ask(partial(_count_on_host, tracer, crossings), result, jax.lax.stop_gradient(rays))


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def first_hit(tracer: Tracer, rays: tuple[Any, ...], vertices: Any) -> Columns:
    """t, u, v and prim_id of the nearest hits; see `Tracer.first_hit`."""
    return _ask(partial(_first_on_host, tracer), _columns(tracer, _shape(rays)), rays, vertices)


@partial(jax.custom_jvp, nondiff_argnums=(0, 1, 2))
def multi_hit(
    tracer: Tracer, max_hits: int, crossings: str, rays: tuple[Any, ...], vertices: Any
) -> Columns:
    """t, u, v and prim_id of the nearest few hits; see `Tracer.multi_hit`."""
    host = partial(_multi_on_host, tracer, max_hits, crossings)
    return _ask(host, _columns(tracer, _shape(rays, max_hits)), rays, vertices)


@first_hit.defjvp
def _first_hit_derivatives(tracer: Tracer, primals: Any, tangents: Any) -> Any:
    found = first_hit(tracer, *primals)
    return found, _derivatives(tracer, found, primals, tangents, lambda vectors: vectors)


@multi_hit.defjvp
def _multi_hit_derivatives(
    tracer: Tracer, max_hits: int, crossings: str, primals: Any, tangents: Any
) -> Any:
    found = multi_hit(tracer, max_hits, crossings, *primals)
    return found, _derivatives(
        tracer, found, primals, tangents, lambda vectors: vectors[..., None, :]
    )


def _derivatives(tracer: Tracer, found: Columns, primals: Any, tangents: Any, lone: Any) -> Any:
    """Derivatives of t, u and v, with the hit triangles held fixed: see `core.crossing`."""
    t, u, v, prim_id, _ = found
    is_hit = prim_id >= 0
    (rays, vertices), (ray_tangents, vertex_tangents) = primals, tangents
    corners = _corners(tracer, found, vertices)
    rows = inverse_rows(jnp, _float(lone(rays[1])), corners, is_hit)
    t = jnp.where(is_hit, t, 0.0)
    change: Any = 0.0
    for scale, tangent in zip((1.0, t[..., None]), ray_tangents[:2], strict=True):
        if tangent.dtype != jax.dtypes.float0:  # of integers
            change = change + scale * _float(lone(tangent))
    if vertices is not None:
        ids = _vertex_ids(tracer, prim_id, None)
        weights = jnp.stack((1.0 - u - v, u, v), axis=-1)
        moved = (weights[..., None] * _float(vertex_tangents)[ids]).sum(axis=-2)
        change = change - _of_vertices(tracer, found, moved)
    change = jnp.broadcast_to(change, (*prim_id.shape, 3))
    slopes = [
        sum(row[k] * jnp.where(is_hit, change[..., k], 0.0) for k in range(3)) for row in rows
    ]
    none = np.zeros(prim_id.shape, jax.dtypes.float0)
    return (*(jnp.asarray(one, found[0].dtype) for one in slopes), none, none)


def _float(array: Any) -> Any:
    """Floating-point numbers of at least single precision."""
    return array.astype(jnp.promote_types(array.dtype, jnp.float32))


def points(tracer: Tracer, hits: Columns, vertices: Any) -> Any:
    """Points on the triangles that were hit, of the hits' shape + (3,)."""
    _, u, v, prim_id, _ = hits
    corners = _corners(tracer, hits, vertices, is_checked=False)
    u, v = u.astype(corners.dtype), v.astype(corners.dtype)
    return jnp.stack(points_at(jnp, corners, u, v, prim_id >= 0), axis=-1)


def _corners(tracer: Tracer, hits: Columns, vertices: Any, *, is_checked: bool = True) -> Any:
    """Corners of triangles, or of what touches surfaces, of the hits' shape + (3, 3)."""
    if vertices is not None:
        ids = _vertex_ids(tracer, hits[3], None if is_checked else vertices)
        moved = _float(vertices)[ids]
        if _is_meshes(tracer):
            return moved
    corners = _constant(_corners_on_host, tracer, *hits[1:])
    if vertices is not None:
        corners = corners + _of_vertices(tracer, hits, moved - jax.lax.stop_gradient(moved))
    return corners


def _is_meshes(tracer: Tracer) -> bool:
    """Whether all that can be hit is triangles of meshes, where they are."""
    store = tracer.structure.triangles
    return store.instances is None and not store.has_primitives


def _of_vertices(tracer: Tracer, hits: Columns, moved: Any) -> Any:
    """Changes of vertices, or of points between them, in world space."""
    if _is_meshes(tracer):
        return moved
    slopes = _constant(_slopes_on_host, tracer, *hits[3:])
    slopes = slopes.reshape(*slopes.shape[:-2], *(1,) * (moved.ndim - slopes.ndim + 1), 3, 3)
    return (slopes @ moved[..., None])[..., 0]


@partial(jax.custom_jvp, nondiff_argnums=(0, 1))
def _constant(host: Any, tracer: Tracer, *rows: Any) -> Any:
    """What the host says of hits, of their shape + (3, 3), without derivatives."""
    dtype = jnp.result_type(float)
    result = jax.ShapeDtypeStruct((*rows[0].shape, 3, 3), dtype)
    return jax.pure_callback(partial(host, tracer, dtype), result, *rows, vmap_method="expand_dims")


@_constant.defjvp
def _no_derivatives(host: Any, tracer: Tracer, primals: Any, _: Any) -> Any:
    found = _constant(host, tracer, *primals)
    return found, jnp.zeros_like(found)


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def _vertex_ids(tracer: Tracer, prim_id: Any, checked: Any) -> Any:
    result = jax.ShapeDtypeStruct((*prim_id.shape, 3), jnp.int32)
    arguments = (prim_id,) if checked is None else (prim_id, checked)
    host = partial(_vertex_ids_on_host, tracer)
    return jax.pure_callback(host, result, *arguments, vmap_method="expand_dims")


@_vertex_ids.defjvp
def _no_derivatives_of_ids(tracer: Tracer, primals: Any, _: Any) -> Any:
    ids = _vertex_ids(tracer, *primals)
    return ids, np.zeros(ids.shape, jax.dtypes.float0)

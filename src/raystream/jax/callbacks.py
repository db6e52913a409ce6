"""The callbacks of JAX: what runs outside of compiled functions, and derivatives around it."""

from __future__ import annotations

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from raystream.core.crossing import check_vertices, corners_of, inverse_rows, points_at
from raystream.core.padded_hits import pad
from raystream.tracer import Tracer

Columns = tuple[Any, Any, Any, Any]


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
    return hits.t, hits.u, hits.v, hits.prim_id


def _any_on_host(tracer: Tracer, *rays: Any) -> NDArray[np.bool_]:
    return tracer.any_hit(**_host(tracer, rays))


def _count_on_host(tracer: Tracer, crossings: Any, *rays: Any) -> NDArray[np.int32]:
    return tracer.count_hits(**_host(tracer, rays), crossings=crossings).astype(np.int32)


def _multi_on_host(
    tracer: Tracer, max_hits: int, crossings: Any, *rays: Any
) -> tuple[NDArray[Any], ...]:
    found = tracer.multi_hit(**_host(tracer, rays), max_hits=max_hits, crossings=crossings)
    return tuple(pad(found, max_hits))


def _corners_on_host(tracer: Tracer, dtype: Any, prim_id: Any) -> NDArray[Any]:
    return corners_of(tracer.structure.triangles, np.asarray(prim_id)).astype(dtype)


def _vertex_ids_on_host(tracer: Tracer, prim_id: Any, *vertices: Any) -> NDArray[np.int32]:
    ids = np.asarray(prim_id)
    batch = _checked(tracer, vertices, ids.ndim)
    faces = tracer.scene.attributes.faces
    faces = faces if len(faces) else np.zeros((1, 3), np.int32)
    return faces[np.broadcast_to(np.maximum(ids, 0), np.broadcast_shapes(ids.shape, batch))]


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


def _columns(shape: tuple[int, ...]) -> Any:
    number, index = jax.ShapeDtypeStruct(shape, jnp.float32), jax.ShapeDtypeStruct(shape, jnp.int32)
    return number, number, number, index


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
    return _ask(partial(_first_on_host, tracer), _columns(_shape(rays)), rays, vertices)


@partial(jax.custom_jvp, nondiff_argnums=(0, 1, 2))
def multi_hit(
    tracer: Tracer, max_hits: int, crossings: str, rays: tuple[Any, ...], vertices: Any
) -> Columns:
    """t, u, v and prim_id of the nearest few hits; see `Tracer.multi_hit`."""
    host = partial(_multi_on_host, tracer, max_hits, crossings)
    return _ask(host, _columns(_shape(rays, max_hits)), rays, vertices)


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
    t, u, v, prim_id = found
    is_hit = prim_id >= 0
    (rays, vertices), (ray_tangents, vertex_tangents) = primals, tangents
    corners = _corners(tracer, prim_id, vertices)
    rows = inverse_rows(jnp, _float(lone(rays[1])), corners, is_hit)
    t = jnp.where(is_hit, t, 0.0)
    change: Any = 0.0
    for scale, tangent in zip((1.0, t[..., None]), ray_tangents[:2], strict=True):
        if tangent.dtype != jax.dtypes.float0:  # of integers
            change = change + scale * _float(lone(tangent))
    if vertices is not None:
        ids = _vertex_ids(tracer, prim_id, None)
        weights = jnp.stack((1.0 - u - v, u, v), axis=-1)
        change = change - (weights[..., None] * _float(vertex_tangents)[ids]).sum(axis=-2)
    change = jnp.broadcast_to(change, (*prim_id.shape, 3))
    slopes = [
        sum(row[k] * jnp.where(is_hit, change[..., k], 0.0) for k in range(3)) for row in rows
    ]
    floats = tuple(jnp.asarray(one, jnp.float32) for one in slopes)
    return (*floats, np.zeros(prim_id.shape, jax.dtypes.float0))


def _float(array: Any) -> Any:
    """Floating-point numbers of at least single precision."""
    return array.astype(jnp.promote_types(array.dtype, jnp.float32))


def points(tracer: Tracer, hits: Columns, vertices: Any) -> Any:
    """Points on the triangles that were hit, of the hits' shape + (3,)."""
    _, u, v, prim_id = hits
    corners = _corners(tracer, prim_id, vertices, is_checked=False)
    u, v = u.astype(corners.dtype), v.astype(corners.dtype)
    return jnp.stack(points_at(jnp, corners, u, v, prim_id >= 0), axis=-1)


def _corners(tracer: Tracer, prim_id: Any, vertices: Any, *, is_checked: bool = True) -> Any:
    """Corners of triangles, of the hits' shape + (3, 3)."""
    if vertices is None:
        return _constant_corners(tracer, prim_id)
    return _float(vertices)[_vertex_ids(tracer, prim_id, None if is_checked else vertices)]


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def _constant_corners(tracer: Tracer, prim_id: Any) -> Any:
    dtype = jnp.result_type(float)
    result = jax.ShapeDtypeStruct((*prim_id.shape, 3, 3), dtype)
    host = partial(_corners_on_host, tracer, dtype)
    return jax.pure_callback(host, result, prim_id, vmap_method="expand_dims")


@_constant_corners.defjvp
def _no_derivatives_of_corners(tracer: Tracer, primals: Any, _: Any) -> Any:
    corners = _constant_corners(tracer, *primals)
    return corners, jnp.zeros_like(corners)


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

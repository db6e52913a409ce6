"""How the crossing of a ray and its triangle moves with them: for libraries with gradients.

A hit solves ``origin + t direction = first + u (second - first) + v (third - first)``. With the
triangle held fixed, differentiating both sides gives a linear equation for the changes of t, u, v:

    M (dt, du, dv) = d origin + t d direction - (1 - u - v) d first - u d second - v d third

where the columns of M are -direction and the two edges. All is written once, with operators and
``where`` alone, for NumPy, PyTorch and JAX.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

#: What a miss is replaced by, so that its numbers and gradients are finite: a triangle, and the
#: direction of a ray that crosses it.
_CORNERS = ((0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0))
_DIRECTION = (0.0, 0.0, -1.0)

Vector = tuple[Any, Any, Any]


def inverse_rows(
    library: Any, directions: Any, corners: Any, is_hit: Any
) -> tuple[Vector, Vector, Vector]:
    """The rows of the inverse of M: the slopes of t, u and v by the ray's origin.

    Parameters
    ----------
    library : module
        `numpy`, `torch` or `jax.numpy`, whose arrays the others are.
    directions : array of shape S + (3,), float
    corners : array of shape S + (3, 3), float
        Vertices 0, 1 and 2 of the triangle of each ray.
    is_hit : array of shape S, bool

    Returns
    -------
    three tuples of three arrays of shape S
        x, y and z of each row. 0, with derivatives of 0, for misses, whatever their numbers are,
        and where the ray lies in the triangle's plane as far as the precision can tell.
    """
    where = library.where
    direction = _components(where, is_hit, directions, _DIRECTION)
    first, second, third = (
        _components(where, is_hit, corners[..., k, :], _CORNERS[k]) for k in range(3)
    )
    along_u = [q - p for p, q in zip(first, second, strict=True)]
    along_v = [q - p for p, q in zip(first, third, strict=True)]
    normal = _cross(along_u, along_v)
    volume = -sum(a * b for a, b in zip(direction, normal, strict=True))
    is_sound = is_hit & (volume != 0.0)
    inverse = where(is_sound, 1.0 / where(is_sound, volume, 1.0), 0.0)
    by_t, by_u, by_v = (
        tuple(_finite(library, one * inverse) for one in row)
        for row in (normal, _cross(direction, along_v), _cross(along_u, direction))
    )
    return by_t, by_u, by_v


def points_at(library: Any, corners: Any, u: Any, v: Any, is_hit: Any) -> Vector:
    """The points of triangles with these weights of vertices 1 and 2; a miss has NaN.

    Parameters
    ----------
    library : module
    corners : array of shape S + (3, 3), float
    u, v : array of shape S, float
    is_hit : array of shape S, bool

    Returns
    -------
    x, y, z : arrays of shape S
    """
    first, second, third = (
        _components(library.where, is_hit, corners[..., k, :], _CORNERS[k]) for k in range(3)
    )
    x, y, z = (
        library.where(is_hit, a + u * (b - a) + v * (c - a), np.nan)
        for a, b, c in zip(first, second, third, strict=True)
    )
    return x, y, z


def _components(where: Any, is_hit: Any, vectors: Any, instead: tuple[float, ...]) -> list[Any]:
    return [where(is_hit, vectors[..., k], instead[k]) for k in range(3)]


def _finite(library: Any, values: Any) -> Any:
    """0 for what overflows: rays that all but lie in the triangle's plane."""
    return library.where(library.isfinite(values), values, 0.0)


def _cross(a: Any, b: Any) -> Vector:
    return (
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    )


class HitRows(NamedTuple):
    """What says where hits are, in NumPy arrays of one shape; see `Hits`."""

    u: NDArray[Any]
    v: NDArray[Any]
    prim_id: NDArray[np.int32]
    instance_id: NDArray[np.int32]


def vertex_ids(scene: Any, prim_id: NDArray[np.int32]) -> NDArray[np.int32]:
    """Rows of the meshes' vertices 0, 1 and 2 of hits, shape S + (3,); any where there are none."""
    faces: NDArray[np.int32] = scene.attributes.faces
    faces = faces if len(faces) else np.zeros((1, 3), np.int32)
    return faces[np.clip(prim_id, 0, len(faces) - 1)]


def vertex_slopes(
    scene: Any, prim_id: NDArray[np.int32], instance_id: NDArray[np.int32]
) -> NDArray[np.float64]:
    """Derivatives of corners in world space by the vertices of meshes, shape S + (3, 3).

    Those of instances' transforms; 0 for spheres, height fields and misses.
    """
    placed, linear = scene.placements, np.eye(3)
    if placed is not None and len(placed):
        linear = placed.transforms[np.maximum(instance_id, 0), :, :3]
    is_mesh = (prim_id >= 0) & (prim_id < len(scene.attributes.faces))
    return np.where(is_mesh[..., None, None], linear, 0.0)


def check_vertices(own: Sequence[Any], given: Any, cast: Callable[[Any, Any], Any]) -> None:
    """Check that vertices given to a query are those that it traces.

    Parameters
    ----------
    own : arrays of shape (V, 3), float
        The vertices of each of the tracer's meshes.
    given : array of shape (..., V, 3), float
        Of the same library: of all meshes, one after another, for each row of a batch.
    cast : callable
        Casts an array of the library to one of its dtypes.

    Raises
    ------
    ValueError
        If their number differs, or a vertex does after both are rounded to the coarser dtype.
    """
    first, count = 0, sum(len(one) for one in own)
    if given.shape[-2] != count:
        raise ValueError(f"vertices: expected the scene's {count:,}, got {given.shape[-2]:,}")
    for mesh, one in enumerate(own):
        part = given[..., first : first + len(one), :]
        dtype = min(one.dtype, part.dtype, key=lambda dtype: dtype.itemsize)
        with np.errstate(over="ignore"):
            ours, theirs = cast(one, dtype), cast(part, dtype)
        is_same = ours == theirs
        if not is_same.all() and not (is_same | ((ours != ours) & (theirs != theirs))).all():
            raise ValueError(
                f"vertices: those of mesh {mesh} differ from the tracer's, which rays are traced "
                "against; call Tracer.update with them first"
            )
        first += len(one)

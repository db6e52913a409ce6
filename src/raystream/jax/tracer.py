"""JaxTracer: the queries of a tracer inside JAX's transformations."""

from __future__ import annotations

import math
import operator
from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from raystream.core.array_checks import checked_rays, checked_vertices
from raystream.core.query import counts_surfaces
from raystream.core.scene_kinds import check_support
from raystream.jax import callbacks
from raystream.tracer import Tracer


class JaxHits(NamedTuple):
    """Hits in arrays of the rays' shape S, or S + (max_hits,).

    See `Hits` for what they are; ``t``, ``u`` and ``v`` have derivatives.
    """

    t: jax.Array
    u: jax.Array
    v: jax.Array
    prim_id: jax.Array
    instance_id: jax.Array


class JaxTracer:
    """A tracer whose queries run inside ``jit``, ``vmap`` and ``grad``.

    Parameters
    ----------
    tracer : Tracer
        After its `Tracer.update`, all queries use the moved triangles, including compiled ones.

    Raises
    ------
    TypeError
        If `tracer` is not a `Tracer`.

    Notes
    -----
    Functions may close over it, or take it as an argument: for ``jit`` it is a constant, compared
    by identity.

    Every query takes `origins` and `directions` of any leading shape S: arrays of shape S + (3,)
    that broadcast, of any real dtype. `t_min` and `t_max` are numbers or arrays that broadcast to
    S. The query is a callback (`jax.pure_callback`): rays go to the host, without a copy if they
    are on the CPU, and results have the same bits as the tracer's. Under ``vmap`` all rays are
    traced in one batch. No memory is needed for pairs of rays and triangles. Without
    ``jax_enable_x64`` JAX converts numbers and lists to float32 before they reach the tracer.

    ``t``, ``u`` and ``v`` have derivatives with respect to `origins`, `directions` and `vertices`,
    forward and reverse, of any order: those of the intersection of the ray with the triangle that
    it hit, held fixed, in the arrays' precision. They are exact as long as the ray hits that
    triangle. **They say nothing about visibility**: where a ray passes from one triangle to
    another, over an edge or a silhouette, the result jumps, which the derivative does not reflect.
    Misses have no derivatives: they contribute zeros, never NaN.

    Scenes may have instances, spheres and height fields, and be traced in float64, of which ``t``,
    ``u`` and ``v`` are float64 with ``jax_enable_x64``. Vertices of instances are those of their
    objects, and have the derivatives of all instances. Spheres and height fields have no vertices:
    derivatives are by rays. Those of a sphere are of the first order only: derivatives of these
    are of the plane that touches it.

    Examples
    --------
    >>> import jax
    >>> import jax.numpy as jnp
    >>> import raystream as rs
    >>> from raystream.jax import JaxTracer
    >>> tracer = JaxTracer(rs.Tracer(rs.load("cornell")))
    >>> def depth(origin):
    ...     return tracer.first_hit(origin, jnp.array([0.0, 0.0, 1.0])).t
    >>> origin = jnp.array([278.0, 273.0, -800.0])
    >>> t, slope = jax.jit(jax.value_and_grad(depth))(origin)
    >>> round(float(t), 1), [round(float(one), 3) for one in slope]
    (1092.0, [-0.31, 0.0, -1.0])
    """

    def __init__(self, tracer: Tracer) -> None:
        if not isinstance(tracer, Tracer):
            raise TypeError(f"tracer: expected a Tracer, got {type(tracer).__name__}")
        check_support("raystream.jax", tracer.structure.triangles)
        self.tracer = tracer

    def first_hit(
        self,
        origins: Any,
        directions: Any,
        *,
        t_min: Any = 0.0,
        t_max: Any = math.inf,
        vertices: Any = None,
    ) -> JaxHits:
        """Find the nearest triangle along each ray.

        Parameters
        ----------
        origins, directions : array_like of shape S + (3,), real
            World space; they broadcast.
        t_min, t_max : float or array_like that broadcasts to S
            Closed search interval, in direction lengths; without derivatives.
        vertices : array of shape (V, 3), float, or one for each mesh, optional
            The scene's vertices, for derivatives: one mesh after another. Rays are traced against
            the tracer's own, which must be the same numbers, rounded to the coarser dtype of the
            two: call `Tracer.update` with them first. Comparing takes time for every vertex.

        Returns
        -------
        JaxHits
            Of shape S. A miss has ``t = inf`` and ``prim_id = -1``.

        Raises
        ------
        TypeError
            If a dtype is not real.
        ValueError
            If shapes disagree, or `vertices` differ from the tracer's.
        """
        rays = _rays(origins, directions, t_min, t_max)
        return JaxHits(*callbacks.first_hit(self.tracer, rays, _joined(vertices)))

    def any_hit(
        self, origins: Any, directions: Any, *, t_min: Any = 0.0, t_max: Any = math.inf
    ) -> jax.Array:
        """Find whether anything blocks each ray.

        Parameters
        ----------
        origins, directions, t_min, t_max
            See `first_hit`.

        Returns
        -------
        Array of shape S, bool
        """
        rays = _rays(origins, directions, t_min, t_max)
        return callbacks.any_hit(self.tracer, rays)

    def count_hits(
        self,
        origins: Any,
        directions: Any,
        *,
        t_min: Any = 0.0,
        t_max: Any = math.inf,
        crossings: str = "triangles",
    ) -> jax.Array:
        """Count the hits along each ray.

        Parameters
        ----------
        origins, directions, t_min, t_max
            See `first_hit`.
        crossings : {"triangles", "surfaces"}
            See `Tracer.count_hits`.

        Returns
        -------
        Array of shape S, int32
        """
        counts_surfaces(crossings)
        rays = _rays(origins, directions, t_min, t_max)
        return callbacks.count_hits(self.tracer, crossings, rays)

    def multi_hit(
        self,
        origins: Any,
        directions: Any,
        *,
        max_hits: int,
        t_min: Any = 0.0,
        t_max: Any = math.inf,
        crossings: str = "triangles",
        vertices: Any = None,
    ) -> JaxHits:
        """Find the nearest hits of each ray, by increasing distance.

        Parameters
        ----------
        origins, directions, t_min, t_max, vertices
            See `first_hit`.
        max_hits : int
            Number of hits to keep per ray; a constant.
        crossings : {"triangles", "surfaces"}
            See `Tracer.count_hits`.

        Returns
        -------
        JaxHits
            Of shape S + (max_hits,); a ray with fewer hits has misses after them.
        """
        counts_surfaces(crossings)
        limit = operator.index(max_hits)
        if limit < 0:
            raise ValueError(f"max_hits: expected a number >= 0, got {max_hits}")
        rays, given = _rays(origins, directions, t_min, t_max), _joined(vertices)
        return JaxHits(*callbacks.multi_hit(self.tracer, limit, crossings, rays, given))

    def positions(self, hits: JaxHits, vertices: Any = None) -> jax.Array:
        """Points on the triangles that were hit, with derivatives.

        Parameters
        ----------
        hits : JaxHits
            From `first_hit` or `multi_hit` of this tracer, with the same `vertices`.
        vertices : array of shape (V, 3), float, or one for each mesh, optional
            See `first_hit`.

        Returns
        -------
        Array of the hits' shape + (3,), float
            World space, interpolated from the vertices; a miss has NaN.
        """
        return callbacks.points(self.tracer, hits, _joined(vertices))

    def __repr__(self) -> str:
        return f"JaxTracer({self.tracer!r})"


jax.tree_util.register_static(JaxTracer)


def _rays(origins: Any, directions: Any, t_min: Any, t_max: Any) -> tuple[jax.Array, ...]:
    return checked_rays(_real, jnp.broadcast_shapes, origins, directions, t_min, t_max)


def _real(name: str, values: Any) -> jax.Array:
    """An array of real numbers that NumPy knows."""
    try:
        array = jnp.asarray(values)
    except (TypeError, ValueError) as error:
        raise TypeError(f"{name}: cannot be read as an array ({error})") from error
    is_real = jnp.issubdtype(array.dtype, jnp.floating) or jnp.issubdtype(array.dtype, jnp.integer)
    if not is_real:
        raise TypeError(f"{name}: expected real numbers, got dtype {array.dtype}")
    if array.dtype.itemsize < 4 and jnp.issubdtype(array.dtype, jnp.floating):
        return array.astype(jnp.float32)  # bfloat16 and smaller, which NumPy does not know
    return array


def _joined(vertices: Any) -> jax.Array | None:
    """All vertices in one array."""
    if vertices is None:
        return None
    is_many = isinstance(vertices, Sequence) and not hasattr(vertices, "ndim")
    given = jnp.concatenate(list(vertices)) if is_many else jnp.asarray(vertices)
    return checked_vertices(given, jnp.issubdtype(given.dtype, jnp.floating))

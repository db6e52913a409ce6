"""TorchTracer: the queries of a tracer as operators of PyTorch."""

from __future__ import annotations

import math
import operator
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from raystream.core.array_checks import checked_rays, checked_vertices
from raystream.core.crossing import inverse_rows, points_at
from raystream.core.query import counts_surfaces
from raystream.core.scene_kinds import check_support
from raystream.torch.operators import register
from raystream.tracer import Tracer

_REAL = frozenset(
    (torch.float64, torch.float32, torch.float16, torch.bfloat16, torch.int64)
    + (torch.int32, torch.int16, torch.int8, torch.uint64, torch.uint32, torch.uint16, torch.uint8)
)


class TorchHits(NamedTuple):
    """Hits in tensors of the rays' shape S, or S + (max_hits,).

    See `Hits` for what they are; ``t``, ``u`` and ``v`` have gradients if the rays or vertices
    require them.
    """

    t: Tensor
    u: Tensor
    v: Tensor
    prim_id: Tensor
    instance_id: Tensor


class TorchTracer:
    """A tracer whose queries are PyTorch operators, with gradients that hold the hit fixed.

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
    Every query takes `origins` and `directions` of any leading shape S: tensors of shape S + (3,)
    that broadcast, of any real dtype, on the tracer's device: on the CPU, or on its GPU. They are
    read without a copy, except bfloat16, which becomes float32. `t_min` and `t_max` are numbers or
    tensors that broadcast to S. Results have the same bits as the tracer's. Under
    ``torch.compile`` a query is one operator without a graph break; under ``torch.vmap`` all rays
    are traced in one batch. No memory is needed for pairs of rays and triangles.

    If `origins`, `directions` or `vertices` require gradients, ``t``, ``u`` and ``v`` have the
    gradients of the intersection of the ray with the triangle that it hit, held fixed, evaluated
    in float64. They are exact as long as the ray hits that triangle. **They say nothing about
    visibility**: where a ray passes from one triangle to another, over an edge or a silhouette,
    the result jumps, which the gradient does not reflect. Misses have no gradients: they
    contribute zeros, never NaN. Reverse mode can be applied any number of times; forward mode is
    not supported.

    Scenes may have instances, spheres and height fields, and be traced in float64. Vertices of
    instances are those of their objects, and have the gradients of all instances. Spheres and
    height fields have no vertices: gradients flow to rays. Those of a sphere are of the first
    order only: derivatives of these are of the plane that touches it.

    Examples
    --------
    >>> import torch
    >>> import raystream as rs
    >>> from raystream.torch import TorchTracer
    >>> tracer = TorchTracer(rs.Tracer(rs.load("cornell")))
    >>> origins = torch.tensor([278.0, 273.0, -800.0], requires_grad=True)
    >>> hits = tracer.first_hit(origins, torch.tensor([0.0, 0.0, 1.0]))
    >>> hits.t.backward()
    >>> round(hits.t.item(), 1), [round(one, 3) for one in origins.grad.tolist()]
    (1092.0, [-0.31, 0.0, -1.0])
    """

    def __init__(self, tracer: Tracer) -> None:
        if not isinstance(tracer, Tracer):
            raise TypeError(f"tracer: expected a Tracer, got {type(tracer).__name__}")
        check_support("raystream.torch", tracer.structure.triangles)
        self.tracer = tracer
        self._number = register(tracer)
        store = tracer.structure.triangles
        self._is_meshes = store.instances is None and not store.has_primitives

    def __reduce__(self) -> Any:
        return type(self), (self.tracer,)

    def first_hit(
        self,
        origins: Any,
        directions: Any,
        *,
        t_min: Any = 0.0,
        t_max: Any = math.inf,
        vertices: Tensor | Sequence[Tensor] | None = None,
    ) -> TorchHits:
        """Find the nearest triangle along each ray.

        Parameters
        ----------
        origins, directions : Tensor of shape S + (3,), real
            World space; they broadcast.
        t_min, t_max : float or Tensor that broadcasts to S
            Closed search interval, in direction lengths.
        vertices : Tensor of shape (V, 3), float, or one for each mesh, optional
            The scene's vertices, to which gradients flow: one mesh after another. Rays are traced
            against the tracer's own, which must be the same numbers, rounded to the coarser dtype
            of the two: call `Tracer.update` with them first. Comparing takes time for every vertex.

        Returns
        -------
        TorchHits
            Of shape S. A miss has ``t = inf`` and ``prim_id = -1``.

        Raises
        ------
        TypeError
            If a dtype is not real, or tensors are on another device than the tracer.
        ValueError
            If shapes disagree, or `vertices` differ from the tracer's.
        """
        rays, given = _rays(origins, directions, t_min, t_max), _joined(vertices)
        ask = torch.ops.raystream.first_hit
        hits = TorchHits(*ask(self._number, *_detached(*rays, given)))
        return self._with_gradients(hits, rays, given)

    def any_hit(
        self, origins: Any, directions: Any, *, t_min: Any = 0.0, t_max: Any = math.inf
    ) -> Tensor:
        """Find whether anything blocks each ray.

        Parameters
        ----------
        origins, directions, t_min, t_max
            See `first_hit`.

        Returns
        -------
        Tensor of shape S, bool
        """
        rays = _rays(origins, directions, t_min, t_max)
        return torch.ops.raystream.any_hit(self._number, *_detached(*rays))

    def count_hits(
        self,
        origins: Any,
        directions: Any,
        *,
        t_min: Any = 0.0,
        t_max: Any = math.inf,
        crossings: str = "triangles",
    ) -> Tensor:
        """Count the hits along each ray.

        Parameters
        ----------
        origins, directions, t_min, t_max
            See `first_hit`.
        crossings : {"triangles", "surfaces"}
            See `Tracer.count_hits`.

        Returns
        -------
        Tensor of shape S, int64
        """
        surfaces = counts_surfaces(crossings)
        rays = _detached(*_rays(origins, directions, t_min, t_max))
        return torch.ops.raystream.count_hits(self._number, *rays, surfaces)

    def multi_hit(
        self,
        origins: Any,
        directions: Any,
        *,
        max_hits: int,
        t_min: Any = 0.0,
        t_max: Any = math.inf,
        crossings: str = "triangles",
        vertices: Tensor | Sequence[Tensor] | None = None,
    ) -> TorchHits:
        """Find the nearest hits of each ray, by increasing distance.

        Parameters
        ----------
        origins, directions, t_min, t_max, vertices
            See `first_hit`.
        max_hits : int
            Number of hits to keep per ray.
        crossings : {"triangles", "surfaces"}
            See `Tracer.count_hits`.

        Returns
        -------
        TorchHits
            Of shape S + (max_hits,); a ray with fewer hits has misses after them.
        """
        surfaces, limit = counts_surfaces(crossings), operator.index(max_hits)
        if limit < 0:
            raise ValueError(f"max_hits: expected a number >= 0, got {max_hits}")
        rays, given = _rays(origins, directions, t_min, t_max), _joined(vertices)
        ask = torch.ops.raystream.multi_hit
        hits = TorchHits(*ask(self._number, *_detached(*rays), limit, surfaces, *_detached(given)))
        lone = rays._replace(origins=rays[0].unsqueeze(-2), directions=rays[1].unsqueeze(-2))
        return self._with_gradients(hits, lone, given)

    def positions(
        self, hits: TorchHits, vertices: Tensor | Sequence[Tensor] | None = None
    ) -> Tensor:
        """Points on the triangles that were hit, with gradients.

        Parameters
        ----------
        hits : TorchHits
            From `first_hit` or `multi_hit` of this tracer, with the same `vertices`.
        vertices : Tensor of shape (V, 3), float, or one for each mesh, optional
            See `first_hit`.

        Returns
        -------
        Tensor of the hits' shape + (3,), float64
            World space, interpolated from the vertices; a miss has NaN.
        """
        given = _joined(vertices)
        corners = self._corners(hits, given, *_detached(given))
        weights = hits.u.double(), hits.v.double()
        return torch.stack(points_at(torch, corners, *weights, hits.prim_id >= 0), dim=-1)

    def _with_gradients(self, hits: TorchHits, rays: _Rays, given: Tensor | None) -> TorchHits:
        """The same hits as functions of the rays and vertices, if those require gradients."""
        inputs = (*rays[:2], *(() if given is None else (given,)))
        if not (torch.is_grad_enabled() and any(one.requires_grad for one in inputs)):
            return hits
        corners = self._corners(hits, given)
        shape = (*hits.t.shape, 3)
        vectors = (one.double().expand(shape) for one in rays[:2])
        t, u, v = _Crossing.apply(*hits[:3], hits.prim_id >= 0, *vectors, corners)
        return hits._replace(t=t, u=u, v=v)

    def _corners(
        self, hits: TorchHits, given: Tensor | None, checked: Tensor | None = None
    ) -> Tensor:
        """Corners of triangles, or of what touches surfaces, shape S + (3, 3), float64."""
        ops, number, ids = torch.ops.raystream, self._number, hits[3:]
        if given is not None:
            moved = given[ops.vertex_ids(number, hits.prim_id, checked)].double()
            if self._is_meshes:
                return moved
        corners = ops.corners(number, *_detached(*hits[1:3]), *ids)
        if given is not None:
            slopes, change = ops.vertex_slopes(number, *ids), moved - moved.detach()
            corners = corners + change @ slopes.transpose(-1, -2)
        return corners

    def __repr__(self) -> str:
        return f"TorchTracer({self.tracer!r})"


class _Rays(NamedTuple):
    origins: Tensor
    directions: Tensor
    t_min: Tensor
    t_max: Tensor


def _rays(origins: Any, directions: Any, t_min: Any, t_max: Any) -> _Rays:
    return _Rays(*checked_rays(_real, torch.broadcast_shapes, origins, directions, t_min, t_max))


def _real(name: str, values: Any) -> Tensor:
    """A tensor of real numbers; numbers and sequences as float64, as the tracer has them."""
    kind = None if isinstance(values, Tensor | np.ndarray) else torch.float64
    try:
        tensor = torch.as_tensor(values, dtype=kind)
    except (TypeError, ValueError, RuntimeError) as error:
        raise TypeError(f"{name}: cannot be read as a tensor ({error})") from error
    if tensor.dtype not in _REAL:
        raise TypeError(f"{name}: expected real numbers, got dtype {tensor.dtype}")
    return tensor.float() if tensor.dtype == torch.bfloat16 else tensor


def _detached(*tensors: Tensor | None) -> tuple[Tensor | None, ...]:
    return tuple(None if one is None else one.detach() for one in tensors)


def _joined(vertices: Tensor | Sequence[Tensor] | None) -> Tensor | None:
    """All vertices in one tensor."""
    if vertices is None:
        return None
    given = vertices if isinstance(vertices, Tensor) else torch.cat(list(vertices))
    return checked_vertices(given, given.is_floating_point())


class _Crossing(torch.autograd.Function):
    """t, u and v of hits as functions of rays and corners; see `raystream.core.crossing`.

    Applied to t, u, v, is_hit, origins, directions and corners.
    """

    generate_vmap_rule = True

    @staticmethod
    def forward(t: Tensor, u: Tensor, v: Tensor, *_: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        return t.clone(), u.clone(), v.clone()

    @staticmethod
    def setup_context(ctx: Any, inputs: Any, output: Any) -> None:
        _, _, _, is_hit, _, directions, corners = inputs
        ctx.save_for_backward(is_hit, directions, corners, *output)

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor | None, ...]:
        # In differentiable operations, so that there are derivatives of any order.
        is_hit, directions, corners, t, u, v = ctx.saved_tensors
        rows = inverse_rows(torch, directions, corners, is_hit)
        by_t, by_u, by_v = (torch.where(is_hit, one, 0.0).double() for one in gradients)
        slopes = [by_t * rows[0][k] + by_u * rows[1][k] + by_v * rows[2][k] for k in range(3)]
        by_origin = torch.stack(slopes, dim=-1)
        by_direction = torch.where(is_hit, t, 0.0)[..., None] * by_origin
        by_corners = None
        if ctx.needs_input_grad[-1]:
            weights = torch.stack((1.0 - u.double() - v, u.double(), v.double()), dim=-1)
            by_corners = -weights[..., None] * by_origin[..., None, :]
        return None, None, None, None, by_origin, by_direction, by_corners

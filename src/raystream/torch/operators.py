"""The operators of PyTorch: what runs, the shapes of its results, and calls under vmap."""

from __future__ import annotations

import itertools
import weakref
from typing import Any

import numpy as np
import torch
from torch import Tensor

from raystream.core.array_checks import leading_shape
from raystream.core.crossing import HitRows, check_vertices, vertex_ids, vertex_slopes
from raystream.core.padded_hits import pad
from raystream.tracer import Tracer

#: Tracers by the number that stands for them in operators, whose arguments cannot be objects.
_TRACERS: weakref.WeakValueDictionary[int, Tracer] = weakref.WeakValueDictionary()
_numbers = itertools.count(1)


def register(tracer: Tracer) -> int:
    """The number of a tracer in the operators, as long as it exists."""
    number = next(_numbers)
    _TRACERS[number] = tracer
    return number


_RAYS = "Tensor origins, Tensor directions, Tensor t_min, Tensor t_max"
#: The tracer's vertices as the caller knows them, to be checked.
_CHECKED = "Tensor? vertices=None"


def _tracer(number: int) -> Tracer:
    try:
        return _TRACERS[number]
    except KeyError:
        raise RuntimeError(
            "tracer: the TorchTracer of this compiled function has been deleted; keep a reference"
        ) from None


def _checked(number: int, vertices: Tensor | None) -> Tracer:
    """A tracer, if it has these vertices."""
    tracer = _tracer(number)
    if vertices is not None:
        own = [torch.tensor(mesh.vertices) for mesh in tracer.scene.meshes]
        check_vertices(own, vertices.cpu(), Tensor.to)
    return tracer


def _columns(tracer: Tracer, hits: Any) -> tuple[Tensor, ...]:
    is_placed = tracer.scene.placements is not None
    instance_id = hits.instance_id if is_placed else hits.prim_id.clamp(max=0)
    return hits.t, hits.u, hits.v, hits.prim_id, instance_id


def _operator(name: str, schema: str, run: Any, fake: Any, vmap: Any) -> None:
    """Register an operator of this schema, for all devices."""
    made = torch.library.custom_op(f"raystream::{name}", run, mutates_args=(), schema=schema)
    made.register_fake(fake)
    made.register_vmap(vmap)


def _first_hit(
    tracer: int,
    origins: Tensor,
    directions: Tensor,
    t_min: Tensor,
    t_max: Tensor,
    vertices: Tensor | None = None,
) -> tuple[Tensor, ...]:
    asked = _checked(tracer, vertices)
    return _columns(asked, asked.first_hit(origins, directions, t_min=t_min, t_max=t_max))


def _any_hit(tracer: int, origins: Tensor, directions: Tensor, t_min: Tensor, t_max: Tensor) -> Any:
    return _tracer(tracer).any_hit(origins, directions, t_min=t_min, t_max=t_max)


def _count_hits(
    tracer: int,
    origins: Tensor,
    directions: Tensor,
    t_min: Tensor,
    t_max: Tensor,
    surfaces: bool,
) -> Any:
    crossings: Any = "surfaces" if surfaces else "triangles"
    return _tracer(tracer).count_hits(
        origins, directions, t_min=t_min, t_max=t_max, crossings=crossings
    )


def _multi_hit(
    tracer: int,
    origins: Tensor,
    directions: Tensor,
    t_min: Tensor,
    t_max: Tensor,
    max_hits: int,
    surfaces: bool,
    vertices: Tensor | None = None,
) -> tuple[Tensor, ...]:
    crossings: Any = "surfaces" if surfaces else "triangles"
    found: Any = _checked(tracer, vertices).multi_hit(
        origins, directions, t_min=t_min, t_max=t_max, max_hits=max_hits, crossings=crossings
    )
    padded = pad(found.host(), max_hits)
    return tuple(torch.from_numpy(one).to(origins.device) for one in padded)


def _corners(tracer: int, u: Tensor, v: Tensor, prim_id: Tensor, instance_id: Tensor) -> Tensor:
    rows: Any = HitRows(*(one.cpu().numpy() for one in (u, v, prim_id, instance_id)))
    corners = _tracer(tracer).structure.triangles.touching_corners(rows)
    return torch.from_numpy(corners).to(prim_id.device)


def _vertex_ids(tracer: int, prim_id: Tensor, vertices: Tensor | None = None) -> Tensor:
    ids = vertex_ids(_checked(tracer, vertices).scene, prim_id.cpu().numpy())
    return torch.from_numpy(ids.astype(np.int64)).to(prim_id.device)


def _vertex_slopes(tracer: int, prim_id: Tensor, instance_id: Tensor) -> Tensor:
    ids = prim_id.cpu().numpy(), instance_id.cpu().numpy()
    return torch.from_numpy(vertex_slopes(_tracer(tracer).scene, *ids)).to(prim_id.device)


def _fake(origins: Tensor, directions: Tensor, dtype: torch.dtype, *more: int) -> Tensor:
    shape = leading_shape(torch.broadcast_shapes, origins, directions)
    return origins.new_empty((*shape, *more), dtype=dtype)


def _fake_hits(tracer: int, o: Tensor, d: Tensor, *more: int) -> tuple[Tensor, ...]:
    is_wide = _tracer(tracer).structure.triangles.number_type is np.float64
    kinds = [torch.float64 if is_wide else torch.float32] * 3 + [torch.int32] * 2
    return tuple(_fake(o, d, kind, *more) for kind in kinds)


def _first(argument: Any, axis: int | None) -> Any:
    """An argument with its batch, if it has one, first."""
    return argument if axis is None else argument.movedim(axis, 0)


def _leading(tensor: Tensor, axis: int | None, rank: int) -> Tensor:
    """A batched tensor with its batch first, and as many axes after it as `rank` says."""
    if axis is None:
        return tensor
    tensor = tensor.movedim(axis, 0)
    ones = [1] * (rank + 1 - tensor.ndim)
    return tensor.reshape(tensor.shape[0], *ones, *tensor.shape[1:])


def _one_batch(ask: Any, count: int) -> Any:
    """The rule of ``vmap``: the batch becomes the first axis of the rays' leading shape."""

    def rule(info: Any, axes: Any, tracer: int, *arguments: Any) -> Any:
        rays = arguments[:4]
        more = [_first(*one) for one in zip(arguments[4:], axes[5:], strict=True)]
        axes = axes[1:5]
        ranks = [
            one.ndim - (axis is not None) - (k < 2)
            for k, (one, axis) in enumerate(zip(rays, axes, strict=True))
        ]
        rank = max(ranks)
        widths = rank + 1, rank + 1, rank, rank
        batch = [_leading(*one) for one in zip(rays, axes, widths, strict=True)]
        if axes[0] is None and axes[1] is None:  # a limit gives the rays their shape
            lengths = [1] * (rank + 1 - batch[0].ndim)
            batch[0] = batch[0].expand(info.batch_size, *lengths, *batch[0].shape)
        return ask(tracer, *batch, *more), (0 if count == 1 else (0,) * count)

    return rule


def _rows_of_batch(ask: Any) -> Any:
    def rule(_: Any, axes: Any, tracer: int, *rows: Any) -> Any:
        batch = (_first(*one) for one in zip(rows, axes[1:], strict=True))
        return ask(tracer, *batch), None if axes[1] is None else 0

    return rule


def _define() -> None:
    ops = torch.ops.raystream
    hits = "(Tensor, Tensor, Tensor, Tensor, Tensor)"
    _operator(
        "first_hit",
        f"(int tracer, {_RAYS}, {_CHECKED}) -> {hits}",
        _first_hit,
        lambda tracer, o, d, t_min, t_max, vertices=None: _fake_hits(tracer, o, d),
        _one_batch(lambda *rays: ops.first_hit(*rays), 5),
    )
    _operator(
        "any_hit",
        f"(int tracer, {_RAYS}) -> Tensor",
        _any_hit,
        lambda tracer, o, d, t_min, t_max: _fake(o, d, torch.bool),
        _one_batch(lambda *rays: ops.any_hit(*rays), 1),
    )
    _operator(
        "count_hits",
        f"(int tracer, {_RAYS}, bool surfaces) -> Tensor",
        _count_hits,
        lambda tracer, o, d, t_min, t_max, surfaces: _fake(o, d, torch.int64),
        _one_batch(lambda *rays: ops.count_hits(*rays), 1),
    )
    _operator(
        "multi_hit",
        f"(int tracer, {_RAYS}, int max_hits, bool surfaces, {_CHECKED}) -> {hits}",
        _multi_hit,
        lambda tracer, o, d, t_min, t_max, most, surfaces, vertices=None: _fake_hits(
            tracer, o, d, most
        ),
        _one_batch(lambda *rays: ops.multi_hit(*rays), 5),
    )
    _operator(
        "corners",
        "(int tracer, Tensor u, Tensor v, Tensor prim_id, Tensor instance_id) -> Tensor",
        _corners,
        lambda tracer, u, *ids: u.new_empty((*u.shape, 3, 3), dtype=torch.float64),
        _rows_of_batch(lambda *rows: ops.corners(*rows)),
    )
    _operator(
        "vertex_slopes",
        "(int tracer, Tensor prim_id, Tensor instance_id) -> Tensor",
        _vertex_slopes,
        lambda tracer, prim_id, _: prim_id.new_empty((*prim_id.shape, 3, 3), dtype=torch.float64),
        _rows_of_batch(lambda *rows: ops.vertex_slopes(*rows)),
    )
    _operator(
        "vertex_ids",
        f"(int tracer, Tensor prim_id, {_CHECKED}) -> Tensor",
        _vertex_ids,
        lambda tracer, prim_id, vertices=None: prim_id.new_empty(
            (*prim_id.shape, 3), dtype=torch.int64
        ),
        _rows_of_batch(lambda *rows: ops.vertex_ids(*rows)),
    )


_define()

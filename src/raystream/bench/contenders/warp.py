"""NVIDIA Warp on the CPU or on a GPU, as a contender."""

# No postponed annotations: Warp evaluates those of its kernels.

from collections.abc import Mapping
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from raystream.bench.contenders.base import (
    Closest,
    Contender,
    FirstHits,
    Geometry,
    Points,
    Rays,
    UnavailableError,
)

wp.config.log_level = wp.LOG_ERROR

#: Its queries of points take the greatest distance.
_FARTHEST = 1e30


@wp.kernel(enable_backward=False)
def _first(
    mesh: wp.uint64,
    origins: wp.array(dtype=wp.vec3),  # type: ignore[valid-type]
    directions: wp.array(dtype=wp.vec3),  # type: ignore[valid-type]
    t_max: float,
    t: wp.array(dtype=float),  # type: ignore[valid-type]
    prim_id: wp.array(dtype=int),  # type: ignore[valid-type]
) -> None:
    i = wp.tid()
    found = wp.mesh_query_ray(mesh, origins[i], directions[i], t_max)
    t[i] = wp.where(found.result, found.t, wp.inf)
    prim_id[i] = wp.where(found.result, found.face, -1)


@wp.kernel(enable_backward=False)
def _any(
    mesh: wp.uint64,
    origins: wp.array(dtype=wp.vec3),  # type: ignore[valid-type]
    directions: wp.array(dtype=wp.vec3),  # type: ignore[valid-type]
    t_max: float,
    seen: wp.array(dtype=wp.bool),  # type: ignore[valid-type]
) -> None:
    i = wp.tid()
    seen[i] = wp.mesh_query_ray_anyhit(mesh, origins[i], directions[i], t_max)


@wp.kernel(enable_backward=False)
def _closest(
    mesh: wp.uint64,
    points: wp.array(dtype=wp.vec3),  # type: ignore[valid-type]
    limit: float,
    distance: wp.array(dtype=float),  # type: ignore[valid-type]
    positions: wp.array(dtype=wp.vec3),  # type: ignore[valid-type]
    prim_id: wp.array(dtype=int),  # type: ignore[valid-type]
) -> None:
    i = wp.tid()
    found = wp.mesh_query_point_no_sign(mesh, points[i], limit)
    positions[i] = wp.mesh_eval_position(mesh, found.face, found.u, found.v)
    prim_id[i] = found.face
    distance[i] = wp.length(positions[i] - points[i])


class Warp(Contender):
    """``mesh_query_ray``, ``_ray_anyhit`` and ``_point_no_sign`` in a kernel.

    Results for rays in arrays on the GPU are Warp's arrays there.

    Parameters
    ----------
    threads : int
        No effect.
    options : mapping
        ``device``: ``"cpu"`` (default) or ``"cuda"``; ``constructor``: Warp's BVH constructor,
        such as ``"sah"`` (default: Warp's own).

    Attributes
    ----------
    kernel_seconds : float or None
        Kernel time of the latest query on a GPU, without copies.
    """

    queries = frozenset(("first", "any", "closest"))
    notes = "on the CPU its kernels run on one thread; no query for all hits"

    def __init__(self, threads: int, options: Mapping[str, Any]) -> None:  # noqa: ARG002
        self.version = str(wp.config.version)
        self._device = str(options.get("device", "cpu"))
        self._constructor = options.get("constructor")
        self.kernel_seconds: float | None = None
        if self._device != "cpu" and not wp.is_cuda_available():
            raise UnavailableError("Warp finds no GPU")

    def build(self, geometry: Geometry) -> None:
        """Make a mesh, with Warp's default constructor unless specified."""
        self._built = wp.Mesh(
            points=self._array(geometry.vertices, wp.vec3),
            indices=self._array(geometry.faces.ravel(), wp.int32),
            bvh_constructor=self._constructor,
        )
        wp.synchronize()

    def first_hit(self, rays: Rays, mode: str) -> FirstHits:  # noqa: ARG002
        """Find the nearest hit of each ray."""
        t = wp.empty(len(rays), dtype=wp.float32, device=self._device)
        prim_id = wp.empty(len(rays), dtype=wp.int32, device=self._device)
        self._launch(_first, rays, [t, prim_id])
        return FirstHits(t, prim_id) if _is_on_gpu(rays) else FirstHits(t.numpy(), prim_id.numpy())

    def any_hit(self, rays: Rays, mode: str) -> NDArray[np.bool_]:  # noqa: ARG002
        """Test whether each ray hits anything."""
        seen = wp.empty(len(rays), dtype=wp.bool, device=self._device)
        self._launch(_any, rays, [seen])
        return seen if _is_on_gpu(rays) else seen.numpy()

    def closest_point(self, points: Points, mode: str) -> Closest:  # noqa: ARG002
        """Find the nearest point of the triangles to each point."""
        count = len(points)
        distance = wp.empty(count, dtype=wp.float32, device=self._device)
        positions = wp.empty(count, dtype=wp.vec3, device=self._device)
        prim_id = wp.empty(count, dtype=wp.int32, device=self._device)
        inputs = [self._array(points.points, wp.vec3), _FARTHEST]
        self._run(_closest, count, inputs, [distance, positions, prim_id])
        prim_id.numpy()
        return Closest(distance.numpy(), positions.numpy())

    def _launch(self, kernel: Any, rays: Rays, outputs: list[Any]) -> None:
        origins, directions = (self._array(one, wp.vec3) for one in rays.rows())
        inputs = [origins, directions, min(rays.t_max, float(np.finfo(np.float32).max))]
        self._run(kernel, len(rays), inputs, outputs)

    def _run(self, kernel: Any, count: int, inputs: list[Any], outputs: list[Any]) -> None:
        inputs = [self._built.id, *inputs]
        begin = end = None
        if self._device != "cpu":
            stream = wp.get_stream(self._device)
            begin = stream.record_event(wp.Event(self._device, enable_timing=True))
        wp.launch(kernel, dim=count, inputs=inputs, outputs=outputs, device=self._device)
        if begin is not None:
            end = stream.record_event(wp.Event(self._device, enable_timing=True))
            self.kernel_seconds = wp.get_event_elapsed_time(begin, end) / 1e3

    def _array(self, array: NDArray[Any], dtype: Any) -> Any:
        """Share an array's memory with Warp, or copy it to the GPU."""
        is_there = self._device == "cpu" or hasattr(array, "__cuda_array_interface__")
        return wp.array(array, dtype=dtype, device=self._device, copy=not is_there)


def _is_on_gpu(rays: Rays) -> bool:
    """Whether rays are in arrays on a GPU, where results then stay."""
    return hasattr(rays.origins, "__cuda_array_interface__")

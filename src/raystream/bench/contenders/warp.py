"""NVIDIA Warp on the CPU, as a contender."""

# No postponed annotations: Warp reads those of its kernels.

from collections.abc import Mapping
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from raystream.bench.contenders.base import Contender, FirstHits, Geometry, Rays

__all__ = ["Warp"]

wp.config.log_level = wp.LOG_ERROR


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


class Warp(Contender):
    """``mesh_query_ray`` and ``mesh_query_ray_anyhit`` in a kernel."""

    queries = frozenset(("first", "any"))
    notes = "on the CPU its kernels run on one thread; no query for all hits"

    def __init__(self, threads: int, options: Mapping[str, Any]) -> None:  # noqa: ARG002
        self._mesh: Any = None

    @property
    def version(self) -> str:
        """The package's version."""
        return str(wp.config.version)

    def build(self, geometry: Geometry) -> None:
        """Make a mesh, with the default way to build."""
        self._mesh = wp.Mesh(
            points=_array(geometry.vertices, wp.vec3),
            indices=_array(geometry.faces.ravel(), wp.int32),
        )

    def release(self) -> None:
        """Forget what was built."""
        self._mesh = None

    def first_hit(self, rays: Rays, mode: str) -> FirstHits:  # noqa: ARG002
        """Find the nearest hit of each ray."""
        t = np.empty(len(rays), np.float32)
        prim_id = np.empty(len(rays), np.int32)
        self._launch(_first, rays, [_array(t, wp.float32), _array(prim_id, wp.int32)])
        return FirstHits(t, prim_id)

    def any_hit(self, rays: Rays, mode: str) -> NDArray[np.bool_]:  # noqa: ARG002
        """Find whether anything is in each ray's way."""
        seen = np.empty(len(rays), np.bool_)
        self._launch(_any, rays, [_array(seen, wp.bool)])
        return seen

    def _launch(self, kernel: Any, rays: Rays, outputs: list[Any]) -> None:
        origins, directions = rays.rows()
        wp.launch(
            kernel,
            dim=len(rays),
            inputs=[
                self._mesh.id,
                _array(origins, wp.vec3),
                _array(directions, wp.vec3),
                min(rays.t_max, float(np.finfo(np.float32).max)),
            ],
            outputs=outputs,
            device="cpu",
        )


def _array(array: NDArray[Any], dtype: Any) -> Any:
    """Share an array's memory with Warp."""
    return wp.array(array, dtype=dtype, device="cpu", copy=False)

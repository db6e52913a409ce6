"""DeviceHits and DeviceMultiHits: results of the queries for rays in device memory."""

from __future__ import annotations

from typing import Any

from raystream.core.hits import Hits, MultiHits
from raystream.jit.cuda import DeviceArray


class _HitColumns:
    """The columns of hits on a device, and their scene."""

    def __init__(
        self,
        t: DeviceArray,
        u: DeviceArray,
        v: DeviceArray,
        prim_id: DeviceArray,
        status: DeviceArray,
        triangles: Any,
        instance_id: DeviceArray | None,
    ) -> None:
        self.t, self.u, self.v, self.prim_id, self.status = t, u, v, prim_id, status
        self.instance_id, self._triangles = instance_id, triangles

    def _copies(self) -> tuple[Any, ...]:
        """Copies of t, u, v, prim_id, status and, after the scene, of instance_id."""
        columns = self.t, self.u, self.v, self.prim_id, self.status
        instance_id = None if self.instance_id is None else self.instance_id.host()
        return *(one.host() for one in columns), self._triangles, instance_id


class DeviceHits(_HitColumns):
    """The nearest hit of each ray, in the rays' leading shape S, on the rays' device.

    Libraries that view the arrays keep them alive. The device may fill them after the query
    returns: libraries synchronise through the stream of DLPack or ``__cuda_array_interface__``,
    and code that reads addresses has to wait for the latter.

    Attributes
    ----------
    t, u, v : DeviceArray of shape S, of the tracer's precision
        Distance in direction lengths (a miss has inf), and the weights of vertices 1 and 2
        (a miss has 0).
    prim_id : DeviceArray of shape S, int32
        Triangle, counted over the whole scene; a miss has -1.
    instance_id : DeviceArray of shape S, int32, or None
        In a scene with instances, the one that is hit; a miss has -1.
    status : DeviceArray of shape S, uint8
        A `RayStatus` for each ray.
    """

    def host(self) -> Hits:
        """Copy the hits to NumPy arrays; this waits for the device.

        Raises
        ------
        CudaError
            If the query failed there.
        """
        t, u, v, prim_id, status, triangles, instance_id = self._copies()
        return Hits(t, u, v, prim_id, status, triangles, None, instance_id)

    def __repr__(self) -> str:
        return f"DeviceHits(shape={self.t.shape})"


class DeviceMultiHits(_HitColumns):
    """The hits of each ray by increasing distance, on the rays' device.

    For the lifetime of the arrays see `DeviceHits`.

    Attributes
    ----------
    ray_splits : DeviceArray of shape (N + 1,), int64
        Ray i owns the rows ray_splits[i] to ray_splits[i + 1] of the other arrays.
    t, u, v : DeviceArray of shape (K,), of the tracer's precision
    prim_id : DeviceArray of shape (K,), int32
    instance_id : DeviceArray of shape (K,), int32, or None
    status : DeviceArray of shape S, uint8
        See `MultiHits`.
    """

    def __init__(self, ray_splits: DeviceArray, *columns: Any) -> None:
        super().__init__(*columns)
        self.ray_splits = ray_splits

    def host(self) -> MultiHits:
        """Copy the hits to NumPy arrays; this waits for the device.

        Raises
        ------
        CudaError
            If the query failed there.
        """
        t, u, v, prim_id, status, triangles, instance_id = self._copies()
        splits = self.ray_splits.host()
        return MultiHits(splits, t, u, v, prim_id, status, triangles, instance_id)

    def __repr__(self) -> str:
        return f"DeviceMultiHits({len(self.t):,} hits of {len(self.ray_splits) - 1:,} rays)"

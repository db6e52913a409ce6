"""Ids of hits on a device: the numbers that kernels give hits, turned into those of results."""

from __future__ import annotations

import threading
from typing import Any, NamedTuple

import numpy as np

from raystream.core.instanced_triangles import InstancedTriangles
from raystream.jit.constants import SHIFT_32, SHIFT_64
from raystream.jit.cuda import DeviceArray, Gpu, StreamScope, gpu_kernel
from raystream.jit.simd import load, store
from raystream.kernels.intervals import interval_of

_MISS = np.int32(-1)


class InstanceIds(NamedTuple):
    """A table of instances.

    Attributes
    ----------
    first_ids : DeviceArray of int64
        `InstancedTriangles.first_ids`.
    shifts : DeviceArray of int64
        For each instance, what prim_ids are beyond the numbers.
    instance_count, halvings : uint64
        Instances, and the steps of the binary search for one.
    """

    first_ids: DeviceArray
    shifts: DeviceArray
    instance_count: np.uint64
    halvings: np.uint64


@gpu_kernel(instances=InstanceIds)
def split_ids(i, instances, numbers, instance_ids):
    """Replace a number by its prim_id, and write its instance; see `HitIds.split`."""
    at = i << SHIFT_32
    number = load(np.int32, numbers + at)
    if number < np.int32(0):
        store(instance_ids + at, _MISS)
        return
    long_number = np.int64(number)
    found = interval_of(
        instances.first_ids, instances.instance_count, instances.halvings, long_number
    )
    shift = load(np.int64, instances.shifts + (found << SHIFT_64))
    store(numbers + at, np.int32(long_number + shift))
    store(instance_ids + at, np.int32(found))


@gpu_kernel(first=np.int32)
def halve_ids(i, first, numbers):
    """Replace a number by its prim_id, from `first` on two numbers each; see `HitIds.split`."""
    at = numbers + (i << SHIFT_32)
    number = load(np.int32, at)
    if number >= first:
        store(at, np.int32(first + np.int32(np.int32(number - first) >> np.int32(1))))


class HitIds:
    """Turns the numbers of a scene's hits into ids, on a device.

    Parameters
    ----------
    gpu : Gpu
    triangles : Store
        With instances, a table is copied to the device when it is first needed.
    """

    def __init__(self, gpu: Gpu, triangles: Any) -> None:
        self._gpu, self._triangles = gpu, triangles
        self._lock = threading.Lock()
        self._table: InstanceIds | None = None

    def split(
        self, scope: StreamScope, numbers: DeviceArray
    ) -> tuple[DeviceArray, DeviceArray | None]:
        """Turn the numbers of hits into prim_ids in place, and make instance_ids, if there are any.

        Raises
        ------
        CudaError
            If there is no memory for them.
        """
        held = self._triangles
        if "spheres" in held.kinds:
            first = np.int32(held.first_fields[-1])
            scope.launch(halve_ids, numbers.size, (first, numbers))
        if held.instances is None:
            return numbers, None
        instance_ids = scope.empty("instance_ids", numbers.shape, np.int32)
        scope.launch(split_ids, numbers.size, (self._instances(held), numbers, instance_ids))
        return numbers, instance_ids

    def _instances(self, held: InstancedTriangles) -> InstanceIds:
        with self._lock:
            if self._table is None:
                starts = held.first_ids[:-1]
                beyond = held.first_prims[held.instances.object_ids] - starts
                count = len(starts)
                self._table = InstanceIds(
                    self._gpu.upload("first ids", starts),
                    self._gpu.upload("shifts", beyond.astype(np.int64)),
                    np.uint64(count),
                    np.uint64(max(count - 1, 0).bit_length()),
                )
                self._gpu.wait()  # other streams do not
            return self._table

"""Ids of hits on a device: the numbers that kernels give hits, turned into those of results."""

from __future__ import annotations

import threading
from typing import Any, NamedTuple

import numpy as np

from raystream.core.instanced_triangles import InstancedTriangles
from raystream.jit.constants import SHIFT_32, SHIFT_64
from raystream.jit.cpu import kernel
from raystream.jit.cuda import DeviceArray, Gpu, RangeKernel, StreamScope
from raystream.jit.simd import load, store
from raystream.programs.hits import interval_of

_MISS = np.int32(-1)


class InstanceIds(NamedTuple):
    """Addresses of a table of instances.

    Attributes
    ----------
    first_ids : uint64
        Of `InstancedTriangles.first_ids`, int64.
    shifts : uint64
        Of an int64 per instance: what prim_ids are beyond the numbers.
    instance_count, halvings : uint64
        Instances, and the steps of the binary search for one.
    """

    first_ids: np.uint64
    shifts: np.uint64
    instance_count: np.uint64
    halvings: np.uint64


@kernel
def _split(i, instances, numbers, instance_ids):
    """Replace a number by its prim_id, and write its instance; see `split_ids`."""
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


@kernel
def _halve(i, first, numbers):
    """Replace a number by its prim_id, from `first` on two numbers each; see `split_ids`."""
    at = numbers + (i << SHIFT_32)
    number = load(np.int32, at)
    if number >= first:
        store(at, np.int32(first + np.int32(np.int32(number - first) >> np.int32(1))))


#: Kernels for hits in instances, and of spheres.
SPLIT, HALVE = RangeKernel(_split), RangeKernel(_halve)


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
        self._table: tuple[DeviceArray, DeviceArray] | None = None

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
        if "primitives" in held.kinds and len(held.spheres):
            first = np.int32(held.first_fields[-1])
            scope.launch(HALVE, numbers.size, (first, numbers.address))
        if held.instances is None:
            return numbers, None
        instance_ids = scope.empty("instance_ids", numbers.shape, np.int32)
        arguments = self._instances(held), numbers.address, instance_ids.address
        scope.launch(SPLIT, numbers.size, arguments)
        return numbers, instance_ids

    def _instances(self, held: InstancedTriangles) -> InstanceIds:
        with self._lock:
            if self._table is None:
                starts = held.first_ids[:-1]
                beyond = held.first_prims[held.instances.object_ids] - starts
                given = {"first ids": starts, "shifts": beyond.astype(np.int64)}
                first_ids, shifts = (self._gpu.upload(*one) for one in given.items())
                self._table = first_ids, shifts
                self._gpu.wait()  # other streams do not
        count = len(held.instances)
        first_ids, shifts = self._table
        sizes = np.uint64(count), np.uint64(max(count - 1, 0).bit_length())
        return InstanceIds(first_ids.address, shifts.address, *sizes)

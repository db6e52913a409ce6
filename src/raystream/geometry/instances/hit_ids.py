"""The ids of many hits, from the numbers that kernels give triangles of instances."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from raystream.core.instanced_triangles import InstancedTriangles
from raystream.jit.constants import ONE_U64
from raystream.jit.cpu import kernel
from raystream.jit.threads import parallel_for

#: Fewer are split by NumPy, before a kernel is loaded.
_LEAST = 1 << 14

#: Bytes that NumPy needs for a number, besides an id of the instance; and the kernel.
_BYTES_OF_FEW, _BYTES_OF_MANY = 48, 4

#: Numbers of a call of the kernel.
_CHUNK = 1 << 15


def split_numbers(
    triangles: InstancedTriangles, numbers: NDArray[np.int32]
) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """The same as `InstancedTriangles.split_ids`, on all threads."""
    if numbers.size < _LEAST or len(triangles.instances) == 0:
        return triangles.split_ids(numbers)
    prim_id, instance_id = np.empty_like(numbers), np.empty_like(numbers)
    tables = triangles.first_ids, triangles.instances.object_ids, triangles.parts
    rows = numbers.reshape(-1), prim_id.reshape(-1), instance_id.reshape(-1)

    def split(begin: int, end: int) -> None:
        _split(begin, end, *tables, *rows)

    parallel_for(split, numbers.size, _CHUNK, joins_chunks=True)
    return prim_id, instance_id


def split_bytes(count: int) -> int:
    """Most bytes that `split_numbers` needs, besides the ids of the instances."""
    return max(_BYTES_OF_FEW * min(count, _LEAST), _BYTES_OF_MANY * count)


@kernel
def _split(begin, end, first_ids, object_ids, parts, numbers, prim_id, instance_id):
    """Split the numbers begin to end; those of neighbours are often of one instance."""
    low, high, shift, found = np.int64(0), np.int64(0), np.int64(0), np.uint64(0)
    fields, spheres, own = np.int64(0), np.int64(0), np.uint64(0)
    for i in range(np.uint64(begin), np.uint64(end)):
        number = np.int64(numbers[i])
        if number < 0:
            prim_id[i], instance_id[i] = -1, -1
            continue
        if number < low or number >= high:
            # The last instance that begins at the number or before.
            found, size = np.uint64(0), np.uint64(len(object_ids))
            while size > ONE_U64:
                half = size >> ONE_U64
                found += half * np.uint64(first_ids[found + half] <= number)
                size -= half
            low, high = first_ids[found], first_ids[found + ONE_U64]
            own = np.uint64(object_ids[found])
            shift = parts[own, 0, 1] - low
            fields, spheres = low + parts[own, 1, 0], low + parts[own, 2, 0]
        instance_id[i] = found
        if number < fields:
            prim_id[i] = number + shift
        elif number < spheres:
            prim_id[i] = number - fields + parts[own, 1, 1]
        else:
            prim_id[i] = ((number - spheres) >> 1) + parts[own, 2, 1]

"""Aligned records: a GPU reads a number only at a multiple of its size."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray


def aligned_dtype(dtype: np.dtype[Any]) -> np.dtype[Any]:
    """Add padding to a dtype so that its fields are aligned.

    A dtype whose fields overlap is returned unchanged: its programs run on the CPU.
    """
    if dtype.subdtype is not None:
        base, shape = dtype.subdtype
        return np.dtype((aligned_dtype(base), shape))
    if dtype.fields is None or dtype.names is None or _overlaps(dtype):
        return dtype
    fields = [(name, aligned_dtype(dtype.fields[name][0])) for name in dtype.names]
    return np.dtype(fields, align=True)


def aligned_records(records: NDArray[Any]) -> NDArray[Any]:
    """Records in C order with aligned fields; a copy if necessary."""
    return np.ascontiguousarray(records, aligned_dtype(records.dtype))


def is_aligned(dtype: np.dtype[Any]) -> bool:
    """Whether each number of an array of records is at a multiple of its size."""
    if dtype.subdtype is not None:
        return is_aligned(dtype.subdtype[0])
    if dtype.fields is None:
        return True
    return dtype.isalignedstruct and all(is_aligned(one[0]) for one in dtype.fields.values())


def _overlaps(dtype: np.dtype[Any]) -> bool:
    assert dtype.fields is not None
    end = 0
    for field, offset, *_ in sorted(dtype.fields.values(), key=lambda one: one[1]):
        if offset < end:
            return True
        end = offset + field.itemsize
    return False

"""Conditions of kernels on the graphics device: comparisons of streams there."""

from __future__ import annotations

from typing import Any

import numpy as np

from raystream.graphics.adapters import OpenDevice
from raystream.graphics.streams.stream import Stream, check_device
from raystream.graphics.streams.wgsl_types import constant_words, type_of
from raystream.streams.condition import Condition


def as_device_condition(name: str, where: Any, count: int, opened: OpenDevice) -> Condition | None:
    """The argument `where` of a kernel as a condition on the device.

    Parameters
    ----------
    name : str
        Of the kernel.
    where : Condition, array_like or None
        Of an array of bool, a stream is made.
    count : int
        Records that it must have.
    opened : OpenDevice

    Raises
    ------
    GraphicsError
        If its stream is on another device.
    TypeError
        If it is not a condition on the device, or compares integers with another kind of number.
    ValueError
        If its length differs, or its number is out of range.
    """
    if where is None:
        return None
    if not isinstance(where, Condition):
        mask = np.asarray(where)
        if mask.dtype != np.bool_ or isinstance(where, Stream):
            raise TypeError(
                f"{name}, where: expected a comparison such as (state == 2), or booleans, got "
                f"dtype {mask.dtype}"
            )
        where = Stream(mask, np.uint32, name="where", adapter=opened) != 0
    stream = where.stream
    if not isinstance(stream, Stream):
        raise TypeError(f"{name}, where: compares {stream.label}, which is on the CPU")
    check_device(f"{name}, where", stream, opened)
    if len(stream) != count:
        raise ValueError(
            f"{name}, where: {stream.label} has {len(stream):,} records, but the kernel's streams "
            f"have {count:,}"
        )
    constant_words(f"{name}, where", type_of(stream.dtype, 1), where.value)
    return where

"""Payloads in a GPU's memory: made there, viewed there, or copied there and back."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raystream.core.arrays import is_on_gpu
from raystream.cuda.programs.device_program import Record
from raystream.cuda.programs.records import aligned_dtype, aligned_records
from raystream.cuda.programs.skips import is_packed
from raystream.jit.cuda import DeviceArray, StreamScope, view_of
from raystream.programs.payloads import as_payload, as_records

__all__ = ["PlacedPayload", "place_payload", "record_of"]


def record_of(records: NDArray[Any] | None) -> Record | None:
    """How kernels read records of `as_records`."""
    if records is None:
        return None
    return aligned_dtype(records.dtype), 1 if records.ndim == 1 else records.shape[1]


@dataclass
class PlacedPayload:
    """A payload on a device.

    Attributes
    ----------
    result : object
        What the tracer returns.
    record : (dtype, int) or None
    address : uint64
    host : ndarray or None
        Records of the host's, for which `placed` is a copy.
    placed : DeviceArray or None
    """

    result: Any
    record: Record | None
    address: np.uint64
    host: NDArray[Any] | None = None
    placed: DeviceArray | None = None

    @property
    def record_bytes(self) -> int:
        """Bytes from one ray's record to the next."""
        if self.record is None:
            return 0
        dtype, width = self.record
        return dtype.itemsize * width

    @property
    def copied(self) -> tuple[DeviceArray, ...]:
        """The copy of the host's records, if they are on the host."""
        return () if self.placed is None else (self.placed,)

    def finish(self, copies: Sequence[NDArray[Any]]) -> None:
        """Write a copy of `copied` to the records on the host."""
        for records in copies:
            assert self.host is not None
            self.host[...] = records
            if not np.shares_memory(self.result, self.host):
                self.result[...] = self.host.reshape(self.result.shape)


def place_payload(work: StreamScope, payload: Any, shape: tuple[int, ...]) -> PlacedPayload:
    """Make a payload on a device, view it there, or copy it there.

    Parameters
    ----------
    work : StreamScope
    payload : array, dtype or None
        On the device: numbers in C order, of shape S or S + (k,). Else as for `as_payload`;
        fields of records made there are aligned.
    shape : tuple of int
        The rays' shape S.

    Raises
    ------
    ValueError, TypeError
        If it is of another shape or type, or not in C order.
    """
    if payload is None:
        return PlacedPayload(None, None, np.uint64(0))
    if isinstance(payload, DeviceArray) or is_on_gpu(payload):
        return _viewed(work, payload, shape)
    if isinstance(payload, np.ndarray):
        result = as_payload(payload, shape)
        records = as_records(result, shape)
        own = aligned_records(records)
        work.keep(own)
        placed = work.placed("payload", own)
        return PlacedPayload(result, record_of(records), placed.address, records, placed)
    empty = as_payload(payload, (0,))
    dtype = aligned_dtype(empty.dtype)
    record = record_of(as_records(empty, (0,)))
    made = work.cleared("payload", (*shape, *empty.shape[1:]), dtype)
    return PlacedPayload(made, record, made.address)


def _viewed(work: StreamScope, payload: Any, shape: tuple[int, ...]) -> PlacedPayload:
    view = view_of(work, "payload", payload)
    if isinstance(payload, DeviceArray):  # whose fields its interface does not name
        view = view._replace(dtype=payload.dtype)
    if view.shape != shape and (view.shape[:-1] != shape or view.dtype.fields is not None):
        raise ValueError(
            f"payload: expected the rays' shape {shape}, or {shape} + (k,), got {view.shape}"
        )
    as_payload(view.dtype, (0,))  # whether programs compute with such numbers
    if not is_packed(view):
        raise ValueError("payload: the array on the GPU is not in C order, or not aligned; copy it")
    width = 1 if view.shape == shape else view.shape[-1]
    if getattr(payload, "__cuda_array_interface__", {"data": (0, False)})["data"][1]:
        raise ValueError("payload: the array is read-only, and programs write to it")
    return PlacedPayload(payload, (view.dtype, width), np.uint64(view.address))

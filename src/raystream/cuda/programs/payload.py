"""Payloads in GPU memory: allocated, viewed, or copied there and back."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raystream.core.libraries import library_of
from raystream.core.rays import is_on_gpu
from raystream.cuda.programs.device_program import Record
from raystream.cuda.programs.records import aligned_dtype, aligned_records
from raystream.cuda.programs.skip_prim_ids import is_packed
from raystream.jit.cuda import DeviceArray, StreamScope, view_of
from raystream.programs.payloads import as_payload, as_records


def record_of(records: NDArray[Any] | None) -> Record | None:
    """The record type of an array of `as_records`."""
    if records is None:
        return None
    return aligned_dtype(records.dtype), 1 if records.ndim == 1 else records.shape[1]


@dataclass
class PlacedPayload:
    """A payload on a device.

    Attributes
    ----------
    result : object
        The payload as the tracer returns it.
    record : (dtype, int) or None
    address : uint64
    host : ndarray or None
        Records on the host, of which `placed` is a copy.
    placed : DeviceArray or None
    """

    result: Any
    record: Record | None
    address: np.uint64
    host: NDArray[Any] | None = None
    placed: DeviceArray | None = None

    @property
    def record_bytes(self) -> int:
        """Bytes per ray."""
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


def place_payload(scope: StreamScope, payload: Any, shape: tuple[int, ...]) -> PlacedPayload:
    """Allocate a payload on a device, view it there, or copy it there.

    Parameters
    ----------
    scope : StreamScope
    payload : array, dtype or None
        On the device: numbers in C order, of shape S or S + (k,). Otherwise as for `as_payload`;
        fields of records allocated there are aligned.
    shape : tuple of int
        The rays' shape S.

    Raises
    ------
    ValueError, TypeError
        If its shape or dtype does not fit, or it is not in C order.
    """
    if payload is None:
        return PlacedPayload(None, None, np.uint64(0))
    if isinstance(payload, DeviceArray) or is_on_gpu(payload):
        return _viewed(scope, payload, shape)
    if isinstance(payload, np.ndarray) or library_of(payload, None) is not None:
        result = as_payload(payload, shape)
        records = as_records(result, shape)
        own = aligned_records(records)
        scope.keep(own)
        placed = scope.placed("payload", own)
        return PlacedPayload(result, record_of(records), placed.address, records, placed)
    empty = as_payload(payload, (0,))
    dtype = aligned_dtype(empty.dtype)
    record = record_of(as_records(empty, (0,)))
    made = scope.cleared("payload", (*shape, *empty.shape[1:]), dtype)
    return PlacedPayload(made, record, made.address)


def _viewed(scope: StreamScope, payload: Any, shape: tuple[int, ...]) -> PlacedPayload:
    view = view_of(scope, "payload", payload)
    if isinstance(payload, DeviceArray):  # its interface does not name fields
        view = view._replace(dtype=payload.dtype)
    if view.shape != shape and (view.shape[:-1] != shape or view.dtype.fields is not None):
        raise ValueError(
            f"payload: expected the rays' shape {shape}, or {shape} + (k,), got {view.shape}"
        )
    as_payload(view.dtype, (0,))  # raises if programs do not support the dtype
    if not is_packed(view):
        raise ValueError("payload: the array on the GPU is not in C order, or not aligned; copy it")
    width = 1 if view.shape == shape else view.shape[-1]
    if getattr(payload, "__cuda_array_interface__", {"data": (0, False)})["data"][1]:
        raise ValueError("payload: the array is read-only, but programs write to it")
    return PlacedPayload(payload, (view.dtype, width), np.uint64(view.address))

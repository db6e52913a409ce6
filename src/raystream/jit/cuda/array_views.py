"""Views of other libraries' GPU arrays, without a copy.

Through ``__cuda_array_interface__``, whose version 3 names the stream that fills the array, or
DLPack, where we name our stream and the exporter lets it wait.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from raystream.core.rays import is_on_gpu
from raystream.jit.cuda.gpu import CudaError, Gpu
from raystream.jit.cuda.stream_scope import StreamScope
from raystream.jit.cuda.streams import LEGACY, CudaStream

#: DLPack's device type of memory shared by all devices and the host.
_MANAGED = 13


class DeviceView(NamedTuple):
    """Memory layout of an array.

    Attributes
    ----------
    address : int
        Of the first element.
    shape : tuple of int
    strides : tuple of int
        In bytes.
    dtype : dtype
    """

    address: int
    shape: tuple[int, ...]
    strides: tuple[int, ...]
    dtype: np.dtype[Any]


def stream_of(gpu: Gpu, arrays: Mapping[str, Any]) -> CudaStream:
    """The stream of the first array that names one, else the legacy default stream.

    Parameters
    ----------
    gpu : Gpu
    arrays : mapping
        By name; host arrays are skipped.
    """
    for values in arrays.values():
        if is_on_gpu(values):
            handle = _handle(_interface(values))
            if handle is not None:
                return CudaStream(gpu, handle)
    return CudaStream(gpu, LEGACY)


def view_of(scope: StreamScope, name: str, values: Any) -> DeviceView:
    """View an array in the order of a scope's stream.

    Parameters
    ----------
    scope : StreamScope
        It waits for the array, and keeps it alive until it has been read.
    name : str
        Of the argument, for errors.
    values : object
        With ``__cuda_array_interface__`` or DLPack.

    Raises
    ------
    TypeError
        If it cannot be viewed.
    CudaError
        If it is on another device.
    """
    interface = _interface(values)
    if interface is not None and (
        _handle(interface) is not None or not hasattr(values, "__dlpack__")
    ):
        return _by_interface(scope, name, interface)
    return _by_dlpack(scope, name, values)


def _interface(values: Any) -> Mapping[str, Any] | None:
    try:
        interface: Mapping[str, Any] | None = getattr(values, "__cuda_array_interface__", None)
    except Exception:  # such as a PyTorch tensor that requires grad: DLPack's error is clearer
        return None
    return interface


def _handle(interface: Mapping[str, Any] | None) -> int | None:
    """Handle of the stream that an array names, if any; an invalid 0 is the default stream."""
    handle = None if interface is None else interface.get("stream")
    return None if handle is None else int(handle) or LEGACY


def _by_interface(scope: StreamScope, name: str, interface: Mapping[str, Any]) -> DeviceView:
    try:
        if interface.get("mask") is not None:
            raise ValueError("it has a mask")
        address = int(interface["data"][0] or 0)
        shape = tuple(map(int, interface["shape"]))
        dtype = np.dtype(interface["typestr"])
        given = interface.get("strides")
        strides = _packed(shape, dtype) if given is None else tuple(map(int, given))
        if len(strides) != len(shape):
            raise ValueError(f"it has {len(shape)} dimensions and {len(strides)} strides")
    except (KeyError, TypeError, ValueError, IndexError) as error:
        raise _unreadable(name, error) from error
    _check_device(scope.gpu, name, scope.gpu.number_of(address))
    handle = _handle(interface)
    if handle is not None and handle != scope.stream.handle:
        scope.borrow(CudaStream(scope.gpu, handle))
    return DeviceView(address, shape, strides, dtype)


def _by_dlpack(scope: StreamScope, name: str, values: Any) -> DeviceView:
    from cuda.core.utils import StridedMemoryView

    gpu = scope.gpu
    try:
        kind, number = map(int, values.__dlpack_device__())
    except Exception as error:  # exporters raise any exception
        raise _unreadable(name, error) from error
    if kind != _MANAGED:
        _check_device(gpu, name, number)
    try:
        with gpu.current():
            view = StridedMemoryView.from_dlpack(values, stream_ptr=scope.stream.handle)
        dtype = np.dtype(view.dtype)
        shape = tuple(map(int, view.shape))
        strides = view.strides
    except Exception as error:  # exporters raise any exception
        raise _unreadable(name, error) from error
    scope.keep(view)
    steps = _packed(shape, dtype)
    if strides is not None:
        steps = tuple(int(stride) * dtype.itemsize for stride in strides)
    return DeviceView(int(view.ptr), shape, steps, dtype)


def _packed(shape: tuple[int, ...], dtype: np.dtype[Any]) -> tuple[int, ...]:
    """Strides of a C-contiguous array."""
    strides = [dtype.itemsize]
    for length in shape[:0:-1]:
        strides.append(strides[-1] * length)
    return tuple(strides[::-1]) if shape else ()


def _check_device(gpu: Gpu, name: str, number: int) -> None:
    if number != gpu.number:
        raise CudaError(
            f"{name}: the array is on GPU {number}, and this tracer on GPU {gpu.number}; "
            f"copy it there, or make a tracer with gpu={number}"
        )


def _unreadable(name: str, error: Exception) -> TypeError:
    reason = " ".join(str(error).split()) or type(error).__name__
    return TypeError(f"{name}: cannot be read as an array on a GPU ({reason})")

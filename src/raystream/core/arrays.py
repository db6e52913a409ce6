"""Conversion of array-like arguments to NumPy arrays, without copying if possible."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["as_host_array", "as_real_array", "is_on_gpu"]

#: DLPack device types whose memory NumPy can read: kDLCPU, kDLCUDAHost, kDLROCMHost.
_HOST_DEVICE_TYPES = (1, 3, 11)


def as_host_array(name: str, values: Any) -> NDArray[Any]:
    """View an array-like object as a NumPy array.

    Accepts NumPy arrays, everything that `numpy.asarray` takes (sequences,
    ``__array_interface__``, ``__array__``, buffers) and DLPack exporters on the CPU, such as
    PyTorch and JAX arrays.

    Parameters
    ----------
    name : str
        Name of the argument, for the error.
    values : array_like

    Raises
    ------
    TypeError
        If the array is on a GPU, or cannot be read as an array.
    """
    if isinstance(values, np.ndarray):
        return values
    if is_on_gpu(values):
        raise TypeError(
            f"{name}: the array is on a GPU, where only the queries of device='cuda' read it, "
            "without counters; copy it to the host first (.get(), .cpu(), "
            ".host() or copy_to_host())"
        )
    if hasattr(values, "__dlpack__") and hasattr(values, "__dlpack_device__"):
        try:
            return np.from_dlpack(values)
        except (BufferError, RuntimeError, TypeError):
            pass  # such as a PyTorch tensor that requires grad: asarray has the better error
    try:
        return np.asarray(values)
    except Exception as error:
        raise TypeError(f"{name}: cannot be read as an array ({error})") from error


def is_on_gpu(values: Any) -> bool:
    """Whether an array is in a GPU's memory.

    It has a DLPack device that NumPy cannot read, or ``__cuda_array_interface__``.
    """
    if isinstance(values, np.ndarray | float | int):
        return False
    if hasattr(values, "__dlpack_device__"):
        try:
            if int(values.__dlpack_device__()[0]) not in _HOST_DEVICE_TYPES:
                return True
        except Exception:  # an exporter without a device: see the interface below
            pass
    try:
        return hasattr(values, "__cuda_array_interface__")
    except Exception:  # PyTorch's, of a tensor that requires grad
        return False


def as_real_array(name: str, values: Any) -> NDArray[Any]:
    """View values as an array of real numbers: float32 and float16 as float32, others as float64.

    Raises
    ------
    TypeError
        If the values are not real numbers, or not on the CPU.
    """
    array = as_host_array(name, values)
    if array.dtype == np.float32 and array.dtype.isnative:
        return array
    if array.dtype.kind not in "fiu":
        raise TypeError(f"{name}: expected real numbers, got dtype {array.dtype}")
    if array.dtype == np.float16:
        return array.astype(np.float32)
    return array.astype(np.float64, copy=False)

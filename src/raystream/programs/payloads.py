"""Payloads: a record per ray that programs read and write."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from raystream.core.libraries import library_of
from raystream.core.library_hits import in_library

#: Sizes of supported numbers in bytes, by kind.
_SIZES = {"b": (1,), "i": (1, 2, 4, 8), "u": (1, 2, 4, 8), "f": (4, 8), "c": (8, 16)}


def as_payload(payload: Any, shape: tuple[int, ...]) -> NDArray[Any]:
    """The array that a program writes: the caller's, or zeros of a dtype.

    Parameters
    ----------
    payload : ndarray, array of another library on the host, or dtype
    shape : tuple of int
        The rays' shape S.

    Raises
    ------
    ValueError
        If an array is read-only, or its shape is neither S nor, for plain numbers, S + (k,).
    TypeError
        If it is neither an array nor a dtype, or of another type than numbers and records.
    """
    if library_of(payload, None) is not None:
        payload = _shared(payload)
    if not isinstance(payload, np.ndarray):
        try:
            dtype = np.dtype(payload)
        except TypeError as error:
            raise TypeError(
                f"payload: expected a writable NumPy array or a dtype, got {payload!r:.60}"
            ) from error
        _check_dtype(dtype)
        payload = np.zeros(shape, dtype)
    _check_dtype(payload.dtype)
    if not payload.flags.writeable:
        raise ValueError(
            "payload: the array is read-only, but programs write to it; give a dtype for a new one"
        )
    is_plain = payload.dtype.fields is None
    if payload.shape != shape and not (is_plain and payload.shape[:-1] == shape):
        wanted = f"{shape}, or {shape} + (k,)" if is_plain else f"{shape}"
        raise ValueError(f"payload: expected the rays' shape {wanted}, got {payload.shape}")
    return payload


def _shared(payload: Any) -> NDArray[Any]:
    """An array of another library as NumPy's, in the same memory."""
    try:
        return np.asarray(payload)
    except Exception as error:
        raise TypeError(f"payload: cannot be read as an array ({error})") from error


def returned_payload(payload: Any, result: Any, origins: Any, directions: Any) -> Any:
    """What a query returns of its payload: the caller's array, or a new one in its library.

    Parameters
    ----------
    payload : array or dtype
        As the caller gave it.
    result : array or None
        That of `as_payload`, or on a GPU.
    origins, directions : array_like
    """
    if isinstance(payload, np.ndarray) or library_of(payload, None) is not None:
        return payload
    is_plain = result is not None and result.dtype.fields is None
    return in_library(result, origins, directions) if is_plain else result


def as_records(payload: NDArray[Any], shape: tuple[int, ...]) -> NDArray[Any]:
    """The payload as an argument of loops: a record or a row of numbers per ray.

    A view of the payload, or a copy if that is not contiguous.
    """
    array = np.ascontiguousarray(payload).view(np.ndarray)
    count = int(np.prod(shape, dtype=np.int64))
    if payload.dtype.fields is not None:
        return array.reshape(count)
    return array.reshape(count, 1 if payload.shape == shape else payload.shape[-1])


def _check_dtype(dtype: np.dtype[Any]) -> None:
    if dtype.subdtype is not None:
        _check_dtype(dtype.subdtype[0])
    elif dtype.fields is not None:
        for field, *_ in dtype.fields.values():
            _check_dtype(field)
    elif dtype.itemsize not in _SIZES.get(dtype.kind, ()) or not dtype.isnative:
        raise TypeError(f"payload: programs cannot compute with dtype {dtype}")

"""Taking arrays from a file, checked by name, dtype and shape."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["take"]


def take(
    arrays: Mapping[str, NDArray[Any]], name: str, dtype: Any, shape: tuple[int | None, ...]
) -> NDArray[Any]:
    """Take an array from a file.

    Parameters
    ----------
    arrays : mapping of str to ndarray
    name : str
    dtype : dtype
    shape : tuple of int or None
        Expected lengths; None for any.

    Returns
    -------
    ndarray
        Contiguous.

    Raises
    ------
    ValueError
        If it is missing, or of another dtype or shape.
    """
    array = arrays.get(name)
    if array is None:
        raise ValueError(f"array {name!r} is missing")
    fits = array.ndim == len(shape) and all(
        wanted is None or length == wanted
        for length, wanted in zip(array.shape, shape, strict=True)
    )
    if array.dtype != dtype or not fits:
        raise ValueError(f"array {name!r} has dtype {array.dtype} and shape {array.shape}")
    return np.ascontiguousarray(array).reshape(array.shape)  # a scalar has become 1D

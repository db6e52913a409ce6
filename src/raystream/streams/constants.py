"""Constants of kernels: numbers and tuples of them, of fixed types."""

from __future__ import annotations

from typing import Any

import numpy as np


def as_constant(label: str, value: Any) -> Any:
    """Check a constant.

    Parameters
    ----------
    label : str
        For errors.
    value : number or tuple
        NumPy scalars keep their type; Python numbers are bool, int64, float64 or complex128. An
        item of a tuple may be None, which is a type of its own: code for it is left out when a
        function is compiled.

    Raises
    ------
    TypeError
        If it is neither a number nor a tuple of constants.
    """
    if isinstance(value, tuple):
        parts: list[Any] = [None if part is None else as_constant(label, part) for part in value]
        return type(value)(*parts) if hasattr(value, "_fields") else tuple(parts)
    if isinstance(value, bool | int | float | complex):
        return value
    if isinstance(value, np.generic) and value.dtype.kind in "biufc" and value.dtype.itemsize > 1:
        return value
    if isinstance(value, np.bool_ | np.int8 | np.uint8):
        return value
    raise TypeError(
        f"{label}: expected a number or a tuple of numbers, got {type(value).__name__}; arrays "
        "are gather arrays"
    )


def changed_constant(label: str, old: Any, new: Any) -> Any:
    """The new value, in the type of the old one.

    Raises
    ------
    TypeError
        If that type cannot hold it.
    """
    if old is None:
        if new is not None:
            raise TypeError(f"{label}: {new!r} cannot replace None")
        return None
    if isinstance(old, tuple):
        if not isinstance(new, tuple | list) or len(new) != len(old):
            raise TypeError(f"{label}: expected a tuple of {len(old)}")
        parts = [changed_constant(label, *pair) for pair in zip(old, new, strict=True)]
        return type(old)(*parts) if hasattr(old, "_fields") else tuple(parts)
    new = as_constant(label, new)
    if isinstance(new, tuple) or _rank(new) > _rank(old):
        raise TypeError(f"{label}: {new!r} is not of type {type(old).__name__}")
    return type(old)(new)


def _rank(number: Any) -> int:
    """0 to 3: bool, integer, float, complex."""
    kind = np.asarray(number).dtype.kind
    return {"b": 0, "i": 1, "u": 1, "f": 2}.get(kind, 3)

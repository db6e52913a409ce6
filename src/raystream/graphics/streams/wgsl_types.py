"""Types of WGSL: those of records and constants, and the words of constants."""

from __future__ import annotations

import struct
from typing import Any

import numpy as np

_SCALARS = {"float32": "f32", "int32": "i32", "uint32": "u32"}

#: Types of constants: their number of components and the letter of `struct` for each.
CONSTANT_TYPES = {
    name: (count, code)
    for scalar, code in (("f32", "f"), ("i32", "i"), ("u32", "I"))
    for count, name in (
        (1, scalar),
        (2, f"vec2{scalar[0]}"),
        (3, f"vec3{scalar[0]}"),
        (4, f"vec4{scalar[0]}"),
    )
}

_KINDS = {
    "f": (float, np.floating, int, np.integer),
    "i": (int, np.integer),
    "I": (int, np.integer),
}

#: Bytes of a constant in a uniform buffer, whatever its type.
_BYTES = 16


def type_of(dtype: np.dtype[Any], components: int) -> str:
    """The type of a record of a stream."""
    return of_components(_SCALARS[dtype.name], components)


def of_components(scalar: str, components: int) -> str:
    """A scalar type, or that of a vector."""
    return scalar if components == 1 else f"vec{components}{scalar[0]}"


def constant_words(label: str, wanted: str, value: Any) -> bytes:
    """A constant as the bytes of its place in a uniform buffer.

    Parameters
    ----------
    label : str
        For errors.
    wanted : str
        One of `CONSTANT_TYPES`.
    value : number or sequence of numbers

    Raises
    ------
    TypeError
        If the type cannot hold the value.
    ValueError
        If the value is out of its range.
    """
    count, code = CONSTANT_TYPES[wanted]
    parts = list(value) if isinstance(value, tuple | list | np.ndarray) else [value]
    if len(parts) != count or (count == 1) != (parts[0] is value):
        what = "a number" if count == 1 else f"{count} numbers"
        raise TypeError(f"{label}: {wanted} takes {what}, not {value!r:.60}")
    for part in parts:
        if isinstance(part, bool | np.bool_) or not isinstance(part, _KINDS[code]):
            raise TypeError(f"{label}: {wanted} cannot hold {part!r:.60}")
    try:
        words = struct.pack(f"<{count}{code}", *parts)
    except (struct.error, OverflowError) as error:
        raise ValueError(f"{label}: {value!r:.60} is out of the range of {wanted}") from error
    return words.ljust(_BYTES, b"\0")

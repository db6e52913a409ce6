"""Arguments of kernels: their types, and the flat list that a launch takes."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numba
import numpy as np

__all__ = ["flat", "kind_of", "type_of"]


def type_of(arguments: Any) -> Any:
    """Numba's type of arguments as kernels take them."""
    return numba.typeof(arguments)


def kind_of(arguments: Any) -> Any:
    """What decides the type of arguments: found in a tenth of the time that the type takes."""
    if isinstance(arguments, tuple):
        return type(arguments), *map(kind_of, arguments)
    return type(arguments)


def flat(arguments: Any) -> Iterator[Any]:
    """The numbers in nested tuples, as Numba's kernels expect them one after the other.

    None is a pointer that nobody follows.
    """
    for one in arguments:
        if one is None:
            yield np.uint64(0)
        elif isinstance(one, tuple):
            yield from flat(one)
        elif isinstance(one, bool | np.bool_):
            yield np.uint8(one)
        elif type(one) is float:
            yield np.float64(one)
        else:
            yield one

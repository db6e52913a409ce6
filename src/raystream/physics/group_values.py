"""Values for materials or meshes, given by name, by number or as an array."""

from __future__ import annotations

import operator
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raystream.core.rays import as_real_array


def group_values(
    argument: str,
    values: Any,
    names: tuple[str, ...],
    kind: str,
    *,
    high: float = np.inf,
    default: float = np.nan,
) -> NDArray[np.float64]:
    """Make an array with a value for each name.

    Parameters
    ----------
    argument : str
        Name of the argument, for errors.
    values : mapping, or array_like of shape () or (M,), real
        A mapping has names or numbers as keys; one value applies to all.
    names : tuple of str
    kind : str
        What is named, for errors: "material" or "mesh".
    high : float
        Values must be in [0, high].
    default : float
        For names that a mapping omits.

    Returns
    -------
    ndarray of shape (M,), float64

    Raises
    ------
    ValueError, TypeError
        If a value is out of range or not a real number, a name is unknown, ambiguous or given
        twice, or an array's shape is wrong.
    """
    if isinstance(values, Mapping):
        table = np.full(len(names), default)
        given = set()
        for key, value in values.items():
            index = _index_of(argument, key, names, kind)
            if index in given:
                raise ValueError(f"{argument}: {kind} {index} ({names[index]!r}) is given twice")
            given.add(index)
            table[index] = _numbers(f"{argument}[{key!r}]", value, (), high)
        return table
    shape = () if np.ndim(values) == 0 else (len(names),)
    return np.array(np.broadcast_to(_numbers(argument, values, shape, high), len(names)))


def _index_of(argument: str, key: Any, names: tuple[str, ...], kind: str) -> int:
    if isinstance(key, str):
        count = names.count(key)
        if count == 1:
            return names.index(key)
        if count:
            raise ValueError(f"{argument}: {key!r} has {count} matches; use their numbers")
        listed = ", ".join(repr(name) for name in names[:8]) + (", ..." if names[8:] else "")
        raise ValueError(f"{argument}: no {kind} {key!r}; there are {listed}")
    index = operator.index(key)
    if not 0 <= index < len(names):
        raise ValueError(f"{argument}: no {kind} {index}; they are 0 to {len(names) - 1}")
    return index


def _numbers(name: str, values: Any, shape: tuple[int, ...], high: float) -> NDArray[np.float64]:
    array = as_real_array(name, values).astype(np.float64)
    if array.shape != shape:
        raise ValueError(f"{name}: expected shape {shape}, got {array.shape}")
    is_good = (array >= 0.0) & (array <= high)
    if not is_good.all():
        wanted = "numbers >= 0" if high == np.inf else f"numbers from 0 to {high:g}"
        raise ValueError(f"{name}: expected {wanted}, got {array[~is_good].flat[0]}")
    return array

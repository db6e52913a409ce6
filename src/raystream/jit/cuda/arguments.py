"""Kernel arguments: numbers, and tuples of them; arrays on a device stand for their addresses."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import Any, get_args, get_origin, get_type_hints

import numba
import numpy as np

from raystream.jit.cuda.device_array import DeviceArray

#: Integers from here on are uint64, others int64.
_LEAST_UNSIGNED = 2**63

#: How values other than NumPy's numbers are passed.
_CONVERTED: dict[Any, Callable[[Any], Any]] = {
    type(None): lambda _: np.uint64(0),
    bool: np.uint8,
    np.bool_: np.uint8,
    float: np.float64,
    int: lambda one: kind_of(one)(one),
    DeviceArray: lambda one: one.address,
}


def type_of(arguments: Any) -> Any:
    """The Numba type of kernel arguments."""
    return numba.typeof(with_addresses(arguments))


def with_addresses(arguments: Any) -> Any:
    """Arguments with the addresses of arrays in place of these."""
    if isinstance(arguments, tuple):
        return _tuple_like(arguments, map(with_addresses, arguments))
    if isinstance(arguments, int) and type(arguments) is not bool:
        return int(arguments)  # members of an IntEnum have a type of their own
    return arguments.address if type(arguments) is DeviceArray else arguments


def _tuple_like(given: Any, made: Iterable[Any]) -> Any:
    kind = type(given)
    return kind._make(made) if hasattr(kind, "_fields") else kind(made)


def kind_of(arguments: Any) -> Any:
    """A key that determines `type_of`, found in a tenth of its time."""
    kind = type(arguments)
    if isinstance(arguments, tuple):
        return kind, *map(kind_of, arguments)
    if kind is not bool and isinstance(arguments, int):
        return np.int64 if arguments < _LEAST_UNSIGNED else np.uint64
    return np.uint64 if kind is DeviceArray else kind


def flat(arguments: Any) -> Iterator[Any]:
    """Flatten nested tuples into the numbers that Numba's kernels expect.

    None becomes a null pointer, which is never dereferenced.
    """
    for one in arguments:
        kind = type(one)
        if kind is np.uint64 or kind is np.float32:  # most are
            yield one
        elif isinstance(one, tuple):
            yield from flat(one)
        elif kind in _CONVERTED:
            yield _CONVERTED[kind](one)
        elif isinstance(one, int):  # such as a member of an IntEnum
            yield _CONVERTED[int](int(one))
        else:
            yield one


def example_of(kind: Any) -> Any:
    """An argument of a type: a number, or a (named) tuple; also of a tuple of types."""
    if isinstance(kind, tuple):
        return _tuple_like(kind, map(example_of, kind))
    if hasattr(kind, "_fields"):
        return kind._make(map(example_of, get_type_hints(kind).values()))
    if get_origin(kind) is tuple:
        return example_of(get_args(kind))
    if kind is type(None):
        return None
    return np.uint64(0) if kind is DeviceArray else kind(0)

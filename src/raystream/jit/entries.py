"""Machine code of kernels, to be called several times with arguments of the same types.

Numba finds the types of all arguments in each call. For named tuples it reads the names of their
members, too: 5 us for those of a batch of rays, of which reading the numbers takes 0.4.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any
from weakref import WeakKeyDictionary

from numba import typeof
from numba._dispatcher import compute_fingerprint
from numba.core.registry import CPUDispatcher

#: The entry points of kernels, by Numba's digest of the types of arguments.
_ENTRIES: WeakKeyDictionary[Any, dict[bytes, Callable[..., Any]]] = WeakKeyDictionary()


def entry_of(function: Callable[..., Any], arguments: tuple[Any, ...]) -> Callable[..., Any]:
    """The machine code for a kernel's argument types, compiled on first use.

    Parameters
    ----------
    function : callable
        A kernel; others are returned as they are.
    arguments : tuple

    Returns
    -------
    callable
        To be called with arguments of the same types, which it does not check.
    """
    if not isinstance(function, CPUDispatcher):
        return function
    try:
        types = compute_fingerprint(arguments)
    except NotImplementedError:  # Numba has none for some arguments, such as functions
        return function
    entries = _ENTRIES.setdefault(function, {})
    if types not in entries:
        entries[types] = function.compile(tuple(map(typeof, arguments)))
    return entries[types]

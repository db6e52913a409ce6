"""Form: a structure as shaders take it."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["Form", "budget_for", "numbers"]

#: Searches take some steps whatever the structure is.
_LEAST_BUDGET = 1 << 10


@dataclass(frozen=True)
class Form:
    """A structure as shaders take it.

    Attributes
    ----------
    name : str
        The structure's.
    shader : str
        The file with its ``Tree``, its buffers, and ``search()``.
    tree : bytes
        The uniform ``Tree``, laid out as WGSL does.
    arrays : tuple of ndarray
        Its buffers: binding k of group 1 has the k-th.
    budget : int
        More steps and tests than a search can take: what takes more is endless.
    constants : dict of str to float
        Of the pipeline: values of the file's ``override`` declarations.
    lists_twice : bool
        Whether a search may meet a triangle more than once.
    """

    name: str
    shader: str
    tree: bytes
    arrays: tuple[NDArray[Any], ...]
    budget: int
    constants: dict[str, float] = field(default_factory=dict)
    lists_twice: bool = False


def numbers(*values: float | np.integer[Any] | np.floating[Any]) -> bytes:
    """Numbers as the words of a uniform: float32 for floats, uint32 for integers."""
    words = [
        np.float32(value) if isinstance(value, float | np.floating) else np.uint32(value)
        for value in values
    ]
    return b"".join(word.tobytes() for word in words)


def budget_for(most: int) -> int:
    """A budget for so many steps and tests, in 32 bits."""
    return min(_LEAST_BUDGET + most, 2**32 - 1)

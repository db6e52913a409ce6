"""ShaderStructure: a structure as shaders read it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raystream.graphics.packing import LOCAL_RAYS, RayKind
from raystream.graphics.shader_source import TREE_GROUP, shader_source

#: Bytes of the uniform ``Params`` before the structure's ``Tree``.
TREE_AT = 32

#: Budget of a search besides what the structure needs.
_MIN_BUDGET = 1 << 10


@dataclass(frozen=True)
class ShaderStructure:
    """A structure as shaders read it.

    Attributes
    ----------
    name : str
        The structure's name.
    shader : str
        The file with its ``Tree``, its buffers, and ``search()``.
    tree : bytes
        The uniform ``Tree``, laid out as WGSL does.
    arrays : tuple of ndarray
        Its buffers: binding k of group 1 is the k-th.
    budget : int
        Upper bound of the steps and tests of a search: one that exceeds it is endless.
    constants : dict of str to float
        Values of the file's ``override`` declarations.
    sizes : dict of str to int
        Constants that are declared before the file, for the sizes of its arrays.
    instead : dict of str to str
        Replacements of the file's includes; see `shader_source`.
    rays : RayKind
        How the compute machine stores rays.
    """

    name: str
    shader: str
    tree: bytes
    arrays: tuple[NDArray[Any], ...]
    budget: int
    constants: dict[str, float] = field(default_factory=dict)
    sizes: dict[str, int] = field(default_factory=dict)
    instead: dict[str, str] = field(default_factory=dict)
    rays: RayKind = LOCAL_RAYS

    def params(
        self,
        max_coordinate: np.float32,
        *,
        ray_count: int = 0,
        row_size: int = 0,
        capacity: int = 0,
    ) -> bytes:
        """The uniform ``Params`` of a search, see params.wgsl."""
        shared = numbers(max_coordinate, 0, ray_count, row_size, self.budget, capacity)
        return shared + bytes(TREE_AT - len(shared)) + self.tree

    def source(
        self,
        *names: str,
        instead: Mapping[str, str] | None = None,
        tree_group: int = TREE_GROUP,
    ) -> str:
        """The source of a machine's shader files and the structure's; see `shader_source`."""
        declared = [f"const {name}: u32 = {size}u;" for name, size in self.sizes.items()]
        replaced = {**self.instead, **(instead or {})}
        return "\n".join(
            [*declared, shader_source(*names, self.shader, instead=replaced, tree_group=tree_group)]
        )


def numbers(*values: float | np.integer[Any] | np.floating[Any]) -> bytes:
    """Numbers as the words of a uniform: float32 for floats, uint32 for integers."""
    words = [
        np.float32(value) if isinstance(value, float | np.floating) else np.uint32(value)
        for value in values
    ]
    return b"".join(word.tobytes() for word in words)


def budget_for(most: int) -> int:
    """A budget for a number of steps and tests, in 32 bits."""
    return min(_MIN_BUDGET + most, 2**32 - 1)

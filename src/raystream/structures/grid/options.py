"""Grid: the options of the uniform grid."""

from __future__ import annotations

import math
import operator
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Literal

from raystream.core.options import Range
from raystream.structures.registry import StructureOptions, register_structure

#: Most cells along an axis: their indices, and the next few, are exact in float32.
MAX_AXIS = 1 << 20

#: Most cells of a grid: their empty lists take 2 GB while building.
MAX_CELLS = 1 << 28


@register_structure
@dataclass(frozen=True, kw_only=True)
class Grid(StructureOptions):
    """A uniform grid (Purcell 2002, section 3): the scene's box, divided into equal cells.

    Parameters
    ----------
    resolution : int or sequence of three int, optional
        Cells along the axes x, y and z, of any shape; one number applies to all three. No
        cell is smaller than 2**-16 of the largest coordinate, so an axis along which the scene is
        flat has fewer cells, or only one.
    min_resolution : int, optional
        Cells along the shortest axis along which the scene is not flat; the others get cells of
        about the same size (Purcell 2002, section 4.1).
    levels : {1, 2}
        With 2, cells with many triangles are subdivided (Purcell 2002, section 5.1): for
        scenes with details of many sizes.
    overlap : {"plane", "exact"}
        Which cells list a triangle: those that its box and its plane overlap, or only those that
        the triangle overlaps, tested with separating axes (Christen 2005, section 5.1.1).
        ``"exact"`` is for comparison with the papers: lists are shorter, but hits may differ from
        those of other structures, or be missed, where a ray grazes a triangle's edge.

    Raises
    ------
    ValueError
        If an option is out of range, both resolutions are given, or they imply more than
        2**28 cells or 2**20 along an axis.
    TypeError
        If a number is not an integer.

    Notes
    -----
    Memory is 4 bytes per cell, twice that while building, and 4 per reference.
    Without `resolution` and `min_resolution` there are about 2 cells per triangle, or 1 per
    4 triangles with two levels, and fewer if triangles are so large that lists become long: at
    most 24 references per triangle (or 2**20). A scene with details that are small compared to
    its size, such as a teapot in a stadium, then has them in few cells: tracing is slow there, but
    the hits are the same.
    """

    name = "grid"
    structure = "raystream.structures.grid.structure:GridStructure"
    cell_counter = "steps"
    forms: ClassVar = {
        "multipass": "raystream.machines.steps.grid:steps",
        "cuda build": "raystream.cuda.builders.grid:build_grid",
        "graphics": "raystream.graphics.structures.grid:shader_structure",
        "graphics multipass": "raystream.graphics.multipass.kernels.grid:kernels",
    }

    resolution: int | Sequence[int] | None = None
    min_resolution: int | None = None
    levels: Annotated[int, Range(1, 2)] = 1
    overlap: Literal["plane", "exact"] = "plane"

    @property
    def counts(self) -> tuple[int, int, int] | None:
        """`resolution` after validation: one number per axis."""
        return self.resolution  # type: ignore[return-value]

    @property
    def is_exact(self) -> bool:
        """Whether cells list only the triangles that overlap them."""
        return self.overlap == "exact"

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.resolution is not None and self.min_resolution is not None:
            raise ValueError("min_resolution: expected None if resolution is given")
        if self.min_resolution is not None:
            _checked("min_resolution", self.min_resolution)
        if self.resolution is not None:
            object.__setattr__(self, "resolution", _triple(self.resolution))


def _triple(resolution: Any) -> tuple[int, int, int]:
    """Cells along each axis, from one number or three."""
    try:
        numbers = list(resolution)
    except TypeError:
        numbers = [resolution] * 3
    if len(numbers) != 3:
        raise ValueError(f"resolution: expected one number or three, got {len(numbers)}")
    x, y, z = (_checked("resolution", number) for number in numbers)
    check_cells("resolution", (x, y, z))
    return x, y, z


def _checked(option: str, number: Any) -> int:
    try:
        number = operator.index(number)
    except TypeError as error:
        raise TypeError(f"{option}: {error}") from None
    if not 1 <= number <= MAX_AXIS:
        raise ValueError(f"{option}: expected 1 to {MAX_AXIS:,}, got {number:,}")
    return int(number)


def check_cells(option: str, counts: Sequence[int]) -> None:
    """Raise ValueError if there are more cells than a grid can have, or none."""
    if min(counts) < 1 or math.prod(counts) > MAX_CELLS or max(counts) > MAX_AXIS:
        cells = " x ".join(f"{count:,}" for count in counts)
        raise ValueError(
            f"{option}: {cells} cells are out of range; at most {MAX_CELLS:,} are possible,"
            f" and {MAX_AXIS:,} along an axis"
        )

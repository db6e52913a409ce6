"""Saving a built structure with its triangles, and loading it."""

from __future__ import annotations

import json
import math
from os import PathLike
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raystream.core.errors import FileFormatError
from raystream.core.npz import read_npz, write_npz
from raystream.core.scene_kinds import check_support
from raystream.core.triangles import Triangles
from raystream.structures import STRUCTURES, StructureOptions, structure_class
from raystream.structures.base import Structure
from raystream.structures.saved import take

#: Increased by every change that makes older files unreadable.
FORMAT_VERSION = 3

_FORMAT = "raystream structure"


def save_structure(path: str | PathLike[str], structure: Structure) -> None:
    """Write a structure to an ``.npz`` file.

    Parameters
    ----------
    path : str or path
    structure : Structure

    Raises
    ------
    ValueError
        If the name does not end in ``.npz``.
    OSError
        If it cannot be written.
    RaystreamError
        If the scene is not of triangles in float32 alone.
    """
    triangles = structure.triangles
    check_support("save", triangles)
    header = {
        "format": _FORMAT,
        "version": FORMAT_VERSION,
        "structure": structure.name,
        "options": structure.options.as_json(),
    }
    arrays: dict[str, NDArray[Any]] = {
        "header": np.frombuffer(json.dumps(header).encode(), np.uint8),
        "triangles.corners": triangles.corners,
        "triangles.mesh_splits": triangles.mesh_splits,
        "triangles.center": triangles.center,
        "triangles.scale": np.array(triangles.scale),
    }
    for name, array in structure.saved_arrays().items():
        arrays[f"structure.{name}"] = array
    write_npz(path, arrays)


def load_structure(path: str | PathLike[str], triangles: Triangles | None = None) -> Structure:
    """Read a structure that `save_structure` wrote.

    Parameters
    ----------
    path : str or path
    triangles : Triangles, optional
        If given, the file must contain the same ones.

    Returns
    -------
    Structure

    Raises
    ------
    FileFormatError
        If the file is damaged, not a structure file, of another version, or of other triangles.
    """
    arrays = read_npz(path)
    made, options = _header(path, arrays)
    try:
        stored = _triangles(arrays)
        if triangles is not None:
            if not _same(stored, triangles):
                raise ValueError("was built from other triangles than the scene's; rebuild it")
            stored = triangles
        own = {
            name.removeprefix("structure."): array
            for name, array in arrays.items()
            if name.startswith("structure.")
        }
        return structure_class(made.name).from_arrays(stored, own, _options(made, options))
    except ValueError as error:
        raise FileFormatError(path, str(error)) from None


def _header(
    path: str | PathLike[str], arrays: dict[str, NDArray[Any]]
) -> tuple[type[StructureOptions], Any]:
    """The class of the structure's options, and the saved options."""
    foreign = FileFormatError(path, "was not written by Tracer.save")
    try:
        header = json.loads(arrays["header"].tobytes())
    except (KeyError, ValueError, RecursionError):
        raise foreign from None
    if not isinstance(header, dict) or header.get("format") != _FORMAT:
        raise foreign
    if header.get("version") != FORMAT_VERSION:
        raise FileFormatError(
            path,
            f"has format version {header.get('version')!r:.40}, and this raystream reads "
            f"{FORMAT_VERSION}; rebuild the structure",
        )
    name = header.get("structure")
    if not isinstance(name, str) or name not in STRUCTURES:
        raise FileFormatError(path, f"holds an unknown structure {name!r:.40}")
    return STRUCTURES[name], header.get("options")


def _options(made: type[StructureOptions], saved: Any) -> StructureOptions:
    try:
        return made.from_json(saved)
    except ValueError as error:  # of a version with other options, or damaged
        raise ValueError(f"{error}; rebuild the structure") from None


def _triangles(arrays: dict[str, NDArray[Any]]) -> Triangles:
    corners = take(arrays, "triangles.corners", np.float32, (None, 3, 3))
    splits = take(arrays, "triangles.mesh_splits", np.int64, (None,))
    center = take(arrays, "triangles.center", np.float64, (3,))
    scale = float(take(arrays, "triangles.scale", np.float64, ()))
    if not (scale > 0.0 and math.isfinite(scale) and math.frexp(scale)[0] == 0.5):
        raise ValueError("invalid scale: not a power of two")
    if not np.isfinite(center).all():
        raise ValueError("invalid centre: not finite")
    if (
        len(splits) < 1
        or splits[0] != 0
        or splits[-1] != len(corners)
        or (np.diff(splits) < 0).any()
    ):
        raise ValueError("the mesh splits do not delimit the triangles")
    return Triangles.from_local(corners, splits, center, scale)


def _same(stored: Triangles, given: Triangles) -> bool:
    return (
        stored.scale == given.scale
        and np.array_equal(stored.center, given.center)
        and np.array_equal(stored.mesh_splits, given.mesh_splits)
        and np.array_equal(stored.corners, given.corners, equal_nan=True)
    )

"""Saving a built structure with its triangles, and loading it again."""

from __future__ import annotations

import json
import math
from os import PathLike
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raystream.core.errors import FileFormatError
from raystream.core.npz import read_npz, write_npz
from raystream.core.triangles import Triangles
from raystream.structures import STRUCTURES
from raystream.structures.base import Structure

__all__ = ["FORMAT_VERSION", "load_structure", "save_structure"]

#: Raised by every change after which older files cannot be read.
FORMAT_VERSION = 2

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
    """
    triangles = structure.triangles
    header = {"format": _FORMAT, "version": FORMAT_VERSION, "structure": structure.name}
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
        If given, the file must hold the same ones.

    Returns
    -------
    Structure

    Raises
    ------
    FileFormatError
        If the file is damaged, foreign, of another version, or of other triangles.
    """
    arrays = read_npz(path)
    structure_class = _structure_class(path, arrays)
    try:
        stored = _triangles(arrays)
        if triangles is not None:
            if not _same(stored, triangles):
                raise ValueError("was built of other triangles than the scene's; build it anew")
            stored = triangles
        own = {
            name.removeprefix("structure."): array
            for name, array in arrays.items()
            if name.startswith("structure.")
        }
        return structure_class.from_arrays(stored, own)
    except ValueError as error:
        raise FileFormatError(path, str(error)) from None


def _structure_class(path: str | PathLike[str], arrays: dict[str, NDArray[Any]]) -> type[Structure]:
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
            f"{FORMAT_VERSION}; build the structure anew",
        )
    name = header.get("structure")
    if not isinstance(name, str) or name not in STRUCTURES:
        raise FileFormatError(path, f"holds an unknown structure {name!r:.40}")
    return STRUCTURES[name]


def _triangles(arrays: dict[str, NDArray[Any]]) -> Triangles:
    expected = {
        "corners": ("f4", 3),
        "mesh_splits": ("i8", 1),
        "center": ("f8", 1),
        "scale": ("f8", 0),
    }
    found = {}
    for name, (dtype, dimensions) in expected.items():
        array = arrays.get(f"triangles.{name}")
        if array is None or array.dtype != np.dtype(dtype) or array.ndim != dimensions:
            raise ValueError(f"array 'triangles.{name}' is missing or of another kind")
        found[name] = array
    scale = float(found["scale"])
    if not (scale > 0.0 and math.isfinite(scale) and math.frexp(scale)[0] == 0.5):
        raise ValueError("its scale is not a power of two")
    if found["center"].shape != (3,) or not np.isfinite(found["center"]).all():
        raise ValueError("its centre is not a point")
    splits = found["mesh_splits"]
    corners = found["corners"]
    if corners.shape[1:] != (3, 3):
        raise ValueError("its corners are not those of triangles")
    if (
        len(splits) < 1
        or splits[0] != 0
        or splits[-1] != len(corners)
        or (np.diff(splits) < 0).any()
    ):
        raise ValueError("its meshes do not divide its triangles")
    return Triangles.from_local(np.ascontiguousarray(corners), splits, found["center"], scale)


def _same(stored: Triangles, given: Triangles) -> bool:
    return (
        stored.scale == given.scale
        and np.array_equal(stored.center, given.center)
        and np.array_equal(stored.mesh_splits, given.mesh_splits)
        and np.array_equal(stored.corners, given.corners, equal_nan=True)
    )

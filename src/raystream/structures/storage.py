"""Saving a built structure with its triangles, and loading it."""

from __future__ import annotations

import json
from collections.abc import Callable
from os import PathLike
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raystream.core.errors import FileFormatError
from raystream.core.npz import read_npz, write_npz
from raystream.core.store import Store
from raystream.structures import STRUCTURES, StructureOptions, builder_for
from raystream.structures.base import Structure
from raystream.structures.saved_stores import (
    Arrays,
    arrays_of,
    part_of,
    same_arrays,
    store_of,
)

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
    """
    triangles = structure.triangles
    header = {
        "format": _FORMAT,
        "version": FORMAT_VERSION,
        "structure": structure.name,
        "options": structure.options.as_json(),
        **({"kinds": triangles.kinds} if triangles.kinds else {}),
    }
    arrays = {"header": np.frombuffer(json.dumps(header).encode(), np.uint8)}
    write_npz(path, arrays | named_arrays(triangles, structure))


def named_arrays(triangles: Store, structure: Structure | None = None) -> dict[str, NDArray[Any]]:
    """What files and bundles hold of geometry, and of a structure of it, by name."""
    arrays = {f"triangles.{name}": one for name, one in arrays_of(triangles).items()}
    if structure is not None:
        own = structure.saved_arrays().items()
        arrays |= {f"structure.{name}": one for name, one in own}
    return arrays


def structure_of(triangles: Store, arrays: Arrays, options: StructureOptions) -> Structure:
    """The structure of geometry from `named_arrays`, or built where these have none of it.

    Raises
    ------
    ValueError
        If an array is missing or invalid.
    """
    build = builder_for(options.name, triangles)
    made: Structure = (
        build(triangles, options)
        if triangles.kinds
        else build.from_arrays(triangles, part_of(arrays, "structure"), options)
    )
    return made


def load_structure(
    path: str | PathLike[str], triangles_in: Callable[[str], Any] | None = None
) -> Structure:
    """Read a structure that `save_structure` wrote.

    Parameters
    ----------
    path : str or path
    triangles_in : callable, optional
        If given, the file must contain the triangles that it returns for "float32" or "float64".

    Returns
    -------
    Structure

    Raises
    ------
    FileFormatError
        If the file is damaged, not a structure file, of another version, or of other triangles.
    """
    arrays = read_npz(path)
    made, options, kinds = _header(path, arrays)
    try:
        held: Any = part_of(arrays, "triangles")
        stored: Any = None
        has_shapes = isinstance(kinds, list) and "shapes" in kinds
        if triangles_in is None or not has_shapes:
            stored = store_of(kinds, held)
            held, kinds = stored.saved_arrays(), list(stored.kinds)
        if triangles_in is not None:  # only it has the functions of shapes
            is_double = stored is not None and stored.number_type is np.float64
            given = triangles_in("float64" if is_double else "float32")
            held = {name: one for name, one in held.items() if not name.startswith("masks.")}
            if list(given.kinds) != kinds or not same_arrays(held, given.saved_arrays()):
                raise ValueError("was built from other geometry than the scene's; rebuild it")
            stored = given
        return structure_of(stored, arrays, _options(made, options))
    except ValueError as error:
        raise FileFormatError(path, str(error)) from None


def _header(
    path: str | PathLike[str], arrays: dict[str, NDArray[Any]]
) -> tuple[type[StructureOptions], Any, Any]:
    """The class of the structure's options, the saved options, and the kinds of scene."""
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
    return STRUCTURES[name], header.get("options"), header.get("kinds")


def _options(made: type[StructureOptions], saved: Any) -> StructureOptions:
    try:
        return made.from_json(saved)
    except ValueError as error:  # of a version with other options, or damaged
        raise ValueError(f"{error}; rebuild the structure") from None

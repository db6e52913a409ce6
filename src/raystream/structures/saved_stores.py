"""Geometry as the arrays of a file, with its masks; and from them, checked."""

from __future__ import annotations

import dataclasses
import itertools
import math
import re
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raystream.core.attributes import Attributes
from raystream.core.float64_triangles import Float64Triangles
from raystream.core.height_field import HeightField
from raystream.core.instanced_triangles import InstancedTriangles
from raystream.core.instances import Instances
from raystream.core.masks import ALL_BITS
from raystream.core.primitives import Primitives
from raystream.core.spheres import Spheres
from raystream.core.store import Store
from raystream.core.triangles import MAX_COORDINATE, Triangles
from raystream.structures.saved import take

Arrays = Mapping[str, NDArray[Any]]

#: A scene that is made of a file has as many materials as the largest number says.
_MOST_MATERIALS = 1 << 20


def store_of(kinds: Any, arrays: Arrays) -> Store:
    """The geometry of a scene of some kinds.

    Raises
    ------
    ValueError
        If the kinds are unknown, or an array is missing or invalid.
    """
    if isinstance(kinds, list) and "shapes" in kinds:
        raise ValueError("holds shapes, whose functions are not in files; load it with its scene")
    make = _MAKERS.get(str(kinds[0]) if isinstance(kinds, list) and kinds else "")
    if make is None:
        raise ValueError(f"holds an unknown kind of scene {kinds!r:.40}")
    return _with_masks(make, arrays)


def _with_masks(make: Callable[[Arrays], Store], arrays: Arrays) -> Store:
    made = make(arrays)
    if made.attributes is None:
        made.mesh_masks = _mesh_masks(arrays, made.mesh_splits)
    return made


def arrays_of(store: Store) -> dict[str, NDArray[Any]]:
    """`Store.saved_arrays`; and its masks, where there are any."""
    # An instance's own mask, even of all bits, replaces those of its meshes; 0 is none.
    held = {
        f"masks.{name}": masks
        for name, masks in store.saved_masks().items()
        if (masks != (0 if name == "instances" else ALL_BITS)).any()
    }
    return store.saved_arrays() | held


def same_arrays(arrays: Arrays, others: Arrays) -> bool:
    """Whether two stores hold the same numbers, see `Store.saved_arrays`."""
    return arrays.keys() == others.keys() and all(
        np.array_equal(array, others[name], equal_nan=True) for name, array in arrays.items()
    )


def part_of(arrays: Arrays, name: str) -> dict[str, NDArray[Any]]:
    """The arrays whose names begin with a word, by what follows it."""
    begin = f"{name}."
    return {
        key.removeprefix(begin): array for key, array in arrays.items() if key.startswith(begin)
    }


def _numbered(arrays: Arrays, word: str) -> dict[int, dict[str, NDArray[Any]]]:
    """`part_of` by the number behind a word, all in one go: there may be many."""
    found: dict[int, dict[str, NDArray[Any]]] = {}
    name_of = re.compile(rf"{word}(\d{{1,9}})\.(.*)", re.ASCII | re.DOTALL)
    for key, array in arrays.items():
        parts = name_of.fullmatch(key)
        if parts:
            found.setdefault(int(parts[1]), {})[parts[2]] = array
    return found


def _from_zero(found: dict[int, dict[str, NDArray[Any]]]) -> list[dict[str, NDArray[Any]]]:
    return [found[k] for k in itertools.takewhile(found.__contains__, itertools.count())]


def _masks(arrays: Arrays, name: str, count: int) -> NDArray[np.uint32]:
    """The masks of some parts: all bits if the file has none."""
    if f"masks.{name}" not in arrays:
        return np.full(count, ALL_BITS, np.uint32)
    masks = take(arrays, f"masks.{name}", np.uint32, (count,))
    if not (name == "instances" or masks.all()):
        raise ValueError(f"the masks of {name} have a 0")
    return masks


def _mesh_masks(arrays: Arrays, splits: NDArray[np.int64]) -> NDArray[np.uint32]:
    return _masks(arrays, "meshes", len(splits) - 1)


def _splits(arrays: Arrays, count: int) -> NDArray[np.int64]:
    splits = take(arrays, "mesh_splits", np.int64, (None,))
    is_sound = len(splits) > 0 and splits[0] == 0 and splits[-1] == count
    if not is_sound or (np.diff(splits) < 0).any():
        raise ValueError("the mesh splits do not delimit the triangles")
    return splits


def _triangles(arrays: Arrays) -> Triangles:
    corners = take(arrays, "corners", np.float32, (None, 3, 3))
    splits = take(arrays, "mesh_splits", np.int64, (None,))
    center = take(arrays, "center", np.float64, (3,))
    scale = float(take(arrays, "scale", np.float64, ()))
    if not (scale > 0.0 and math.isfinite(scale) and math.frexp(scale)[0] == 0.5):
        raise ValueError("invalid scale: not a power of two")
    if not np.isfinite(center).all():
        raise ValueError("invalid centre: not finite")
    splits = _splits(arrays, len(corners))
    return Triangles.from_local(corners, splits, center, scale)


def _float64(arrays: Arrays) -> Float64Triangles:
    vertices = take(arrays, "vertices", np.float64, (None, 3))
    faces = take(arrays, "faces", np.int64, (None, 3))
    if not (faces.min(initial=0) >= 0 and faces.max(initial=-1) < len(vertices)):
        raise ValueError("a face has a vertex that does not exist")
    made = Float64Triangles.of([(vertices, faces)])
    made.mesh_splits = _splits(arrays, len(faces))
    return made


def _instances(arrays: Arrays) -> InstancedTriangles:
    objects: list[Store] = []
    for own in _from_zero(objects_of(arrays)):
        kind = "spheres" if "spheres.radii" in own else "float64" if "vertices" in own else ""
        objects.append(_with_masks(_MAKERS[kind], own))
    if len({one.number_type for one in objects}) > 1:  # kernels read blocks of one size
        raise ValueError("holds objects in float32 beside others in float64")
    splits = _splits(arrays, sum(map(len, objects)))
    return InstancedTriangles(objects, instances_of(arrays), splits, Attributes(()))


def objects_of(arrays: Arrays) -> dict[int, dict[str, NDArray[Any]]]:
    """The arrays of each object of `InstancedTriangles.saved_arrays`, with its masks."""
    found = _numbered(arrays, "object")
    for k, masks in _numbered(part_of(arrays, "masks"), "object").items():
        found.setdefault(k, {}).update({f"masks.{name}": one for name, one in masks.items()})
    return found


def instances_of(arrays: Arrays) -> Instances:
    """The instances of `InstancedTriangles.saved_arrays`."""
    ids = take(arrays, "object_ids", np.int32, (None,))
    return Instances(
        ids,
        take(arrays, "transforms", np.float64, (None, 3, 4)),
        take(arrays, "worlds", np.int32, (None,)) if "worlds" in arrays else None,
        masks=_masks(arrays, "instances", len(ids)) if "masks.instances" in arrays else None,
    )


def _primitives(arrays: Arrays) -> Primitives:
    triangles = _triangles(part_of(arrays, "triangles"))
    known = Attributes((), _mesh_masks(arrays, triangles.mesh_splits))
    return Primitives(triangles, *primitives_of(arrays), known)


def primitives_of(arrays: Arrays) -> tuple[list[HeightField], Spheres]:
    """The height fields and spheres of `Primitives.saved_arrays`."""
    fields = [_field(own) for own in _from_zero(_numbered(arrays, "field"))]
    own = part_of(arrays, "spheres")
    spheres = Spheres.of(
        take(own, "centers", np.float64, (None, 3)),
        take(own, "radii", np.float64, (None,)),
        take(own, "material_ids", np.int32, (None,)),
    )
    most = max([spheres.material_ids.max(initial=0), *(one.material_id for one in fields)])
    if most >= _MOST_MATERIALS:
        raise ValueError(f"holds the number of a material beyond {_MOST_MATERIALS:,}")
    spheres = dataclasses.replace(spheres, masks=_masks(arrays, "spheres", len(spheres)))
    for field, mask in zip(fields, _masks(arrays, "fields", len(fields)), strict=True):
        field.mask = int(mask)
    return fields, spheres


def _field(arrays: Arrays) -> HeightField:
    heights = arrays.get("heights", np.zeros(0))
    if heights.ndim != 2 or heights.dtype.kind not in "fiu":
        raise ValueError("the heights of a height field are not numbers in two dimensions")
    x = take(arrays, "x", np.float64, (heights.shape[1],))
    y = take(arrays, "y", np.float64, (heights.shape[0],))
    base, material_id = take(arrays, "base", np.float64, (2,)).tolist()
    for axis in (x, y):
        is_near = bool((np.abs(axis) <= MAX_COORDINATE).all())
        steps = np.diff(axis) if is_near else axis
        if not (is_near and ((steps > 0.0).all() or (steps < 0.0).all())):
            raise ValueError("the samples of a height field are not in order")
    if not (abs(base) <= MAX_COORDINATE and 0 <= material_id < 2**31 and material_id % 1.0 == 0.0):
        raise ValueError("a height field has an invalid base or material")
    return HeightField(heights, x, y, base, int(material_id))


#: By the first kind; those of plain triangles in float32 have none.
_MAKERS: dict[str, Callable[[Arrays], Store]] = {
    "": _triangles,
    "float64": _float64,
    "instances": _instances,
    "spheres": _primitives,
    "fields": _primitives,
}

"""glTF morph targets: weighted displacements of a mesh's vertices."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from raystream.scene.io.gltf_accessors import read_accessor
from raystream.scene.io.gltf_file import GltfFile, Node
from raystream.scene.io.instances import Shape


@dataclass(frozen=True, eq=False)
class MorphTargets:
    """Displacements of a primitive's vertices.

    Attributes
    ----------
    positions, normals : list of ndarray of shape (V, 3), or None
        By target; None where one displaces nothing.
    """

    positions: list[NDArray[np.float32] | None]
    normals: list[NDArray[np.float32] | None]


def morph_target_count(file: GltfFile, mesh: int) -> int:
    """The number of morph targets of a mesh, which all its primitives share."""
    primitives = file.entries(file.entry("meshes", mesh), "primitives")
    counts = {
        len(file.entries(primitive, "targets"))
        for primitive in primitives
        if isinstance(primitive, dict)
    }
    if len(counts) > 1:
        raise file.error(f"is damaged: primitives of mesh {mesh} differ in their morph targets")
    return counts.pop() if counts else 0


def read_morph_targets(
    file: GltfFile, primitive: Node, count: int, has_normals: bool
) -> MorphTargets | None:
    """Read the targets of a primitive with `count` vertices; None if it has none."""
    targets = file.entries(primitive, "targets")
    if not targets:
        return None
    found = MorphTargets([], [])
    for target in targets:
        if not isinstance(target, dict):
            raise file.error("is damaged: a morph target is not an object")
        found.positions.append(_displacements(file, target, "POSITION", count))
        found.normals.append(_displacements(file, target, "NORMAL", count) if has_normals else None)
    return found


def _displacements(
    file: GltfFile, target: Node, name: str, count: int
) -> NDArray[np.float32] | None:
    index = file.index(target, name)
    if index is None:
        return None
    file.spend_numbers(3 * count)
    values = read_accessor(file, index, (3,))
    if len(values) != count:
        raise file.error(f"is damaged: a morph target has {len(values):,} rows for {count:,}")
    return values.astype(np.float32)


def morphed(shape: Shape, targets: MorphTargets, weights: tuple[float, ...]) -> Shape:
    """Displace vertices and normals by the weighted sum of the targets.

    References
    ----------
    Khronos Group, "glTF 2.0 Specification", section 3.7.2.2 (morph targets).
    """
    return Shape(
        _summed(shape.vertices, targets.positions, weights),
        None if shape.normals is None else _summed(shape.normals, targets.normals, weights),
    )


def _summed(
    values: NDArray[np.float64],
    displacements: list[NDArray[np.float32] | None],
    weights: tuple[float, ...],
) -> NDArray[np.float64]:
    total = values.astype(np.float64)
    with np.errstate(all="ignore"):
        for displacement, weight in zip(displacements, weights, strict=True):
            if displacement is not None and weight != 0.0:
                total += weight * displacement
    return total

"""glTF skins: vertices that follow a weighted mean of joints."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raystream.scene.io.gltf_accessors import read_accessor
from raystream.scene.io.gltf_file import GltfFile
from raystream.scene.io.gltf_nodes import Matrix, NodeTree
from raystream.scene.io.instances import Shape

#: Vertices that are moved at once, to bound their matrices' memory.
_BLOCK = 1 << 15


@dataclass(frozen=True, eq=False)
class Skin:
    """The joints of a skin.

    Attributes
    ----------
    places : list of int
        The joints' positions in `NodeTree.nodes`.
    inverses : ndarray of shape (J, 4, 4), float64
        Inverse bind matrices: from the mesh to each joint's own space.
    """

    places: list[int]
    inverses: NDArray[np.float64]

    def matrices(self, world: list[Matrix]) -> NDArray[np.float64]:
        """The matrices of the joints, shape (J, 4, 4), from those of all nodes."""
        with np.errstate(all="ignore"):
            moved: NDArray[np.float64] = np.stack([world[place] for place in self.places])
            return moved @ self.inverses


@dataclass(frozen=True, eq=False)
class Influences:
    """The joints that move each vertex of a primitive.

    Attributes
    ----------
    joints : ndarray of shape (V, K), uint16
        Indices into the skin; 0 where the weight is 0.
    weights : ndarray of shape (V, K), float32
        Their sum is 1 for each vertex; a vertex without weights follows its first joint.
    """

    joints: NDArray[np.uint16]
    weights: NDArray[np.float32]

    @classmethod
    def of(cls, joints: list[NDArray[Any]], weights: list[NDArray[Any]]) -> Influences:
        """From the sets of a file, each of shape (V, 4)."""
        indices = np.concatenate(joints, axis=1).astype(np.uint16)
        shares = np.nan_to_num(np.concatenate(weights, axis=1).astype(np.float32), posinf=0.0)
        shares = np.maximum(shares, 0.0)
        sums = shares.sum(axis=1, dtype=np.float64)
        is_bare = ~(sums > 0.0)
        shares[is_bare, 0], sums[is_bare] = 1.0, 1.0
        shares = (shares / sums[:, None]).astype(np.float32)
        indices[shares == 0.0] = 0
        return cls(indices, shares)


def read_skin(file: GltfFile, index: int, tree: NodeTree) -> Skin | None:
    """Read a skin; None if a joint is not in the file's scene.

    Raises
    ------
    FileFormatError
        If it is damaged.
    """
    entry = file.entry("skins", index)
    joints = file.index_list(entry, "joints")
    if not joints:
        raise file.error(f"is damaged: skin {index} has no joints")
    for joint in joints:
        file.entry("nodes", joint)
    inverses = np.broadcast_to(np.eye(4), (len(joints), 4, 4))
    accessor = file.index(entry, "inverseBindMatrices")
    if accessor is not None:
        columns = read_accessor(file, accessor, (16,)).astype(np.float64)
        if len(columns) < len(joints):
            raise file.error(
                f"is damaged: skin {index} has {len(columns):,} matrices for {len(joints):,} joints"
            )
        inverses = columns[: len(joints)].reshape(-1, 4, 4).transpose(0, 2, 1)
    if not all(joint in tree.places for joint in joints):
        return None
    return Skin([tree.places[joint] for joint in joints], inverses)


def skinned(shape: Shape, influences: Influences, matrices: NDArray[np.float64]) -> Shape:
    """Move vertices and normals by the weighted means of their joints' matrices.

    Parameters
    ----------
    shape : Shape
        In the space of the mesh.
    influences : Influences
        Of joints that exist.
    matrices : ndarray of shape (J, 4, 4), float64
        See `Skin.matrices`.

    Returns
    -------
    Shape
        World space, float64; unit normals.

    References
    ----------
    Khronos Group, "glTF 2.0 Specification", section 3.7.3 (skins).
    """
    vertices = np.empty(shape.vertices.shape)
    normals = None if shape.normals is None else np.empty(vertices.shape)
    with np.errstate(all="ignore"):
        for first in range(0, len(vertices), _BLOCK):
            rows = slice(first, first + _BLOCK)
            joints, weights = influences.joints[rows], influences.weights[rows]
            means = np.zeros((len(joints), 3, 4))
            for k in range(joints.shape[1]):
                means += weights[:, k, None, None] * matrices[joints[:, k], :3]
            points = shape.vertices[rows].astype(np.float64)
            vertices[rows] = np.einsum("vij,vj->vi", means[:, :, :3], points) + means[:, :, 3]
            if normals is not None and shape.normals is not None:
                normals[rows] = _turned(means[:, :, :3], shape.normals[rows].astype(np.float64))
    return Shape(vertices, normals)


def _turned(linear: NDArray[np.float64], normals: NDArray[np.float64]) -> NDArray[np.float64]:
    """Transform normals by the cofactors of each vertex's matrix."""
    a, b, c = linear[:, 0], linear[:, 1], linear[:, 2]
    rows = np.stack([np.cross(b, c), np.cross(c, a), np.cross(a, b)], axis=1)
    side = np.where(np.einsum("vi,vi->v", a, rows[:, 0]) < 0.0, -1.0, 1.0)
    turned = np.einsum("vij,vj->vi", rows, normals) * side[:, None]
    lengths = np.linalg.norm(turned, axis=1)[:, None]
    # NaN stays NaN: a vertex without a normal.
    return np.where(lengths == 0.0, 0.0, turned / lengths)

"""glTF shapes: the mesh of a node, deformed by morph targets and by a skin."""

from __future__ import annotations

import numpy as np

from raystream.scene.io.gltf_file import GltfFile, Node
from raystream.scene.io.gltf_morphs import morph_target_count, morphed
from raystream.scene.io.gltf_nodes import Matrix, NodeTree
from raystream.scene.io.gltf_primitives import FileMesh, Primitive
from raystream.scene.io.gltf_skins import read_skin, skinned
from raystream.scene.io.instances import Shape

_Key = tuple[tuple[float, ...], bytes]


class NodeShape:
    """The shape of a node's mesh, at rest and at times.

    Parameters
    ----------
    file : GltfFile
    node : dict
        With a mesh.
    of_file : FileMesh
    tree : NodeTree

    Attributes
    ----------
    is_unposed : bool
        Whether it has a skin that cannot be applied.

    Raises
    ------
    FileFormatError
        If numbers of weights, joints or matrices do not fit.
    """

    def __init__(self, file: GltfFile, node: Node, of_file: FileMesh, tree: NodeTree) -> None:
        self._of_file = of_file
        mesh = file.integer(node, "mesh")
        count = morph_target_count(file, mesh)
        weights = file.number_list(node, "weights")
        if weights is None:
            weights = file.number_list(file.entry("meshes", mesh), "weights")
        if weights is not None and len(weights) != count:
            raise file.error(
                f"is damaged: {len(weights):,} weights for {count:,} morph targets of mesh {mesh}"
            )
        self._weights = (0.0,) * count if weights is None else weights
        index = file.index(node, "skin")
        self._skin = None if index is None else read_skin(file, index, tree)
        influences = [primitive.influences for primitive in of_file.primitives]
        self.is_unposed = index is not None and (self._skin is None or None in influences)
        if self._skin is not None:
            joint_count = len(self._skin.places)
            for one in influences:
                if one is not None and int(one.joints.max(initial=0)) >= joint_count:
                    raise file.error(f"is damaged: a vertex has a joint beyond {joint_count:,}")
        self._key: _Key | None = None
        self._shape: Shape | None = None

    def at(self, weights: tuple[float, ...] | None, world: list[Matrix]) -> Shape | None:
        """Return the shape; None where nothing deforms it.

        Parameters
        ----------
        weights : tuple of float or None
            Of the morph targets; None for those at rest.
        world : list of ndarray of shape (4, 4)
            The matrices of all nodes.

        Returns
        -------
        Shape or None
            In the space of the mesh or, with a skin, in world space. The same object as the last
            time, if nothing changed.
        """
        weights = self._weights if weights is None else weights
        joints = None if self._skin is None else self._skin.matrices(world)
        key = weights, b"" if joints is None else joints.tobytes()
        if key != self._key:
            self._key = key
            found = [self._deformed(one, weights, joints) for one in self._of_file.primitives]
            is_same = all(is_same for _, is_same in found)
            self._shape = None if is_same else _joined([shape for shape, _ in found])
        return self._shape

    def _deformed(
        self, primitive: Primitive, weights: tuple[float, ...], joints: Matrix | None
    ) -> tuple[Shape, bool]:
        """The shape of a primitive, and whether it is that of the file."""
        mesh, rows = self._of_file.mesh, primitive.rows
        shape = Shape(mesh.vertices[rows], None if mesh.normals is None else mesh.normals[rows])
        is_same = True
        if primitive.targets is not None and any(weights):
            shape, is_same = morphed(shape, primitive.targets, weights), False
        if primitive.influences is not None and joints is not None:
            shape, is_same = skinned(shape, primitive.influences, joints), False
        return shape, is_same


def _joined(shapes: list[Shape]) -> Shape:
    normals = [shape.normals for shape in shapes if shape.normals is not None]
    vertices = np.concatenate([shape.vertices for shape in shapes])
    return Shape(vertices, np.concatenate(normals) if normals else None)

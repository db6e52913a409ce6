"""glTF shapes: the meshes of a node, deformed by morph targets and by a skin."""

from __future__ import annotations

from collections.abc import Sequence

from raystream.scene.io.gltf_file import GltfFile, Node
from raystream.scene.io.gltf_morphs import morph_target_count, morphed
from raystream.scene.io.gltf_nodes import Matrix, NodeTree
from raystream.scene.io.gltf_primitives import Part
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
    parts : sequence of Part
        The mesh's primitives.
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

    def __init__(self, file: GltfFile, node: Node, parts: Sequence[Part], tree: NodeTree) -> None:
        self._parts = parts
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
        influences = [part.influences for part in parts]
        self.is_unposed = index is not None and (self._skin is None or None in influences)
        if self._skin is not None:
            joint_count = len(self._skin.places)
            for one in influences:
                if one is not None and int(one.joints.max(initial=0)) >= joint_count:
                    raise file.error(f"is damaged: a vertex has a joint beyond {joint_count:,}")
        self._key: _Key | None = None
        self._shapes: list[Shape | None] = []

    def at(self, weights: tuple[float, ...] | None, world: list[Matrix]) -> list[Shape | None]:
        """Return the shape of each part; None where nothing deforms it.

        Parameters
        ----------
        weights : tuple of float or None
            Of the morph targets; None for those at rest.
        world : list of ndarray of shape (4, 4)
            The matrices of all nodes.

        Returns
        -------
        list of Shape or None
            In the space of the mesh or, with a skin, in world space. The same objects as the last
            time, if nothing changed.
        """
        weights = self._weights if weights is None else weights
        joints = None if self._skin is None else self._skin.matrices(world)
        key = weights, b"" if joints is None else joints.tobytes()
        if key != self._key:
            self._key = key
            self._shapes = [self._shape(part, weights, joints) for part in self._parts]
        return self._shapes

    @staticmethod
    def _shape(part: Part, weights: tuple[float, ...], joints: Matrix | None) -> Shape | None:
        shape = Shape(part.mesh.vertices, part.mesh.normals)
        is_same = True
        if part.targets is not None and any(weights):
            shape, is_same = morphed(shape, part.targets, weights), False
        if part.influences is not None and joints is not None:
            shape, is_same = skinned(shape, part.influences, joints), False
        return None if is_same else shape

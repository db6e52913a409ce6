"""glTF instances: copies of a node's mesh (``EXT_mesh_gpu_instancing``), and their collector."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from raystream.scene.io.gltf_accessors import normalized, read_accessor
from raystream.scene.io.gltf_file import GltfFile, Node
from raystream.scene.io.gltf_nodes import Matrix
from raystream.scene.io.instances import MAX_INSTANCES
from raystream.scene.io.part_names import number_meshes, number_repeats
from raystream.scene.mesh import Mesh

EXTENSION = "EXT_mesh_gpu_instancing"

#: Most instances of a file: some hundred bytes each.
MAX_PLACED = 1 << 22

#: Attributes of the extension, with the numbers of each copy and their default.
_ATTRIBUTES = {"TRANSLATION": (0.0,) * 3, "ROTATION": (0.0, 0.0, 0.0, 1.0), "SCALE": (1.0,) * 3}


def copies_of(file: GltfFile, node: Node) -> NDArray[np.float64] | None:
    """The matrices of a node's copies to the node, shape (N, 4, 4); None if it has none.

    Raises
    ------
    FileFormatError
        If attributes have different numbers of copies, or other types; or too many.
    """
    extension = file.extension(node, EXTENSION)
    if extension is None:
        return None
    attributes = file.child(extension, "attributes")
    found = {}
    for name, default in _ATTRIBUTES.items():
        index = file.index(attributes, name)
        if index is not None:
            values = read_accessor(file, index, (len(default),))
            found[name] = normalized(values).astype(np.float64)
    counts = {len(values) for values in found.values()}
    if len(counts) > 1:
        raise file.error(f"is damaged: attributes of {EXTENSION} have {sorted(counts)} copies")
    count = counts.pop() if counts else 1
    if count > MAX_INSTANCES:
        raise file.error(f"its {count:,} copies of a mesh are more than {MAX_INSTANCES:,}")
    shift, turn, scale = (
        found.get(name, np.tile(default, (count, 1))) for name, default in _ATTRIBUTES.items()
    )
    matrices = np.tile(np.eye(4), (count, 1, 1))
    with np.errstate(all="ignore"):
        matrices[:, :3, :3] = _rotations(turn) * scale[:, None]
    matrices[:, :3, 3] = shift
    return matrices


def _rotations(quaternions: NDArray[np.float64]) -> NDArray[np.float64]:
    """The matrices of quaternions, shape (N, 3, 3); identity for 0."""
    lengths = np.linalg.norm(quaternions, axis=1, keepdims=True)
    unit = np.where(lengths > 0.0, quaternions / lengths, (0.0, 0.0, 0.0, 1.0))
    x, y, z, w = unit.T
    rows = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)),
        (2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)),
        (2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)),
    )
    return np.moveaxis(np.array(rows), 2, 0)


class MeshInstances:
    """Collects the meshes of a file as objects, and where its nodes have them.

    Attributes
    ----------
    objects : list of Mesh
    object_ids : list of int
    transforms : list of ndarray of shape (3, 4)
    names : list of str
        Of the instances.
    flat_count : int
        Instances left out: their transform flattens them.
    """

    def __init__(self, file: GltfFile) -> None:
        self._file = file
        self.objects: list[Mesh] = []
        self.object_ids: list[int] = []
        self.transforms: list[Matrix] = []
        self.names: list[str] = []
        self.flat_count = 0
        self._known: dict[int, int] = {}

    def add(self, index: int, mesh: Mesh, matrix: Matrix, name: str) -> None:
        """Add an instance of a mesh of the file, by its index."""
        if index not in self._known:
            self._known[index] = len(self.objects)
            self.objects.append(mesh)
        self._place(self._known[index], matrix, name)

    def add_once(self, mesh: Mesh) -> None:
        """Add a mesh that is in world space already, such as one with a skin."""
        self.objects.append(mesh)
        self._place(len(self.objects) - 1, np.eye(4), mesh.name)

    def name_parts(self) -> None:
        """Number the names that repeat, of instances and of objects."""
        self.names = number_repeats(self.names)
        number_meshes(self.objects)

    def _place(self, object_id: int, matrix: Matrix, name: str) -> None:
        with np.errstate(all="ignore"):
            largest = np.abs(matrix[:3, :3]).max()
            determinant = np.linalg.det(matrix[:3, :3] / largest) if largest > 0.0 else 0.0
        if not (np.isfinite(matrix).all() and determinant != 0.0):
            self.flat_count += 1
            return
        if len(self.object_ids) == MAX_PLACED:
            raise self._file.error(f"has more than {MAX_PLACED:,} instances")
        self.object_ids.append(object_id)
        self.transforms.append(matrix[:3])
        self.names.append(name)

"""glTF primitives: triangles, their attributes, and what deforms them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raystream.core.attributes import Attributes
from raystream.scene.io.gltf_accessors import read_accessor
from raystream.scene.io.gltf_draco import DracoMesh
from raystream.scene.io.gltf_file import GltfFile, Node
from raystream.scene.io.gltf_materials import uses_alpha
from raystream.scene.io.gltf_morphs import MorphTargets, morph_target_count, read_morph_targets
from raystream.scene.io.gltf_skins import Influences
from raystream.scene.io.gltf_texcoords import Texcoords
from raystream.scene.io.instances import TriangleBudget
from raystream.scene.io.partial import IndexCheck
from raystream.scene.mesh import Mesh

_TRIANGLES, _STRIP, _FAN = 4, 5, 6

#: Of one vertex, in sets of four: more is a mistake.
_MAX_INFLUENCE_SETS = 8


@dataclass(frozen=True, eq=False)
class Primitive:
    """What deforms the vertices of a primitive.

    Attributes
    ----------
    rows : slice
        Its vertices in `FileMesh.mesh`.
    targets : MorphTargets or None
    influences : Influences or None
        Of the joints of a skin.
    """

    rows: slice
    targets: MorphTargets | None
    influences: Influences | None


@dataclass(frozen=True, eq=False)
class FileMesh:
    """A mesh of the file in its own space, its primitives one after another.

    Attributes
    ----------
    mesh : Mesh
        Vertices of primitives that lack an attribute which others have: NaN as normal and texture
        coordinate, white.
    primitives : list of Primitive
    """

    mesh: Mesh
    primitives: list[Primitive]


class PrimitiveReader:
    """Reads the meshes of a file.

    Parameters
    ----------
    file : GltfFile
    texcoords : sequence of Texcoords
        By material, the default one last.
    """

    def __init__(self, file: GltfFile, texcoords: Sequence[Texcoords]) -> None:
        self._file = file
        self._texcoords = texcoords
        self._budget = TriangleBudget(file.path)
        self.checks = IndexCheck(file.path)

    def mesh(self, index: int) -> FileMesh:
        """Read those primitives of a mesh that have triangles."""
        file = self._file
        entry = file.entry("meshes", index)
        morph_target_count(file, index)
        meshes: list[Mesh] = []
        primitives: list[Primitive] = []
        count, begin = 0, self.checks.triangle_count
        for primitive in file.entries(entry, "primitives"):
            if not isinstance(primitive, dict):
                raise file.error(f"is damaged: mesh {index} has an invalid primitive")
            mode = file.integer(primitive, "mode", _TRIANGLES)
            if mode in (_TRIANGLES, _STRIP, _FAN):
                face_count = self.checks.triangle_count - begin
                found = self._primitive(primitive, mode, count, face_count)
                if found is not None and found[0].triangle_count:
                    meshes.append(found[0])
                    primitives.append(found[1])
                    count += len(found[0].vertices)
        joined = _joined(meshes)
        joined.name = file.name(entry)
        return FileMesh(joined, primitives)

    def _primitive(
        self, primitive: Node, mode: int, first: int, first_face: int
    ) -> tuple[Mesh, Primitive] | None:
        """Read a primitive whose vertices come after `first` others; None without positions."""
        file = self._file
        arrays = _Attributes(file, primitive)
        vertices = arrays.get("POSITION", (3,))
        if vertices is None:
            return None
        default = len(self._texcoords) - 1
        material = file.index(primitive, "material")
        if material is not None and material >= default:
            raise file.error(f"is damaged: materials has no entry {material}")
        material = default if material is None else material
        place = self._texcoords[material]
        texcoords = arrays.get(f"TEXCOORD_{place.number}", (2,))
        colors = arrays.get("COLOR_0", (3, 4))
        order = arrays.order()
        faces = _triangles(order, mode)
        good = self.checks.usable(faces, len(vertices))
        mesh = Mesh(
            vertices.astype(np.float32),
            faces[good],
            face_ids=first_face + np.flatnonzero(good),
            normals=arrays.get("NORMAL", (3,)),
            colors=None if colors is None else self._colors(colors, material),
            texcoords=None if texcoords is None else place.apply(texcoords),
            material_ids=material,
        )
        self._budget.spend(mesh)
        targets = read_morph_targets(file, primitive, len(vertices), mesh.normals is not None)
        rows = slice(first, first + len(vertices))
        return mesh, Primitive(rows, targets, arrays.influences())

    def _colors(self, colors: NDArray[Any], material: int) -> NDArray[Any]:
        """``COLOR_0``; without its alpha where that is 1, or not used by the material."""
        colors = np.clip(np.nan_to_num(colors), 0.0, 1.0)
        is_default = material == len(self._texcoords) - 1
        if colors.shape[1] == 3 or is_default or (colors[:, 3] == 1.0).all():
            return colors[:, :3]
        return colors if uses_alpha(self._file.entry("materials", material)) else colors[:, :3]


def _joined(meshes: Sequence[Mesh]) -> Mesh:
    """Join primitives in their order: a solid of several materials is one closed surface."""
    if len(meshes) == 1:
        return meshes[0]
    tables = Attributes(meshes)
    return Mesh(
        np.concatenate([np.zeros((0, 3), np.float32), *(mesh.vertices for mesh in meshes)]),
        tables.faces,
        normals=tables.normals,
        colors=tables.colors,
        texcoords=tables.texcoords,
        material_ids=tables.material_ids,
        face_ids=tables.face_ids,
    )


class _Attributes:
    """The attributes of a primitive, in accessors or compressed."""

    def __init__(self, file: GltfFile, primitive: Node) -> None:
        self._file = file
        self._primitive = primitive
        self._accessors = file.child(primitive, "attributes")
        extension = file.extension(primitive, "KHR_draco_mesh_compression")
        self._draco = None if extension is None else DracoMesh(file, primitive, extension)
        self._count: int | None = None

    def get(self, name: str, widths: tuple[int, ...]) -> NDArray[Any] | None:
        """Read an attribute; None if there is none. The first one's count is that of all."""
        file = self._file
        index = file.index(self._accessors, name)
        if index is None:
            return None
        values = None if self._draco is None else self._draco.attribute(name)
        if values is None:
            values = read_accessor(file, index, widths)
        if values.shape[1] not in widths:
            raise file.error(f"is damaged: {name} has {values.shape[1]} numbers per vertex")
        if self._count is not None and len(values) != self._count:
            raise file.error(f"is damaged: {name} has {len(values):,} rows for {self._count:,}")
        self._count = len(values)
        return values

    def order(self) -> NDArray[np.int64]:
        """The indices of vertices, in the order of corners."""
        if self._draco is not None:
            return self._draco.faces.ravel()
        index = self._file.index(self._primitive, "indices")
        if index is None:
            return np.arange(self._count or 0, dtype=np.int64)
        corners = read_accessor(self._file, index, (1,))[:, 0]
        if corners.dtype.kind != "u":
            raise self._file.error("is damaged: indices are not unsigned numbers")
        return corners.astype(np.int64)

    def influences(self) -> Influences | None:
        """The joints of the vertices and their weights; None if there are none."""
        joints, weights = [], []
        for k in range(_MAX_INFLUENCE_SETS):
            self._file.spend_numbers(8 * (self._count or 0) * (f"JOINTS_{k}" in self._accessors))
            of_joints = self.get(f"JOINTS_{k}", (4,))
            of_weights = self.get(f"WEIGHTS_{k}", (4,))
            if of_joints is None or of_weights is None:
                break
            if of_joints.dtype.kind != "u" or of_joints.dtype.itemsize > 2:
                raise self._file.error(
                    "is damaged: joints are not unsigned numbers of 1 or 2 bytes"
                )
            joints.append(of_joints)
            weights.append(of_weights)
        return Influences.of(joints, weights) if joints else None


def _triangles(order: NDArray[np.int64], mode: int) -> NDArray[np.int64]:
    """Cut a list of corners into triangles; every other one of a strip is flipped."""
    if mode == _TRIANGLES:
        return order[: len(order) // 3 * 3].reshape(-1, 3)
    if len(order) < 3:
        return np.empty((0, 3), np.int64)
    if mode == _FAN:
        first = np.full(len(order) - 2, order[0])
        return np.stack([first, order[1:-1], order[2:]], axis=1)
    faces = np.stack([order[:-2], order[1:-1], order[2:]], axis=1)
    faces[1::2] = faces[1::2][:, [0, 2, 1]]
    return faces

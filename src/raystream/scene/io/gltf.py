"""glTF: nodes, meshes, cameras and lights of glTF 2.0 files, text and binary."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raystream.scene.animation import Animation
from raystream.scene.io.gltf_accessors import read_accessor
from raystream.scene.io.gltf_animation import read_animations
from raystream.scene.io.gltf_cameras import read_cameras
from raystream.scene.io.gltf_file import GltfFile, Node
from raystream.scene.io.gltf_materials import read_materials, texcoord_set
from raystream.scene.io.gltf_nodes import Matrix, NodeTree
from raystream.scene.io.instances import Placements, TriangleBudget
from raystream.scene.io.partial import IndexCheck, warn_partial
from raystream.scene.lights import DirectionalLight, Light, PointLight
from raystream.scene.material import Material
from raystream.scene.mesh import Mesh
from raystream.scene.scene import Scene

__all__ = ["read_gltf"]

_TRIANGLES, _STRIP, _FAN = 4, 5, 6


def read_gltf(path: Path) -> Scene:
    """Read a glTF 2.0 file in its rest pose.

    Each primitive of each node with a mesh becomes one mesh in world space: nodes depth first,
    in file order. Points and lines are skipped, morph targets are not applied, and skinned
    meshes stay in their bind pose.

    Parameters
    ----------
    path : Path
        A ``.gltf`` or ``.glb`` file.

    Returns
    -------
    Scene
        The camera is the first of its `Scene.cameras`; their aspect is that of the image, not
        of the file. Intensities of ``KHR_lights_punctual`` in candela and lux are used as
        linear numbers; spot lights become point lights. The animation has all motion of
        nodes, in seconds.

    Raises
    ------
    FileFormatError
        If the file is damaged or truncated, or needs something that is missing.

    Warns
    -----
    RaystreamWarning
        For triangles and images that were skipped, and for unsupported animation: of skins, of
        morph targets, and several animations of one property.
    """
    file = GltfFile(path)
    materials = read_materials(file)
    tracks = read_animations(file)
    tree = NodeTree(file, tracks)
    reader = _SceneReader(file, len(materials) - 1)
    reader.build(tree, None)
    reader.report()
    times = tracks.times if tree.moves and tracks.times[0] < tracks.times[1] else None
    poses = _Poses(reader, tree, tuple(materials))
    return Scene(
        reader.meshes,
        materials=materials,
        lights=reader.lights,
        cameras=read_cameras(file, tree, times),
        animation=None if times is None else Animation(poses, times),
        name=path.name,
    )


@dataclass
class _Poses:
    """Builds the scene at any time; unchanged parts are shared."""

    reader: _SceneReader
    tree: NodeTree
    materials: tuple[Material, ...]

    def __call__(self, time: float) -> Scene:
        self.reader.build(self.tree, time)
        return Scene(self.reader.meshes, materials=self.materials, lights=self.reader.lights)


@dataclass
class _SceneReader:
    """Collects the meshes and lights of the nodes."""

    file: GltfFile
    default_material: int
    meshes: list[Mesh] = field(default_factory=list)
    lights: list[Light] = field(default_factory=list)
    spot_count: int = 0
    unplaced_count: int = 0
    skin_count: int = 0

    def __post_init__(self) -> None:
        self._read: dict[int, list[Mesh]] = {}
        self.checks = IndexCheck(self.file.path)
        self._read_budget = TriangleBudget(self.file.path)
        self._placements = Placements()

    def build(self, tree: NodeTree, time: float | None) -> None:
        """Collect the meshes and lights of all nodes, at a time or at rest."""
        self.meshes, self.lights = [], []
        self.spot_count = self.unplaced_count = self.skin_count = 0
        self._placed_budget = TriangleBudget(self.file.path)
        self._placements.begin()
        for node, matrix in zip(tree.nodes, tree.matrices(time), strict=True):
            self._add(node, matrix)
        if not self.file.entries(self.file.root, "nodes"):
            for index in range(len(self.file.entries(self.file.root, "meshes"))):
                self._add({"mesh": index}, np.eye(4))

    def report(self) -> None:
        """Warn about unsupported features."""
        path = self.file.path
        self.checks.report()
        if self.unplaced_count:
            warn_partial(
                path,
                f"{self.unplaced_count:,} nodes with EXT_mesh_gpu_instancing have one copy each",
            )
        if self.spot_count:
            warn_partial(path, f"{self.spot_count:,} spot lights treated as point lights")
        if self.skin_count:
            warn_partial(path, f"{self.skin_count:,} skinned meshes left in their bind pose")

    def _add(self, node: Node, matrix: Matrix) -> None:
        """Add a node's mesh and light."""
        mesh = self.file.index(node, "mesh")
        if mesh is not None:
            self.unplaced_count += self.file.extension(node, "EXT_mesh_gpu_instancing") is not None
            self.skin_count += "skin" in node
            if mesh not in self._read:
                self._read[mesh] = self._mesh(mesh)
            for part in self._read[mesh]:
                self._placed_budget.spend(part)
                place = np.eye(4) if "skin" in node else matrix
                self.meshes.append(self._placements.place(part, place))
        punctual = self.file.extension(node, "KHR_lights_punctual")
        if punctual is not None:
            self._light(self.file.integer(punctual, "light"), matrix)

    def _mesh(self, index: int) -> list[Mesh]:
        entry = self.file.entry("meshes", index)
        parts = []
        for primitive in self.file.entries(entry, "primitives"):
            if not isinstance(primitive, dict):
                raise self.file.error(f"is damaged: mesh {index} has an invalid primitive")
            mode = self.file.integer(primitive, "mode", _TRIANGLES)
            if mode in (_TRIANGLES, _STRIP, _FAN):
                part = self._primitive(primitive, mode, str(entry.get("name", "")))
                self._read_budget.spend(part)
                parts += [part] if part.triangle_count else []
        return parts

    def _primitive(self, primitive: Node, mode: int, name: str) -> Mesh:
        file = self.file
        if file.extension(primitive, "KHR_draco_mesh_compression") is not None:
            raise file.error("is compressed with Draco, which is not supported")
        attributes = file.child(primitive, "attributes")
        vertices = self._attribute(attributes, "POSITION", (3,), None)
        if vertices is None:
            return Mesh(np.empty((0, 3)), np.empty((0, 3), np.int32))
        count = len(vertices)
        material = file.index(primitive, "material")
        if material is not None and material >= self.default_material:
            raise file.error(f"is damaged: materials has no entry {material}")
        coordinates = f"TEXCOORD_{texcoord_set(file, material)}"
        faces = self._faces(primitive, mode, count)
        texcoords = self._attribute(attributes, coordinates, (2,), count)
        if texcoords is not None:
            texcoords = np.stack([texcoords[:, 0], 1.0 - texcoords[:, 1]], axis=1)
        colors = self._attribute(attributes, "COLOR_0", (3, 4), count)
        return Mesh(
            vertices.astype(np.float32),
            faces,
            normals=self._attribute(attributes, "NORMAL", (3,), count),
            colors=None if colors is None else np.clip(np.nan_to_num(colors[:, :3]), 0.0, 1.0),
            texcoords=texcoords,
            material_ids=self.default_material if material is None else material,
            name=name,
        )

    def _attribute(
        self, attributes: Node, name: str, widths: tuple[int, ...], count: int | None
    ) -> NDArray[Any] | None:
        index = self.file.index(attributes, name)
        if index is None:
            return None
        values = read_accessor(self.file, index, widths)
        if count is not None and len(values) != count:
            raise self.file.error(f"is damaged: {name} has {len(values):,} rows for {count:,}")
        return values

    def _faces(self, primitive: Node, mode: int, count: int) -> NDArray[np.int64]:
        index = self.file.index(primitive, "indices")
        if index is None:
            order = np.arange(count, dtype=np.int64)
        else:
            corners = read_accessor(self.file, index, (1,))[:, 0]
            if corners.dtype.kind != "u":
                raise self.file.error("is damaged: indices are not unsigned numbers")
            order = corners.astype(np.int64)
        faces = _triangles(order, mode)
        return faces[self.checks.usable(faces, count)]

    def _light(self, index: int, matrix: Matrix) -> None:
        file = self.file
        extension = file.extension(file.root, "KHR_lights_punctual") or {}
        lights = file.entries(extension, "lights")
        if index >= len(lights) or not isinstance(lights[index], dict):
            raise file.error(f"is damaged: light {index} does not exist")
        light = lights[index]
        color = file.numbers(light, "color", (1.0, 1.0, 1.0))
        strength = file.number(light, "intensity", 1.0)
        red, green, blue = (max(0.0, c * strength) for c in color)
        forward = -matrix[:3, 2]
        if not np.isfinite(matrix).all() or not all(map(math.isfinite, (red, green, blue))):
            raise file.error(f"is damaged: light {index} is not finite")
        if light.get("type") == "directional":
            if forward.any():
                x, y, z = forward.tolist()
                self.lights.append(DirectionalLight((x, y, z), (red, green, blue)))
            return
        self.spot_count += light.get("type") == "spot"
        x, y, z = matrix[:3, 3].tolist()
        self.lights.append(PointLight((x, y, z), (red, green, blue)))


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

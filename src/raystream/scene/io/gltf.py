"""glTF: nodes, meshes, cameras and lights of glTF 2.0 files, text and binary."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raystream.core.errors import FileFormatError
from raystream.scene.camera import Camera
from raystream.scene.io.gltf_accessors import read_accessor
from raystream.scene.io.gltf_file import GltfFile, Node
from raystream.scene.io.gltf_materials import read_materials, texcoord_set
from raystream.scene.io.instances import TriangleBudget, placed
from raystream.scene.io.partial import IndexCheck, warn_partial
from raystream.scene.lights import DirectionalLight, Light, PointLight
from raystream.scene.mesh import Mesh
from raystream.scene.scene import Scene

__all__ = ["read_gltf"]

_TRIANGLES, _STRIP, _FAN = 4, 5, 6

Matrix = NDArray[np.float64]


def read_gltf(path: Path) -> Scene:
    """Read a glTF 2.0 file in its rest pose.

    Each primitive of each node that has a mesh becomes one mesh in world space: nodes depth
    first, in the order of the file. Points and lines are left out, animations and morph
    targets are not applied, and skinned meshes stay as modelled.

    Parameters
    ----------
    path : Path
        A ``.gltf`` or ``.glb`` file.

    Returns
    -------
    Scene
        The camera is the first one; the picture's shape, not the file, says how wide it is.
        Of ``KHR_lights_punctual`` candela and lux are taken as linear numbers; a spot light
        shines in all directions.

    Raises
    ------
    FileFormatError
        If the file is damaged, truncated, or needs what is not there.

    Warns
    -----
    RaystreamWarning
        For triangles and images that had to be left out.
    """
    file = GltfFile(path)
    materials = read_materials(file)
    reader = _SceneReader(file, len(materials) - 1)
    for index, matrix in _nodes(file):
        reader.add(file.entry("nodes", index), matrix)
    if not file.entries(file.root, "nodes"):
        for index in range(len(file.entries(file.root, "meshes"))):
            reader.add({"mesh": index}, np.eye(4))
    reader.checks.report()
    if reader.unplaced_count:
        warn_partial(
            path, f"{reader.unplaced_count:,} nodes with EXT_mesh_gpu_instancing show one copy each"
        )
    if reader.spot_count:
        warn_partial(path, f"{reader.spot_count:,} spot lights shine in all directions")
    return Scene(
        reader.meshes,
        materials=materials,
        lights=reader.lights,
        camera=reader.camera,
        name=path.name,
    )


def _nodes(file: GltfFile) -> Iterator[tuple[int, Matrix]]:
    """Walk the nodes of the scene depth first, each with its matrix to world space."""
    seen: set[int] = set()
    stack = [(root, np.eye(4)) for root in reversed(_roots(file))]
    while stack:
        index, parent = stack.pop()
        if index in seen:
            raise file.error(f"is damaged: node {index} occurs twice in the tree of nodes")
        seen.add(index)
        node = file.entry("nodes", index)
        with np.errstate(all="ignore"):
            matrix = parent @ _local_matrix(file, node)
        yield index, matrix
        children = _indices(file, node, "children")
        stack += [(child, matrix) for child in reversed(children)]


def _indices(file: GltfFile, parent: Node, key: str) -> list[int]:
    return [file.integer({key: value}, key) for value in file.entries(parent, key)]


def _roots(file: GltfFile) -> list[int]:
    if file.entries(file.root, "scenes"):
        scene = file.entry("scenes", file.integer(file.root, "scene", 0))
        return _indices(file, scene, "nodes")
    count = len(file.entries(file.root, "nodes"))
    children = {c for i in range(count) for c in _indices(file, file.entry("nodes", i), "children")}
    return [index for index in range(count) if index not in children]


def _local_matrix(file: GltfFile, node: Node) -> Matrix:
    if "matrix" in node:
        columns = file.numbers(node, "matrix", (0.0,) * 16)
        matrix = np.array(columns).reshape(4, 4).T
        matrix[3] = 0.0, 0.0, 0.0, 1.0
        return matrix
    x, y, z, w = file.numbers(node, "rotation", (0.0, 0.0, 0.0, 1.0))
    scale = file.numbers(node, "scale", (1.0, 1.0, 1.0))
    matrix = np.eye(4)
    matrix[:3, :3] = _rotation(x, y, z, w) * np.array(scale)
    matrix[:3, 3] = file.numbers(node, "translation", (0.0, 0.0, 0.0))
    return matrix


def _rotation(x: float, y: float, z: float, w: float) -> Matrix:
    """Turn a quaternion, of any length but zero, into a matrix."""
    length = math.hypot(x, y, z, w)
    if not length > 0.0:
        return np.eye(3)
    x, y, z, w = x / length, y / length, z / length, w / length
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


@dataclass
class _SceneReader:
    """Collects what the nodes hold."""

    file: GltfFile
    default_material: int
    meshes: list[Mesh] = field(default_factory=list)
    lights: list[Light] = field(default_factory=list)
    camera: Camera | None = None
    spot_count: int = 0
    unplaced_count: int = 0

    def __post_init__(self) -> None:
        self._read: dict[int, list[Mesh]] = {}
        self.checks = IndexCheck(self.file.path)
        self._read_budget = TriangleBudget(self.file.path)
        self._placed_budget = TriangleBudget(self.file.path)

    def add(self, node: Node, matrix: Matrix) -> None:
        """Add a node's mesh, camera and light."""
        mesh = self.file.index(node, "mesh")
        if mesh is not None:
            self.unplaced_count += self.file.extension(node, "EXT_mesh_gpu_instancing") is not None
            if mesh not in self._read:
                self._read[mesh] = self._mesh(mesh)
            for part in self._read[mesh]:
                self._placed_budget.spend(part)
                self.meshes.append(placed(part, np.eye(4) if "skin" in node else matrix))
        camera = self.file.index(node, "camera")
        if camera is not None and self.camera is None:
            self.camera = _camera(self.file, camera, matrix)
        punctual = self.file.extension(node, "KHR_lights_punctual")
        if punctual is not None:
            self._light(self.file.integer(punctual, "light"), matrix)

    def _mesh(self, index: int) -> list[Mesh]:
        entry = self.file.entry("meshes", index)
        parts = []
        for primitive in self.file.entries(entry, "primitives"):
            if not isinstance(primitive, dict):
                raise self.file.error(f"is damaged: mesh {index} has a primitive that is none")
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
            raise file.error(f"is damaged: materials has no number {material}")
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
            raise file.error(f"is damaged: there is no light number {index}")
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
    """Cut a list of corners into triangles; of strips every other one is turned."""
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


def _camera(file: GltfFile, index: int, matrix: Matrix) -> Camera | None:
    """Read a camera, which looks along its own -z with y up; None for unknown types."""
    entry = file.entry("cameras", index)
    lens: dict[str, Any]
    if entry.get("type") == "perspective":
        lens = {"fov": math.degrees(file.number(file.child(entry, "perspective"), "yfov", 0.7))}
    elif entry.get("type") == "orthographic":
        # ymag is half of the height; a node's scale does not count for cameras.
        half = file.number(file.child(entry, "orthographic"), "ymag", 0.0)
        lens = {"projection": "orthographic", "height": 2.0 * abs(half)}
    else:
        return None
    eye = matrix[:3, 3]
    forward = -matrix[:3, 2]
    with np.errstate(all="ignore"):
        look_at = eye + forward / np.linalg.norm(forward)
    try:
        with np.errstate(all="ignore"):
            return Camera(tuple(eye), tuple(look_at), tuple(matrix[:3, 1]), **lens)
    except ValueError as error:
        raise FileFormatError(file.path, f"its camera makes no sense ({error})") from None

"""glTF: nodes, meshes, cameras and lights of glTF 2.0 files, text and binary."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from raystream.scene.animation import Animation
from raystream.scene.io.gltf_animation import read_animations
from raystream.scene.io.gltf_cameras import read_cameras
from raystream.scene.io.gltf_extensions import lost_extensions
from raystream.scene.io.gltf_file import GltfFile, Node
from raystream.scene.io.gltf_instancing import MeshInstances, copies_of
from raystream.scene.io.gltf_lights import read_light
from raystream.scene.io.gltf_materials import read_materials
from raystream.scene.io.gltf_nodes import Matrix, NodeTree
from raystream.scene.io.gltf_primitives import FileMesh, PrimitiveReader
from raystream.scene.io.gltf_shapes import NodeShape
from raystream.scene.io.gltf_texcoords import Texcoords
from raystream.scene.io.instances import Placements, Shape, TriangleBudget
from raystream.scene.io.part_names import number_meshes
from raystream.scene.io.partial import warn_partial
from raystream.scene.io.text import shown
from raystream.scene.lights import Light
from raystream.scene.material import Material
from raystream.scene.mesh import Mesh
from raystream.scene.scene import Scene


def read_gltf(path: Path, *, time: float | None = None, has_instances: bool = False) -> Scene:
    """Read a glTF 2.0 file in its rest pose.

    Each node with a mesh becomes one mesh in world space, with all of its primitives: nodes depth
    first, in file order, with morph targets and skins applied. Points and lines are skipped. Names
    are those of the node and its ancestors, as in ``truck/axle/wheel``; see `number_repeats`.

    Parameters
    ----------
    path : Path
        A ``.gltf`` or ``.glb`` file.
    time : float, optional
        With instances: the pose [default: the rest pose].
    has_instances : bool
        Make a scene of instances: of each mesh of the file that is not deformed, one for each
        node, and one for each of its copies by ``EXT_mesh_gpu_instancing``. It is not animated. An
        object has the mesh's name, an instance that of the node.

    Returns
    -------
    Scene
        The camera is the first of its `Scene.cameras`; their aspect is that of the image, not
        of the file. Candela, lux and emission are used as linear numbers. The animation has all
        motion of nodes, joints and morph targets, in seconds.

    Raises
    ------
    FileFormatError
        If the file is damaged or truncated, or needs something that is missing.

    Warns
    -----
    RaystreamWarning
        For extensions, triangles, textures and images that were skipped, and for animations: of
        several of one property only the first is read.
    """
    file = GltfFile(path)
    materials, texcoords = read_materials(file)
    tracks = read_animations(file)
    tree = NodeTree(file, tracks)
    reader = _SceneReader(file, tree, texcoords, MeshInstances(file) if has_instances else None)
    reader.build(time if has_instances else None)
    reader.report()
    reader.name_parts()
    if reader.instances is not None:
        return Scene.instances(
            reader.instances.objects,
            np.array(reader.instances.transforms).reshape(-1, 3, 4),
            np.array(reader.instances.object_ids, int),
            names=reader.instances.names,
            materials=materials,
            lights=reader.lights,
            cameras=read_cameras(file, tree, None),
            name=path.name,
        )
    times = tracks.times if tree.moves and tracks.times[0] < tracks.times[1] else None
    poses = _Poses(reader, tuple(materials))
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
    materials: tuple[Material, ...]

    def __call__(self, time: float) -> Scene:
        self.reader.build(time)
        return Scene(self.reader.meshes, materials=self.materials, lights=self.reader.lights)


class _SceneReader:
    """Collects the meshes and lights of the nodes."""

    def __init__(
        self,
        file: GltfFile,
        tree: NodeTree,
        texcoords: Sequence[Texcoords],
        instances: MeshInstances | None = None,
    ) -> None:
        self.file, self.instances = file, instances
        self.meshes: list[Mesh] = []
        self.lights: list[Light] = []
        self._tree = tree
        self._primitives = PrimitiveReader(file, texcoords)
        self._of_file: dict[int, FileMesh] = {}
        self._shapes: dict[int, NodeShape] = {}
        self._copies: dict[int, NDArray[np.float64] | None] = {}
        self._placements = Placements()

    def build(self, time: float | None) -> None:
        """Collect the meshes and lights of all nodes, at a time or at rest."""
        file, tree = self.file, self._tree
        self.meshes, self.lights = [], []
        self._budget = TriangleBudget(file.path)
        self._placements.begin()
        world = tree.matrices(time)
        for place, node in enumerate(tree.nodes):
            self._add(node, place, time, world)
        if not file.entries(file.root, "nodes"):
            for index in range(len(file.entries(file.root, "meshes"))):
                self._place(index, np.eye(4), None, self._mesh(index).mesh.name)

    def name_parts(self) -> None:
        """Number the names that repeat, once: meshes of later times keep them."""
        if self.instances is not None:
            self.instances.name_parts()
            return
        number_meshes(self.meshes)

    def report(self) -> None:
        """Warn about unsupported features."""
        path = self.file.path
        self._primitives.checks.report()
        lost = lost_extensions(self.file.extensions_used())
        if lost:
            names = ", ".join(shown(name.encode()) for name in lost[:8])
            warn_partial(path, f"unsupported extensions ignored: {names}")
        if self.instances is not None and self.instances.flat_count:
            count = self.instances.flat_count
            warn_partial(path, f"{count:,} instances left out, since their transforms flatten them")
        unposed = sum(shape.is_unposed for shape in self._shapes.values())
        if unposed:
            warn_partial(path, f"{unposed:,} skinned meshes left in their bind pose")

    def _add(self, node: Node, place: int, time: float | None, world: list[Matrix]) -> None:
        """Add a node's mesh and light."""
        file, tree = self.file, self._tree
        mesh = file.index(node, "mesh")
        if mesh is not None:
            if place not in self._shapes:
                self._shapes[place] = NodeShape(file, node, self._mesh(mesh), tree)
            matrix = np.eye(4) if "skin" in node else world[place]
            deformed = self._shapes[place].at(tree.weights(place, time), world)
            if place not in self._copies:
                self._copies[place] = None if "skin" in node else copies_of(file, node)
            copies = self._copies[place]
            for copy in np.eye(4)[None] if copies is None else copies:
                self._place(mesh, matrix @ copy, deformed, tree.paths[place])
        punctual = file.extension(node, "KHR_lights_punctual")
        if punctual is not None:
            light = read_light(file, file.integer(punctual, "light"), world[place])
            self.lights += [] if light is None else [light]

    def _mesh(self, index: int) -> FileMesh:
        if index not in self._of_file:
            self._of_file[index] = self._primitives.mesh(index)
        return self._of_file[index]

    def _place(self, index: int, matrix: Matrix, shape: Shape | None, name: str) -> None:
        """Add a mesh of the file, deformed, once."""
        mesh = self._mesh(index).mesh
        if mesh.triangle_count == 0:
            return
        if self.instances is not None and shape is None:
            self.instances.add(index, mesh, matrix, name)
            return
        self._budget.spend(mesh)
        found = self._placements.place(mesh, matrix, name=name, shape=shape)
        if self.instances is None:
            self.meshes.append(found)
        else:
            self.instances.add_once(found)

"""glTF nodes: transforms of the node tree, at rest or at a time."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from raystream.scene.io.gltf_animation import NodeTracks
from raystream.scene.io.gltf_file import GltfFile, Node
from raystream.scene.io.part_names import path_name
from raystream.scene.key_tracks import KeyTrack
from raystream.scene.splines import unit_quaternion_matrix

Matrix = NDArray[np.float64]


class NodeTree:
    """The nodes of a file's scene, depth first, parents before children.

    Parameters
    ----------
    file : GltfFile
    tracks : NodeTracks

    Attributes
    ----------
    nodes : list of dict
        The JSON objects.
    paths : list of str
        Names of each node and its ancestors; a node without a name has that of its mesh.
    places : dict of int to int
        Position in `nodes` by index in the file.

    Raises
    ------
    FileFormatError
        If a node occurs twice, or has invalid numbers.
    """

    def __init__(self, file: GltfFile, tracks: NodeTracks) -> None:
        self.nodes: list[Node] = []
        self.paths: list[str] = []
        self.places: dict[int, int] = {}
        self._parents: list[int | None] = []
        self._locals: list[_Local] = []
        self._weights: dict[int, KeyTrack] = {}
        stack: list[tuple[int, int | None]] = [(root, None) for root in reversed(_roots(file))]
        while stack:
            index, parent = stack.pop()
            if index in self.places:
                raise file.error(f"is damaged: node {index} occurs twice in the tree of nodes")
            node = file.entry("nodes", index)
            place = self.places[index] = len(self.nodes)
            self.nodes.append(node)
            self._parents.append(parent)
            above = "" if parent is None else self.paths[parent]
            self.paths.append(path_name(above, _name(file, node)))
            moves = dict(tracks.of.get(index, {}))
            if "weights" in moves:
                self._weights[place] = moves.pop("weights")
            self._locals.append(_Local(file, node, moves))
            children = file.index_list(node, "children")
            stack += [(child, place) for child in reversed(children)]

    @property
    def moves(self) -> bool:
        """Whether any node or its shape is animated."""
        return bool(self._weights) or any(local.tracks for local in self._locals)

    def weights(self, place: int, time: float | None) -> tuple[float, ...] | None:
        """Return the animated weights of a node's morph targets; None for those at rest."""
        track = self._weights.get(place)
        return None if track is None or time is None else tuple(track.at(time).tolist())

    def matrices(self, time: float | None) -> list[Matrix]:
        """Return the matrix of each node to world space, shape (4, 4); at rest without a time."""
        found: list[Matrix] = []
        with np.errstate(all="ignore"):
            for parent, local in zip(self._parents, self._locals, strict=True):
                matrix = local.matrix(time)
                found.append(matrix if parent is None else found[parent] @ matrix)
        return found

    def path_to(self, place: int) -> list[int]:
        """Return a node and its ancestors, up to the root."""
        path = [place]
        while (parent := self._parents[path[-1]]) is not None:
            path.append(parent)
        return path

    def matrix(self, place: int, time: float | None) -> Matrix:
        """Return the matrix of one node to world space."""
        first, *others = reversed(self.path_to(place))
        with np.errstate(all="ignore"):
            matrix = self._locals[first].matrix(time)
            for other in others:
                matrix = matrix @ self._locals[other].matrix(time)
        return matrix

    def moving(self, place: int) -> bool:
        """Whether a node or one of its ancestors is animated."""
        return any(self._locals[one].tracks for one in self.path_to(place))


class _Local:
    """The transform of a node to its parent."""

    def __init__(self, file: GltfFile, node: Node, tracks: dict[str, KeyTrack]) -> None:
        self.tracks = tracks
        self._parts = {
            "translation": np.array(file.numbers(node, "translation", (0.0, 0.0, 0.0))),
            "rotation": np.array(file.numbers(node, "rotation", (0.0, 0.0, 0.0, 1.0))),
            "scale": np.array(file.numbers(node, "scale", (1.0, 1.0, 1.0))),
        }
        if "matrix" in node:
            columns = file.numbers(node, "matrix", (0.0,) * 16)
            self._still = np.array(columns).reshape(4, 4).T
            self._still[3] = 0.0, 0.0, 0.0, 1.0
        else:
            self._still = _composed(self._parts)

    def matrix(self, time: float | None) -> Matrix:
        if time is None or not self.tracks:
            return self._still
        moved = {name: track.at(time) for name, track in self.tracks.items()}
        return _composed({**self._parts, **moved})


def _composed(parts: dict[str, NDArray[np.float64]]) -> Matrix:
    """Compose scale, then rotation, then translation."""
    matrix = np.eye(4)
    with np.errstate(all="ignore"):
        matrix[:3, :3] = _rotation(*parts["rotation"].tolist()) * parts["scale"]
    matrix[:3, 3] = parts["translation"]
    return matrix


def _rotation(x: float, y: float, z: float, w: float) -> Matrix:
    """Return the matrix of a quaternion; identity if it is zero."""
    length = math.hypot(x, y, z, w)
    if not length > 0.0:
        return np.eye(3)
    return unit_quaternion_matrix(w / length, x / length, y / length, z / length)


def _roots(file: GltfFile) -> list[int]:
    if file.entries(file.root, "scenes"):
        scene = file.entry("scenes", file.integer(file.root, "scene", 0))
        return file.index_list(scene, "nodes")
    count = len(file.entries(file.root, "nodes"))
    nodes = [file.entry("nodes", index) for index in range(count)]
    children = {child for node in nodes for child in file.index_list(node, "children")}
    return [index for index in range(count) if index not in children]


def _name(file: GltfFile, node: Node) -> str:
    mesh = file.index(node, "mesh")
    return file.name(node) or ("" if mesh is None else file.name(file.entry("meshes", mesh)))

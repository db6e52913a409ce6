"""glTF cameras: views from nodes, which may be animated."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from raystream.core.checks import check_finite
from raystream.core.errors import FileFormatError
from raystream.scene.camera import Camera
from raystream.scene.camera_track import CameraMotion
from raystream.scene.io.gltf_file import GltfFile, Node
from raystream.scene.io.gltf_nodes import Matrix, NodeTree


@dataclass(frozen=True, eq=False)
class NodeCamera:
    """A camera on an animated node: it looks along the node's -z with y up.

    Attributes
    ----------
    still : Camera
        In the rest pose.
    times : (float, float)
        Start and end of the motion.
    """

    still: Camera
    times: tuple[float, float]
    _path: Path = field(repr=False)
    _tree: NodeTree = field(repr=False)
    _place: int = field(repr=False)
    _lens: dict[str, Any] = field(repr=False)

    def at(self, time: float) -> Camera:
        """The camera at a time; ValueError if that is not finite."""
        check_finite("time", time)
        return _view(self._path, self._tree.matrix(self._place, time), self._lens)


def read_cameras(
    file: GltfFile, tree: NodeTree, times: tuple[float, float] | None
) -> dict[str, Camera | CameraMotion]:
    """Read the cameras of all nodes.

    Parameters
    ----------
    file : GltfFile
    tree : NodeTree
    times : (float, float) or None
        Of the animation, if there is one.

    Returns
    -------
    dict
        By the node's name, else the camera's; repeated names get a number. In the order of
        the nodes. Their aspect is that of the image, not of the file.

    Raises
    ------
    FileFormatError
        If one is invalid.
    """
    found: dict[str, Camera | CameraMotion] = {}
    for place, node in enumerate(tree.nodes):
        index = file.index(node, "camera")
        if index is None:
            continue
        entry = file.entry("cameras", index)
        lens = _lens(file, entry)
        if lens is None:
            continue
        still = _view(file.path, tree.matrix(place, None), lens)
        name = _name(node, entry, found)
        if times is not None and tree.moving(place):
            found[name] = NodeCamera(still, times, file.path, tree, place, lens)
        else:
            found[name] = still
    return found


def _lens(file: GltfFile, entry: Node) -> dict[str, Any] | None:
    """Return the projection of a camera; None for unknown types."""
    if entry.get("type") == "perspective":
        return {"fov": math.degrees(file.number(file.child(entry, "perspective"), "yfov", 0.7))}
    if entry.get("type") == "orthographic":
        # ymag is half the height; a node's scale does not apply to cameras.
        half = file.number(file.child(entry, "orthographic"), "ymag", 0.0)
        return {"projection": "orthographic", "height": 2.0 * abs(half)}
    return None


def _view(path: Path, matrix: Matrix, lens: dict[str, Any]) -> Camera:
    eye = matrix[:3, 3]
    forward = -matrix[:3, 2]
    try:
        with np.errstate(all="ignore"):
            look_at = eye + forward / np.linalg.norm(forward)
            return Camera(tuple(eye), tuple(look_at), tuple(matrix[:3, 1]), **lens)
    except ValueError as error:
        raise FileFormatError(path, f"invalid camera ({error})") from None


def _name(node: Node, entry: Node, taken: dict[str, Any]) -> str:
    names = [source.get("name") for source in (node, entry)]
    name = next((n for n in names if isinstance(n, str) and n.strip()), "camera").strip()
    if name not in taken:
        return name
    number = len(taken) + 1  # differs from all given so far, unless a file has such names
    while f"{name} {number}" in taken:
        number += 1
    return f"{name} {number}"

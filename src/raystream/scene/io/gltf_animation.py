"""glTF animations: keyframed motion of nodes, and of their shapes."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from raystream.scene.io.gltf_accessors import read_accessor
from raystream.scene.io.gltf_file import GltfFile, Node
from raystream.scene.io.gltf_morphs import morph_target_count
from raystream.scene.io.partial import warn_partial
from raystream.scene.io.text import shown
from raystream.scene.key_tracks import KeyTrack

#: Maximum numbers in the keys of a file; samplers may share a buffer, but are stored separately.
MAX_KEY_NUMBERS = 1 << 24

_WIDTHS = {"translation": 3, "rotation": 4, "scale": 3}
_METHODS = {"LINEAR": "linear", "STEP": "step", "CUBICSPLINE": "cubic"}


@dataclass
class NodeTracks:
    """Motion of nodes.

    Attributes
    ----------
    of : dict of int to dict of str to KeyTrack
        By node and property: ``"translation"``, ``"rotation"`` (quaternions x, y, z,
        w), ``"scale"``, ``"weights"`` of morph targets.
    """

    of: dict[int, dict[str, KeyTrack]] = field(default_factory=dict)

    @property
    def times(self) -> tuple[float, float]:
        """From 0, or an earlier key, to the last of all keys."""
        all_times = [track.times for tracks in self.of.values() for track in tracks.values()]
        return (
            min(0.0, *(float(times[0]) for times in all_times)),
            max(float(times[-1]) for times in all_times),
        )


def read_animations(file: GltfFile) -> NodeTracks:
    """Read the animations of a file, to be played together.

    An animation of properties that an earlier one animates is an alternative to it, not a part
    of it, and is skipped.

    Parameters
    ----------
    file : GltfFile

    Returns
    -------
    NodeTracks

    Raises
    ------
    FileFormatError
        If one is damaged.

    Warns
    -----
    RaystreamWarning
        For skipped animations, and for those of missing morph targets and of nodes with a matrix,
        which the format does not allow.
    """
    reader = _Reader(file)
    animations = file.entries(file.root, "animations")
    left_out = sum(not reader.add(animation) for animation in animations)
    if left_out:
        warn_partial(
            file.path,
            f"skipped {left_out} of {len(animations)} animations: an earlier one animates the "
            "same properties",
        )
    for count, what in (
        (reader.morph_count, "animations of morph targets that do not exist"),
        (reader.matrix_count, "animations of nodes with a matrix"),
        (reader.unknown_count, "animations of unsupported properties"),
    ):
        if count:
            warn_partial(file.path, f"skipped: {count:,} {what}")
    return reader.tracks


class _Reader:
    def __init__(self, file: GltfFile) -> None:
        self.file = file
        self.tracks = NodeTracks()
        self.morph_count = self.matrix_count = self.unknown_count = 0
        self._number_count = 0

    def add(self, animation: Node) -> bool:
        """Add an animation's tracks, unless an earlier one animates any of the same properties."""
        file = self.file
        if not isinstance(animation, dict):
            raise file.error("is damaged: an animation is not an object")
        samplers = file.entries(animation, "samplers")
        wanted: dict[tuple[int, str], int] = {}
        for channel in file.entries(animation, "channels"):
            if not isinstance(channel, dict):
                raise file.error("is damaged: a channel is not an object")
            place = self._place(file.child(channel, "target"))
            if place is not None:
                sampler = file.integer(channel, "sampler")
                if sampler >= len(samplers) or not isinstance(samplers[sampler], dict):
                    raise file.error(f"is damaged: sampler {sampler} does not exist")
                wanted[place] = sampler
        if any(path in self.tracks.of.get(node, {}) for node, path in wanted):
            return False
        read: dict[tuple[int, str, int], KeyTrack] = {}
        for (node, path), sampler in wanted.items():
            width = _WIDTHS[path] if path in _WIDTHS else self._target_count(node)
            key = (sampler, path, width)
            if key not in read:
                read[key] = self._track(samplers[sampler], path, width)
            self.tracks.of.setdefault(node, {})[path] = read[key]
        return True

    def _target_count(self, node: int) -> int:
        """The number of morph targets of a node's mesh."""
        mesh = self.file.index(self.file.entry("nodes", node), "mesh")
        return 0 if mesh is None else morph_target_count(self.file, mesh)

    def _place(self, target: Node) -> tuple[int, str] | None:
        """Return the node and its property; None, and counted, if unsupported."""
        node = self.file.index(target, "node")
        path = target.get("path")
        if path == "weights" and node is not None:
            if self._target_count(node):
                return node, path
            self.morph_count += 1
        elif node is None or not isinstance(path, str) or path not in _WIDTHS:
            self.unknown_count += 1
        elif "matrix" in self.file.entry("nodes", node):
            self.matrix_count += 1
        else:
            return node, path
        return None

    def _track(self, sampler: Node, path: str, width: int) -> KeyTrack:
        file = self.file
        kind = sampler.get("interpolation", "LINEAR")
        method = _METHODS.get(kind, "") if isinstance(kind, str) else ""
        if not method:
            raise file.error(f"is damaged: unknown interpolation {shown(str(kind).encode())}")
        times = self._read(sampler, "input", 1)[:, 0]
        values = self._read(sampler, "output", _WIDTHS.get(path, 1))
        if path == "weights":
            values = values[: len(values) // width * width].reshape(-1, width)
        rows_per_key = 3 if method == "cubic" else 1
        if len(times) == 0 or len(values) != rows_per_key * len(times):
            raise file.error(
                f"is damaged: an animation has {len(times):,} times and {len(values):,} values"
            )
        if not (np.isfinite(times).all() and np.isfinite(values).all()):
            raise file.error("is damaged: an animation has keys that are not finite")
        if (np.diff(times) < 0.0).any():
            raise file.error("is damaged: the times of an animation decrease")
        if method == "cubic":
            arriving, points, leaving = values.reshape(len(times), 3, -1).transpose(1, 0, 2)
            return KeyTrack(times, points, method, path == "rotation", arriving, leaving)
        if path == "rotation":
            values = _unit(values)
        return KeyTrack(times, values, method, path == "rotation")

    def _read(self, sampler: Node, key: str, width: int) -> NDArray[np.float64]:
        file = self.file
        index = file.integer(sampler, key)
        self._number_count += width * file.integer(file.entry("accessors", index), "count")
        if self._number_count > MAX_KEY_NUMBERS:
            raise file.error(f"its animations have more than {MAX_KEY_NUMBERS:,} numbers")
        return read_accessor(file, index, (width,)).astype(np.float64)


def _unit(quaternions: NDArray[np.float64]) -> NDArray[np.float64]:
    """Normalise quaternions; zeros become the identity."""
    lengths = np.linalg.norm(quaternions, axis=1)[:, None]
    still = np.array([0.0, 0.0, 0.0, 1.0])
    return np.where(lengths > 0.0, quaternions / np.where(lengths > 0.0, lengths, 1.0), still)

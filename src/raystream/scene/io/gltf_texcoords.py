"""glTF texture coordinates: the set and the transform of a material's textures.

A mesh has one pair of coordinates per vertex. It is what the material's textures agree on: their
set with their transform (``KHR_texture_transform``) applied. Textures of the same set with another
transform are looked up by the difference, see `Texture.transform`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from raystream.scene.io.gltf_file import GltfFile, Node
from raystream.scene.texture import Affine

#: From v downward, as in files, to v upward, and back.
_FLIP = np.array([[1.0, 0.0, 0.0], [0.0, -1.0, 1.0], [0.0, 0.0, 1.0]])

#: Coefficients of at most this size keep coordinates of usual size finite in float32.
_MOST = 1e30


@dataclass(frozen=True, eq=False)
class Texcoords:
    """Where coordinates of textures come from.

    Attributes
    ----------
    number : int
        The set: 0 for ``TEXCOORD_0``.
    matrix : ndarray of shape (3, 3), float64
        Of (u, v, 1), with v downward.
    """

    number: int
    matrix: NDArray[np.float64]

    @classmethod
    def of(cls, file: GltfFile, use: Node) -> Texcoords:
        """The coordinates of a material's ``...Texture`` entry.

        Notes
        -----
        Scale, then counterclockwise rotation as seen in the image, where v points down, then
        offset [1]_. The extension's listing in GLSL rotates the other way; its text, its example,
        and other readers do it as here [2]_.

        References
        ----------
        .. [1] Khronos Group, ``KHR_texture_transform``.
        .. [2] https://github.com/KhronosGroup/glTF/issues/1563
        """
        number = file.integer(use, "texCoord", 0)
        transform = file.extension(use, "KHR_texture_transform")
        if transform is None:
            return cls(number, np.eye(3))
        number = file.integer(transform, "texCoord", number)
        angle = file.number(transform, "rotation", 0.0)
        across, down = file.numbers(transform, "scale", (1.0, 1.0))
        x, y = file.numbers(transform, "offset", (0.0, 0.0))
        if max(map(abs, (across, down, x, y))) > _MOST:
            raise file.error("is damaged: a texture transform has huge numbers")
        cosine, sine = math.cos(angle), math.sin(angle)
        matrix = [
            [cosine * across, sine * down, x],
            [-sine * across, cosine * down, y],
            [0.0, 0.0, 1.0],
        ]
        return cls(number, np.array(matrix))

    def apply(self, texcoords: NDArray[np.floating]) -> NDArray[np.float64]:
        """Map a set as in the file, shape (V, 2), to coordinates of a mesh, with v upward."""
        matrix = _FLIP @ self.matrix
        with np.errstate(all="ignore"):
            result: NDArray[np.float64] = texcoords @ matrix[:2, :2].T + matrix[:2, 2]
        return result

    def seen_from(self, mesh: Texcoords) -> Affine | None:
        """The transform from a mesh's coordinates to these, with v upward; None if they agree."""
        if np.array_equal(self.matrix, mesh.matrix):
            return None
        matrix = _FLIP @ self.matrix @ np.linalg.inv(mesh.matrix) @ _FLIP
        a, b, c, d, e, f = np.clip(matrix[:2], -_MOST, _MOST).ravel().tolist()
        return a, b, c, d, e, f


def shared_texcoords(uses: Mapping[str, Texcoords]) -> Texcoords:
    """Choose the coordinates of a material's meshes.

    The set is that of the base colour, or else of the first texture. The transform is that of the
    normal map, since tangents follow it, or else of the first texture. It is invertible.

    Parameters
    ----------
    uses : mapping of str to Texcoords
        By role, see `Material`; the most important first.
    """
    if not uses:
        return Texcoords(0, np.eye(3))
    first = next(iter(uses.values()))
    normal = uses.get("normal", uses.get("clearcoat_normal", first))
    chosen = normal if normal.number == first.number else first
    if not np.linalg.cond(chosen.matrix) < 1e12:
        return Texcoords(first.number, np.eye(3))
    return chosen

"""Partial files: warnings about unusable parts, and errors if nothing is usable."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raystream.core.errors import FileFormatError, RaystreamWarning
from raystream.scene.scene import Scene


def warn_partial(path: Path, reason: str) -> None:
    """Issue one `RaystreamWarning` that names the file and what was skipped."""
    warnings.warn(f"{path}: {reason}", RaystreamWarning, stacklevel=2)


def listed(names: Sequence[str]) -> str:
    """The first five of some names, and how many more there are."""
    first = ", ".join(repr(name[:60]) for name in names[:5])
    return f"{first} and {len(names) - 5} more" if len(names) > 5 else first


def warn_crossed(path: Path, count: int) -> None:
    """Warn about polygons that could not be cut into triangles as they should, if there are any."""
    if count:
        warn_partial(
            path,
            f"{count:,} polygons became triangle fans, which may cover more than the polygons: "
            "their outlines cross themselves, or have too many corners",
        )


class IndexCheck:
    """Finds triangles with vertex indices out of range, over a whole file.

    `crossed_count` counts polygons whose outlines cross themselves; see `cut_polygons`.

    Parameters
    ----------
    path : Path
        The file, for the messages.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.triangle_count = 0
        self.bad_count = 0
        self.crossed_count = 0

    def usable(self, faces: NDArray[Any], vertex_count: int) -> NDArray[np.bool_]:
        """Find the triangles whose vertex indices are in range.

        Parameters
        ----------
        faces : ndarray of shape (F, 3), integer
            Vertex indices, any value.
        vertex_count : int
            Indices 0 .. vertex_count - 1 exist.

        Returns
        -------
        ndarray of shape (F,), bool
        """
        inside = (faces >= 0) & (faces < vertex_count)
        good = inside[:, 0] & inside[:, 1] & inside[:, 2]
        self.triangle_count += len(faces)
        self.bad_count += len(faces) - int(np.count_nonzero(good))
        return good

    def report(self) -> None:
        """Warn once about triangles out of range, and once about polygons.

        Raises
        ------
        FileFormatError
            If there were triangles and none is usable.
        """
        warn_crossed(self.path, self.crossed_count)
        if self.bad_count == 0:
            return
        reason = f"{self.bad_count:,} triangles refer to vertices that do not exist"
        if self.bad_count == self.triangle_count:
            raise FileFormatError(self.path, f"all {reason}")
        warn_partial(self.path, f"dropped: {reason}")


def faces_in_range(path: Path, faces: NDArray[Any], vertex_count: int) -> NDArray[np.bool_]:
    """Check the triangles of a file that has one mesh; see `IndexCheck`."""
    check = IndexCheck(path)
    good = check.usable(faces, vertex_count)
    check.report()
    return good


def check_loaded(path: Path, scene: Scene) -> Scene:
    """Warn about a scene without triangles, and about triangles that can never be hit.

    Parameters
    ----------
    path : Path
        The file, for the messages.
    scene : Scene
        The scene of the file.

    Returns
    -------
    Scene
        The same scene.
    """
    if scene.triangle_count == 0:
        warn_partial(path, "holds no triangles")
    triangles = scene.triangles
    parts = []
    if triangles.degenerate_count:
        parts.append(f"{triangles.degenerate_count:,} without area")
    if triangles.nonfinite_count:
        parts.append(f"{triangles.nonfinite_count:,} with a non-finite vertex")
    if parts:
        warn_partial(path, f"triangles that can never be hit: {', '.join(parts)}")
    return scene

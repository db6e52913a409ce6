"""Picking: the hits along the ray of a pixel."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.core.hits import MultiHits
from raystream.scene.camera import Camera
from raystream.scene.scene import Scene
from raystream.tracer import Tracer
from raystream.viewer.messages import Message, finite_or_none, read_integer, read_number

#: Maximum hits reported in detail; the total counts all.
MAX_ROWS = 1000

_MAX_INTEGER = 1 << 53  # largest exact integer in JavaScript
_MAX_NAME_LENGTH = 200


class PixelRay(NamedTuple):
    """The ray through the centre of a pixel.

    Attributes
    ----------
    number : int
        Number of the message that requested it.
    origin : ndarray of shape (3,), float64
    direction : ndarray of shape (3,), float32
        Unit length.
    """

    number: int
    origin: NDArray[np.float64]
    direction: NDArray[np.float32]

    def message(self) -> Message:
        """Describe the ray for the page."""
        return {
            "type": "hits",
            "number": self.number,
            "origin": self.origin.tolist(),
            "direction": self.direction.tolist(),
        }


def pixel_ray(message: Mapping[str, Any], camera: Camera, size: tuple[int, int]) -> PixelRay:
    """Return the ray requested by a message.

    Parameters
    ----------
    message : mapping
        With ``number``, and ``x`` and ``y`` from 0 to 1, across and down the image.
    camera : Camera
    size : (int, int)
        Image width and height in pixels.

    Raises
    ------
    MessageError
        If the message is invalid.
    """
    number = read_integer(message, "number", 0, _MAX_INTEGER)
    x, y = (read_number(message, name, 0.0, 1.0) for name in ("x", "y"))
    width, height = size
    column, row = min(int(x * width), width - 1), min(int(y * height), height - 1)
    origin, direction = camera.rays(width, height, column + 0.5, row + 0.5)
    return PixelRay(number, np.array(origin), direction)


def hits_along(tracer: Tracer, ray: PixelRay) -> Message:
    """Find all hits of a ray by increasing distance, the first `MAX_ROWS` in detail.

    Returns
    -------
    dict
        ``hits`` and ``total``.
    """
    origin, direction = ray.origin[None], ray.direction[None]
    total = int(tracer.count_hits(origin, direction)[0])
    found = tracer.multi_hit(origin, direction, max_hits=MAX_ROWS)
    return {"hits": _rows(tracer.scene, found), "total": total}


def _rows(scene: Scene, found: MultiHits) -> list[Message]:
    columns = zip(
        found.t.tolist(),
        found.prim_id.tolist(),
        found.mesh_id.tolist(),
        found.instance_id.tolist(),
        found.material_id.tolist(),
        found.positions.tolist(),
        found.normals.tolist(),
        strict=True,
    )
    rows = []
    names = None if scene.placements is None else scene.placements.names
    for t, prim_id, mesh_id, instance_id, material_id, position, normal in columns:
        rows.append(
            {
                "t": finite_or_none(t),
                "prim_id": prim_id,
                "mesh_id": mesh_id,
                "mesh": (names[instance_id] if names else scene.mesh_name(mesh_id))[
                    :_MAX_NAME_LENGTH
                ],
                "material": scene.materials[material_id].name[:_MAX_NAME_LENGTH],
                "position": [finite_or_none(part) for part in position],
                "normal": [finite_or_none(part) for part in normal],
            }
        )
    return rows

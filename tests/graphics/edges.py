"""Distances of pixel centres from the edges of triangles in an image."""

from __future__ import annotations

import math

import numpy as np


def edge_distance(scene, camera, size, prim_ids, rows, columns):
    """Distance from pixels' centres to the nearest edge of a triangle each, in pixels.

    Corners must be ahead of the eye. A negative prim_id is infinitely far.
    """
    width, height = size
    corners = scene.triangles.to_world(scene.triangles.corners[prim_ids])
    x, y, z = np.moveaxis((corners - camera.eye) @ camera.basis().T, -1, 0)
    scale = 2.0 * math.tan(math.radians(camera.fov) / 2.0) / height
    ends = np.stack([x / z / scale + 0.5 * width, 0.5 * height - y / z / scale], axis=-1)
    ends -= np.stack([columns + 0.5, rows + 0.5], axis=-1)[:, None]
    along = np.roll(ends, -1, axis=1) - ends
    length = np.maximum(np.einsum("nkc,nkc->nk", along, along), 1e-30)
    part = np.clip(-np.einsum("nkc,nkc->nk", ends, along) / length, 0.0, 1.0)
    nearest = np.linalg.norm(ends + part[..., None] * along, axis=-1).min(axis=1)
    return np.where(prim_ids < 0, np.inf, nearest)

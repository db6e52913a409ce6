"""Projections: from points of an image to vectors from the eye.

Each takes points ``across`` to the right and ``down`` from the image's centre, arrays that
broadcast to a shape S, and the rows right, up, forward of a camera's basis.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

PROJECTIONS = ("perspective", "orthographic", "equirectangular")


def ahead(across: Array, down: Array, basis: Array) -> Array:
    """Vectors from the eye to points of the plane one unit ahead: perspective.

    Parameters
    ----------
    across, down : ndarray
        In units of that plane.
    basis : ndarray of shape (3, 3), float64

    Returns
    -------
    ndarray of shape S + (3,), float64
        Their component along forward is 1.
    """
    right, up, forward = basis
    return (across[..., None] * right + forward) - down[..., None] * up


def beside(across: Array, down: Array, basis: Array) -> Array:
    """Vectors from the eye to points of the plane through it: orthographic.

    Parameters
    ----------
    across, down : ndarray
        In world units.
    basis : ndarray of shape (3, 3), float64

    Returns
    -------
    ndarray of shape S + (3,), float64
        Their component along forward is 0.
    """
    right, up, _ = basis
    return across[..., None] * right - down[..., None] * up


def around(across: Array, down: Array, basis: Array) -> Array:
    """Directions by longitude and latitude: equirectangular.

    Parameters
    ----------
    across, down : ndarray
        Radians: to the right of forward in the plane of right and forward, and below it.
    basis : ndarray of shape (3, 3), float64

    Returns
    -------
    ndarray of shape S + (3,), float64
        Unit length.
    """
    right, up, forward = basis
    level = np.sin(across)[..., None] * right + np.cos(across)[..., None] * forward
    return np.cos(down)[..., None] * level - np.sin(down)[..., None] * up

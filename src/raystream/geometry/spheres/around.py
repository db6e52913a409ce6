"""How many spheres points are in."""

from __future__ import annotations

import math

from raystream.jit.cpu import kernel


@kernel
def count_around(begin, end, points, centers, radii, numbers):
    """Add the spheres around points begin to end to their winding numbers.

    Parameters
    ----------
    begin, end : int
    points : ndarray of shape (N, 3), float64
    centers : ndarray of shape (S, 3), float64
    radii : ndarray of shape (S,), float64
    numbers : ndarray of shape (N,), float64
        Added to: 1 for each sphere around the point, 1/2 where it is on it.
    """
    for i in range(begin, end):
        total = 0.0
        for k in range(len(radii)):
            x = points[i, 0] - centers[k, 0]
            y = points[i, 1] - centers[k, 1]
            z = points[i, 2] - centers[k, 2]
            length = math.sqrt(x * x + y * y + z * z)
            if length < radii[k]:
                total += 1.0
            elif length == radii[k]:
                total += 0.5
        numbers[i] += total

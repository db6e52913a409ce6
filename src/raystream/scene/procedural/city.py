"""City: towers of plain boxes along an avenue."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from raystream.scene.procedural.parts import Part, merge
from raystream.scene.procedural.shapes import boxes

STRIPE, STONE, CURB, GLASS = 1, 2, 3, 4

#: Distance of neighbouring towers, and half the width of the avenue, metres.
PITCH, AVENUE = 36.0, 26.0

TINTS = np.array([[0.82, 0.74, 0.62], [0.6, 0.6, 0.62], [0.72, 0.5, 0.38], [0.9, 0.88, 0.84]])


def city(count: int, generator: np.random.Generator) -> Part:
    """Make a city of `count` boxes along an avenue in z.

    Parameters
    ----------
    count : int
        Number of boxes: two in five are the bases of towers, the rest are their upper
        storeys, curbs, and stripes on the road.
    generator : numpy.random.Generator

    Returns
    -------
    Part
        12 count triangles; each box is closed.
    """
    stripe_count = min(60, count // 8)
    tower_count = max(1, (count - stripe_count) * 2 // 5)
    tier_count = count - stripe_count - tower_count
    towers = _towers(tower_count, tier_count, generator)
    return merge([_stripes(stripe_count), towers]) if stripe_count else towers


def _stripes(count: int) -> Part:
    """A dashed line along the avenue, and a curb on either side."""
    curb_count = 2 if count > 2 else 0
    start = 8.0 - 6.0 * np.arange(count - curb_count)
    width = np.full(len(start), 0.12)
    lows = np.stack([3.6 - width, np.full(len(start), 0.001), start - 2.5], axis=1)
    highs = np.stack([3.6 + width, np.full(len(start), 0.012), start], axis=1)
    ids = np.full(len(start), STRIPE)
    if curb_count:
        side = np.array([-1.0, 1.0])
        curb_low = np.stack([side * 19.0 - 6.0, [0.0, 0.0], [-2000.0, -2000.0]], axis=1)
        curb_high = np.stack([side * 19.0 + 6.0, [0.16, 0.16], [60.0, 60.0]], axis=1)
        lows, highs = np.concatenate([lows, curb_low]), np.concatenate([highs, curb_high])
        ids = np.concatenate([ids, [CURB, CURB]])
    return boxes(lows, highs, ids)


def _towers(count: int, tier_count: int, generator: np.random.Generator) -> Part:
    center = _lots(count)
    half = generator.uniform(9.0, 15.0, (count, 2))
    away = np.hypot(center[:, 0], center[:, 1])
    height = 8.0 + np.minimum(0.45 * away, 90.0) * generator.uniform(0.15, 1.0, count)
    height[np.hypot(center[:, 0], center[:, 1] + 420.0) < 170.0] *= 2.2  # downtown
    tint = TINTS[generator.integers(0, len(TINTS), count)] * generator.uniform(0.8, 1.0, (count, 1))
    glass = generator.random(count) < 0.3

    # Upper tiers are added to the nearest towers first, one each, then a second one.
    tower = np.arange(count + tier_count) % count
    tier = np.arange(count + tier_count) // count
    shrink = 0.78**tier
    bottom = height[tower] * np.where(tier > 0, 2.0 - 0.62 ** (tier - 1.0), 0.0)
    top = height[tower] * (2.0 - 0.62**tier)
    lows = np.empty((len(tower), 3))
    highs = np.empty((len(tower), 3))
    lows[:, [0, 2]] = center[tower] - half[tower] * shrink[:, None]
    highs[:, [0, 2]] = center[tower] + half[tower] * shrink[:, None]
    lows[:, 1], highs[:, 1] = bottom, top
    part = boxes(lows, highs, np.where(glass[tower], GLASS, STONE))
    colors = np.where(glass[tower, None], 1.0, tint[tower])
    return replace(part, colors=np.repeat(colors, 8, axis=0).astype(np.float32))


def _lots(count: int) -> NDArray[np.float64]:
    """Return the `count` lots nearest to a point ahead, off the avenue; nearest first."""
    side = int(np.ceil(np.sqrt(count))) + 2
    column = np.arange(-side, side) + 0.5
    x = np.sign(column) * (AVENUE + 15.0 + PITCH * (np.abs(column) - 0.5))
    z = 40.0 - PITCH * np.arange(2 * side)
    lots = np.stack(np.meshgrid(x, z), axis=-1).reshape(-1, 2)
    distance = np.hypot(2.0 * lots[:, 0], lots[:, 1] - 10.0)
    return lots[np.argsort(distance, kind="stable")[:count]]

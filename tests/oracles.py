"""Independent answers in float64: another formula, no code of raystream, and explicit doubt.

For every ray and triangle it says *surely a hit*, *surely none*, or *in doubt*: the ray passes
an edge, or the interval ends, closer than float32 tracing can be expected to tell.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

#: Rounding of float32 coordinates and of the test, in units of the scene's size: the test's
#: own bound is about 12 * 2**-24, and the rounding of vertices and origins comes on top.
TOLERANCE = 48 * 2.0**-24


@dataclass
class Verdict:
    """For N rays and F triangles: t where the line meets the plane, sure hits, and doubts."""

    t: np.ndarray
    t_error: np.ndarray
    sure: np.ndarray
    doubt: np.ndarray


def judge(vertices, faces, origins, directions, t_min, t_max) -> Verdict:
    """Judge all pairs; arrays of shape (V, 3), (F, 3), (N, 3), (N, 3), (N,), (N,)."""
    corners = np.asarray(vertices, np.float64)[faces]
    o = np.asarray(origins, np.float64)[:, None]
    d = np.asarray(directions, np.float64)[:, None]
    length = np.linalg.norm(d, axis=-1)
    center = (corners.min(axis=(0, 1)) + corners.max(axis=(0, 1))) / 2
    size = np.abs(corners - center).max()
    # Scenes within 16 of their sizes of the origin are not recentred, and origins within
    # some sizes are not advanced.
    moved = np.abs(center).max() > 16 * 2 * size
    scene_reach = 2 * size if moved else np.abs(corners).max()
    reach = np.minimum(np.abs(o - (center if moved else 0)).max(axis=-1), 8 * scene_reach)
    tolerance = TOLERANCE * (scene_reach + reach)

    a, b, c = (corners[None, :, k] - o for k in range(3))
    unit = d / length[..., None]
    # Distance of the ray's line from each edge's line, positive inside, by triple products.
    gaps = []
    normal = np.cross(b - a, c - a)
    facing = np.sign(np.einsum("nfk,nfk->nf", normal, np.broadcast_to(unit, normal.shape)))
    for p, q in ((a, b), (b, c), (c, a)):
        across = np.cross(q - p, unit)
        width = np.linalg.norm(across, axis=-1)
        volume = np.einsum("nfk,nfk->nf", np.cross(p, q), np.broadcast_to(unit, p.shape))
        with np.errstate(divide="ignore", invalid="ignore"):
            gap = np.where(width > 0, facing * volume / width, 0.0)
        gaps.append(gap)
    gap = np.min(gaps, axis=0)

    slope = np.einsum("nfk,nfk->nf", normal, np.broadcast_to(unit, normal.shape))
    with np.errstate(divide="ignore", invalid="ignore"):
        distance = np.einsum("nfk,nfk->nf", normal, a) / slope
        distance_error = tolerance * (1 + np.linalg.norm(normal, axis=-1) / np.abs(slope))
        # A hit is on the triangle whatever the rounding, so t lies between its corners'.
        spread = np.ptp(
            [np.einsum("nfk,nfk->nf", p, np.broadcast_to(unit, p.shape)) for p in (a, b, c)], axis=0
        )
        distance_error = np.minimum(distance_error, spread + 2 * tolerance)
    t, t_error = distance / length, distance_error / length + np.abs(distance / length) * 2.0**-22
    low, high = np.asarray(t_min, float)[:, None], np.asarray(t_max, float)[:, None]
    with np.errstate(invalid="ignore"):
        inside = (gap > tolerance) & (t - t_error >= low) & (t + t_error <= high)
        in_range = (t + t_error >= low) & (t - t_error <= high)
        flat = ~np.isfinite(t) | (np.abs(slope) <= np.linalg.norm(normal, axis=-1) * 1e-6)
        near = np.min([_outline_distance(a, b, c, unit)], axis=0) <= tolerance
        outside = (gap < -tolerance) & ~(flat & near)
        sure = inside & ~flat
        doubt = ~sure & ~outside & (in_range | flat)
    empty = ~np.any(normal, axis=-1)
    sure &= ~empty
    doubt &= ~empty
    return Verdict(t, t_error, sure, doubt)


def _outline_distance(a, b, c, unit):
    """Distance from the ray's line to the triangle's bounding sphere; negative inside it."""
    middle = (a + b + c) / 3
    radius = np.max([np.linalg.norm(p - middle, axis=-1) for p in (a, b, c)], axis=0)
    along = np.einsum("nfk,nfk->nf", middle, np.broadcast_to(unit, middle.shape))
    closest = np.linalg.norm(middle - along[..., None] * unit, axis=-1)
    return closest - radius


def check_counts(verdict: Verdict, counts) -> None:
    """Counts lie between the sure hits and those with the doubtful ones."""
    least = verdict.sure.sum(axis=1)
    most = least + verdict.doubt.sum(axis=1)
    counts = np.asarray(counts)
    wrong = np.flatnonzero((counts < least) | (counts > most))
    assert not len(wrong), (
        f"rays {wrong[:5]}: {counts[wrong[:5]]} not in {least[wrong[:5]]}..{most[wrong[:5]]}"
    )


def check_first(verdict: Verdict, t, prim_id) -> None:
    """The hit is a possible one, its t is right, and no sure hit is nearer."""
    t, prim_id = np.asarray(t), np.asarray(prim_id)
    rays = np.flatnonzero(prim_id >= 0)
    chosen = prim_id[rays]
    possible = verdict.sure | verdict.doubt
    assert possible[rays, chosen].all(), rays[~possible[rays, chosen]][:5]
    sure = verdict.sure[rays, chosen]
    off = np.abs(t[rays] - verdict.t[rays, chosen])
    assert (off <= verdict.t_error[rays, chosen])[sure].all()
    with np.errstate(invalid="ignore"):
        nearest = np.where(verdict.sure, verdict.t + verdict.t_error, np.inf).min(
            axis=1, initial=np.inf
        )
    assert (t <= nearest).all(), np.flatnonzero(t > nearest)[:5]

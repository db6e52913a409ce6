"""The bulk of a scene: without strays, and without a ground or a sky that dwarfs the rest."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from raystream.scene.default_view.sizes import Mask, TriangleSizes

#: No triangle weighs more than this share of all, so that a few large ones are no bulk.
_MOST_WEIGHT = 0.005

#: Share of the weight that lies outside the core, on each side of each axis.
_TAIL = 0.05

#: Triangles from which the core is found.
_PICKED = 4096

#: Lengths in units of the core's size: the steps in which the bulk grows, the widest gap between
#: the parts of a model, and the farthest that it reaches beyond the core.
_STEP, _GAP, _REACH = 0.25, 2.0, 32.0

#: A ground is lower than this share of the scene's height, and this many times as wide as
#: the rest is large.
_GROUND_HEIGHT, _GROUND_WIDTH = 0.1, 3.0

#: A shell, such as a sky, is this many times as wide as what is in its inner part, which is this
#: share of its width, and holds this share of the triangles.
_SHELL_WIDTH, _SHELL_INNER, _SHELL_REST = 10.0, 0.4, 0.1

#: Margin of ground that is shown around the rest, in units of the rest's size.
_MARGIN = 0.1


def find_bulk(sizes: TriangleSizes, up: NDArray[np.float64]) -> tuple[Mask, NDArray[np.float32]]:
    """Find the triangles that an image should show, and the box to frame.

    Parameters
    ----------
    sizes : TriangleSizes
        Of at least one triangle.
    up : ndarray of shape (3,), float64
        The world's up, a unit vector.

    Returns
    -------
    bulk : ndarray of shape (N,), bool, or None
        The triangles that the box is made for; None for all.
    box : ndarray of shape (2, 3), float32
        Low and high corner, local frame.
    """
    bulk, whole = _without_strays(sizes, None)
    axis = int(np.argmax(np.abs(up)))
    below = np.zeros((2, 3), np.float32)
    below[int(up[axis] < 0.0), axis] = 1.0
    for opening in (0.0, 1.0):  # a sky may be a sphere, or a dome
        inner = _inside_shell(sizes, bulk, whole, opening * below)
        if inner is not None:
            rest, box = _without_strays(sizes, inner)
            if _SHELL_WIDTH * _extent(box) < (whole[1] - whole[0]).min():
                return rest, _with_margin(box, whole)
    above = _above_ground(sizes, bulk, up, whole)
    if above is not None and _GROUND_WIDTH * _extent(_core(sizes, above)) < _extent(whole):
        rest, box = _without_strays(sizes, above)
        if _GROUND_WIDTH * _extent(box) < _extent(whole):
            return rest, _with_margin(box, whole)
    return bulk, whole


def _with_margin(box: NDArray[np.float32], whole: NDArray[np.float32]) -> NDArray[np.float32]:
    """Enlarge a box by `_MARGIN`, within another."""
    margin = np.float32(_MARGIN * _extent(box))
    return np.stack([np.maximum(box[0] - margin, whole[0]), np.minimum(box[1] + margin, whole[1])])


def _inside_shell(
    sizes: TriangleSizes, mask: Mask, box: NDArray[np.float32], opening: NDArray[np.float32]
) -> Mask:
    """The small triangles in the inner part of a box; None if that is not much smaller.

    `opening`, of shape (2, 3), is 1 for the side to which the inner part reaches.
    """
    middle, half = (box[0] + box[1]) / 2, (box[1] - box[0]) / 2
    start, end = (
        (middle + sign * half * np.where(one > 0.0, 1.01, _SHELL_INNER)).astype(np.float32)[:, None]
        for sign, one in zip((-1.0, 1.0), opening, strict=True)
    )

    def are_inner(rows: slice) -> NDArray[np.bool_]:
        near, far = sizes.low[:, rows], sizes.high[:, rows]
        inner = ((near < end) & (far > start) & (far - near < half.max())).all(axis=0)
        return inner if mask is None else inner & mask[rows]

    # Some triangles suffice to see that an ordinary model has no shell.
    some = slice(None, None, max(1, len(sizes.areas) // _PICKED))
    found = are_inner(some)
    if found.any():
        low, high = sizes.low[:, some][:, found], sizes.high[:, some][:, found]
        extents = high.max(axis=1) - low.min(axis=1)
        if _SHELL_WIDTH * extents.max() >= (box[1] - box[0]).min():
            return None
    inner = are_inner(slice(None))
    count = len(inner) if mask is None else np.count_nonzero(mask)
    return inner if np.count_nonzero(inner) > _SHELL_REST * count else None


def _above_ground(
    sizes: TriangleSizes, mask: Mask, up: NDArray[np.float64], box: NDArray[np.float32]
) -> Mask:
    """Those of some triangles that rise above the lowest part of a flat box; None without any."""
    size = box[1] - box[0]
    if size.max() <= _GROUND_WIDTH * (1.0 - _GROUND_HEIGHT) * (np.abs(up) @ size):
        return None
    tops = np.zeros(len(sizes.areas), np.float32)
    bottom = top = 0.0
    for k, factor in enumerate(up.astype(np.float32)):
        if factor:
            tops += factor * (sizes.high[k] if factor > 0.0 else sizes.low[k])
            ends = sorted(factor * box[:, k])
            bottom, top = bottom + ends[0], top + ends[1]
    is_above: NDArray[np.bool_] = tops > bottom + _GROUND_HEIGHT * (top - bottom)
    if mask is not None:
        is_above &= mask
    return is_above if is_above.any() else None


def _extent(box: NDArray[np.float32]) -> float:
    return float((box[1] - box[0]).max())


def _without_strays(sizes: TriangleSizes, mask: Mask) -> tuple[Mask, NDArray[np.float32]]:
    """The triangles in the core, and those connected to it along each axis, and their box.

    A part of a model may be thin, and reach far; what lies beyond a wide gap does not belong to
    the model.
    """
    low, high = _core(sizes, mask)
    unit = float((high - low).max())
    while True:
        box = sizes.box(mask)
        if max((box[1] - high).max(), (low - box[0]).max()) <= _GAP * unit or not unit > 0.0:
            return mask, box
        scale = 1.0 / (unit * _STEP)
        is_near = np.ones(len(sizes.areas), bool) if mask is None else mask.copy()
        before = np.count_nonzero(is_near)
        for k in range(3):
            ends = sizes.low[k] - high[k], sizes.high[k] - high[k]
            is_near &= _is_connected(*ends, scale, mask)
            ends = low[k] - sizes.high[k], low[k] - sizes.low[k]
            is_near &= _is_connected(*ends, scale, mask)
        count = np.count_nonzero(is_near)
        if count in (0, before):
            return mask, box
        mask = is_near  # what was connected by a stray only is one, too


def _core(sizes: TriangleSizes, mask: Mask) -> NDArray[np.float32]:
    """The box around most of the weight, shape (2, 3).

    Triangles weigh their area; the largest are cut to `_MOST_WEIGHT` of the sum.
    """
    count = len(sizes.areas) if mask is None else np.count_nonzero(mask)
    left = sizes.area(mask)
    share = max(_MOST_WEIGHT, 2.0 / count)
    limit = np.inf
    for number, area in enumerate(sizes.largest(int(1.0 / share) + 1, mask)):
        if share * number >= 1.0:
            break
        limit = share * left / (1.0 - share * number)  # if the larger ones are cut to it
        if area <= limit:
            left += number * limit
            break
        left -= area

    rate, base = (_PICKED / left, 0.0) if left > 0.0 else (0.0, _PICKED / count)
    chosen, _ = sizes.pick(rate, base, limit, mask)
    if not len(chosen):
        return sizes.box(mask)
    return np.stack(
        [
            np.quantile(sizes.low[:, chosen], _TAIL, axis=1).astype(np.float32),
            np.quantile(sizes.high[:, chosen], 1.0 - _TAIL, axis=1).astype(np.float32),
        ]
    )


def _is_connected(
    starts: NDArray[np.float32], ends: NDArray[np.float32], scale: float, mask: Mask
) -> NDArray[np.bool_]:
    """Whether triangles belong to the model, on one side of one axis.

    Parameters
    ----------
    starts, ends : ndarray of shape (N,), float32
        Where they begin and end, outward from the side of the core.
    scale : float
        Steps per unit of length.
    mask : ndarray of shape (N,), bool, or None
        Those that connect others.
    """
    is_outside = ends > 0.0
    if not is_outside.any():
        return ~is_outside
    last = np.ceil(ends.astype(np.float64) * scale)
    steps, gap = int(_REACH / _STEP), int(_GAP / _STEP)
    is_within = is_outside & (last <= steps)
    if mask is not None:
        is_within &= mask
    first = (np.maximum(starts[is_within], 0.0).astype(np.float64) * scale).astype(np.int64)
    farthest = np.zeros(steps + 1, np.int64)
    np.maximum.at(farthest, np.minimum(first, steps), last[is_within].astype(np.int64))
    reached = 0
    while (further := int(farthest[: reached + gap + 1].max())) > reached:
        reached = further
    return last <= reached

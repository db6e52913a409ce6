"""The context of a filter that traversals call: a row of 8-byte numbers, by its address."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from raystream.jit.cpu import device
from raystream.jit.simd import load
from raystream.kernels.hit_filter import U_AT, V_AT
from raystream.kernels.search import ROW_NUMBER, ROW_SHIFT
from raystream.programs.hits import RaysAt
from raystream.programs.rows import SkipsAt

#: Its numbers: whether the filter raised; from `SCENE` on the address of the scene's addresses, see
#: `scene_forms.SceneForm`, and the `SkipsAt` if traversals do not skip; from `DIRECTIONS` on the
#: address and stride of the rays' directions, and whether these are float64; then the constants.
SCENE, DIRECTIONS, CONSTANTS = 1, 4, 7

_ZERO, _1, _2 = (np.uint64(8 * k) for k in range(3))
_SCENE_AT, _DIRECTIONS_AT = np.uint64(8 * SCENE), np.uint64(8 * DIRECTIONS)


@device
def _number(at, offset):
    return load(np.uint64, at + offset)


def scene_source(fields: Sequence[str]) -> str:
    """An expression for the scene's addresses, of these fields: ``Scene(...)``."""
    numbers = (f"load(uint64, at + uint64({8 * k}))" for k in range(len(fields)))
    return f"Scene({', '.join(numbers)})"


@device
def scene_place(context):
    """Where the scene's addresses are."""
    return _number(context, _SCENE_AT)


@device
def skips_of(context):
    """What rays skip, where traversals do not do it."""
    at = context + _SCENE_AT
    return SkipsAt(_number(at, _1), _number(at, _2))


@device
def rays_of(context):
    """The rays of a context, of which it has the directions only."""
    at = context + _DIRECTIONS_AT
    directions, step, is_double = _number(at, _ZERO), _number(at, _1), _number(at, _2) != _ZERO
    return RaysAt(_ZERO, False, _ZERO, _ZERO, _ZERO, directions, step, is_double)


@device
def lane_at(hits, lane):
    """t, u and v of a lane; see `kernels.hit_filter.kept_hits`."""
    at = hits + (lane << ROW_SHIFT)
    return load(ROW_NUMBER, at), load(ROW_NUMBER, at + U_AT), load(ROW_NUMBER, at + V_AT)

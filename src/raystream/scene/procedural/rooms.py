"""Rooms: boxes of a building's slabs, walls, stairs and furniture."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

#: Metres: width of a room; height of a storey and of its slab; half the corridor's width;
#: distance from the corridor's middle to the facade.
BAY, STOREY, SLAB, CORRIDOR, DEPTH = 4.2, 3.2, 0.25, 1.2, 6.4

#: Height of a room.
CLEAR = STOREY - SLAB

#: Doors start at this x within a bay.
DOOR = 2.5

CONCRETE, BRICK, PLASTER, WOOD, FRAME, FABRIC, BOOK, LAMP, CARPET = range(9)

#: Linear RGB of the kinds above; books have individual colours.
COLORS = np.array(
    [
        [0.6, 0.58, 0.54],
        [0.52, 0.25, 0.16],
        [0.78, 0.75, 0.68],
        [0.42, 0.25, 0.12],
        [0.85, 0.85, 0.83],
        [0.12, 0.22, 0.4],
        [1.0, 1.0, 1.0],
        [0.95, 0.94, 0.9],
        [0.35, 0.37, 0.4],
    ]
)

Row = tuple[float, float, float, float, float, float, int]


class Plan(NamedTuple):
    """Numbers of storeys and bays; each bay has a room on either side of the corridor."""

    storeys: int
    bays: int


class BoxList(NamedTuple):
    """Boxes, most important first, in case there are triangles for a few only.

    ``lows`` and ``highs`` have shape (N, 3), float64, metres; ``kinds`` has shape (N,).
    """

    lows: NDArray[np.float64]
    highs: NDArray[np.float64]
    kinds: NDArray[np.int64]


#: A room between the corridor (low z) and the facade (high z): low x, y, z, high x, y, z, kind.
SHELL: tuple[Row, ...] = (
    (0.0, -SLAB, 0.0, BAY, 0.0, DEPTH, CONCRETE),
    (0.0, 0.0, 6.25, BAY, 0.9, DEPTH, BRICK),
    (0.0, 2.4, 6.25, BAY, CLEAR, DEPTH, BRICK),
    (0.0, 0.9, 6.25, 0.7, 2.4, DEPTH, BRICK),
    (3.5, 0.9, 6.25, BAY, 2.4, DEPTH, BRICK),
    (0.0, 0.0, CORRIDOR, DOOR, CLEAR, 1.35, PLASTER),
    (DOOR + 0.95, 0.0, CORRIDOR, BAY, CLEAR, 1.35, PLASTER),
    (DOOR, 2.1, CORRIDOR, DOOR + 0.95, CLEAR, 1.35, PLASTER),
    (-0.07, 0.0, 1.35, 0.07, CLEAR, 6.25, PLASTER),
    (2.07, 0.9, 6.28, 2.13, 2.4, 6.34, FRAME),
    (0.7, 1.62, 6.28, 2.07, 1.67, 6.34, FRAME),
    (2.13, 1.62, 6.28, 3.5, 1.67, 6.34, FRAME),
    (0.6, 0.84, DEPTH, 3.6, 0.9, 6.52, CONCRETE),
    (0.6, 2.4, DEPTH, 3.6, 2.52, 6.46, CONCRETE),
    (DOOR + 0.9, 0.0, 1.35, DOOR + 0.95, 2.08, 2.25, WOOD),
    (1.5, 2.84, 3.5, 2.7, 2.92, 3.8, LAMP),
    (1.6, 2.84, 0.0, 2.6, 2.92, 0.15, LAMP),
    (0.07, 0.0, 1.12, DOOR, 0.12, CORRIDOR, WOOD),
    (0.3, 0.002, 2.2, 3.9, 0.012, 5.9, CARPET),
)


def _table(x: float, z: float, width: float, depth: float, top: float) -> list[Row]:
    legs = [
        (x + a, 0.0, z + b, x + a + 0.06, top - 0.04, z + b + 0.06, FRAME)
        for a in (0.04, width - 0.1)
        for b in (0.04, depth - 0.1)
    ]
    return [(x, top - 0.04, z, x + width, top, z + depth, WOOD), *legs]


def _chair(x: float, z: float, back: int) -> list[Row]:
    """Return a chair half a metre square; its back is at high (1) or low (-1) z."""
    edge = z + 0.42 if back > 0 else z
    legs = [
        (x + a, 0.0, z + b, x + a + 0.04, 0.42, z + b + 0.04, FRAME)
        for a in (0.02, 0.39)
        for b in (0.02, 0.39)
    ]
    return [
        (x, 0.42, z, x + 0.45, 0.45, z + 0.45, WOOD),
        (x, 0.55, edge, x + 0.45, 0.95, edge + 0.03, FABRIC),
        (x + 0.02, 0.45, edge + 0.005, x + 0.05, 0.55, edge + 0.025, FRAME),
        (x + 0.4, 0.45, edge + 0.005, x + 0.43, 0.55, edge + 0.025, FRAME),
        *legs,
    ]


def _shelf(x: float, z: float) -> list[Row]:
    """Return shelves of books along a side wall, open towards high x."""
    rows: list[Row] = [
        (x, 0.0, z, x + 0.3, 2.0, z + 0.03, WOOD),
        (x, 0.0, z + 1.57, x + 0.3, 2.0, z + 1.6, WOOD),
    ]
    for level in range(5):
        y = 0.06 + 0.48 * level
        rows.append((x, y, z + 0.03, x + 0.3, y + 0.03, z + 1.57, WOOD))
    for level in range(4):
        y, start = 0.09 + 0.48 * level, z + 0.06
        for book in range(9):
            thick = 0.05 + 0.013 * ((7 * book + 5 * level) % 5)
            tall = 0.26 + 0.02 * ((3 * book + 2 * level) % 6)
            end = start + thick
            rows.append((x + 0.03, y, start, x + 0.25, y + tall, end, BOOK))
            start = end + (0.22 if book == 5 else 0.004)
    return rows


OFFICE: tuple[Row, ...] = (
    *_table(0.9, 4.7, 1.8, 0.85, 0.75),
    (1.0, 0.05, 4.8, 1.4, 0.66, 5.45, FRAME),
    (1.5, 0.75, 5.3, 2.1, 1.15, 5.33, CARPET),
    (1.75, 0.75, 5.33, 1.85, 0.9, 5.36, CARPET),
    (1.5, 0.75, 4.85, 2.1, 0.765, 5.05, FRAME),
    *_chair(1.6, 4.1, -1),
    *_shelf(0.12, 1.6),
)

MEETING: tuple[Row, ...] = (
    *_table(0.9, 3.3, 2.4, 1.3, 0.74),
    *(row for x in (1.0, 1.85, 2.7) for row in _chair(x, 2.95, -1)),
    *(row for x in (1.0, 1.85, 2.7) for row in _chair(x, 4.5, 1)),
    (0.08, 1.0, 3.0, 0.11, 2.2, 5.2, LAMP),
    *_shelf(0.12, 1.4),
)


def all_boxes(plan: Plan, offices: NDArray[np.bool_]) -> BoxList:
    """Make every box of a building.

    Parameters
    ----------
    plan : Plan
    offices : ndarray of shape (R,), bool
        Whether each room is an office, else a meeting room; R = 2 storeys bays,
        storey by storey, bay by bay, front before back. The stairs take the first room at
        the back of each storey.
    """
    stairs = _is_stairs(plan)
    roof = _roof(plan)
    groups = [
        _rows(roof[:1]),
        _placed(SHELL, _bases(plan, np.ones(len(offices), bool))),
        _rows(roof[1:]),
        _rows([row for storey in range(plan.storeys) for row in _ends(plan, storey)]),
        _placed(_stairs(), _bases(plan, stairs)),
        _placed(OFFICE, _bases(plan, ~stairs & offices)),
        _placed(MEETING, _bases(plan, ~stairs & ~offices)),
    ]
    # The slab of a stairwell is open: its box is replaced by those of the stairs.
    shell = groups[1]
    kept = np.ones(len(shell.lows), bool)
    kept[: len(offices)] = ~stairs
    groups[1] = BoxList(shell.lows[kept], shell.highs[kept], shell.kinds[kept])
    return _joined(groups)


def outer_boxes(plan: Plan) -> BoxList:
    """Make the boxes of a building that belong to no room."""
    ends = [row for storey in range(plan.storeys) for row in _ends(plan, storey)]
    return _rows(_roof(plan) + ends)


def room_boxes() -> tuple[BoxList, BoxList, BoxList]:
    """Make the boxes of an office, a meeting room and stairs, as at the front of the first bay."""
    stairs = list(SHELL[1:]) + list(_stairs())
    return _rows(list(SHELL + OFFICE)), _rows(list(SHELL + MEETING)), _rows(stairs)


def rooms_of(
    plan: Plan, offices: NDArray[np.bool_]
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Where the rooms of a building are.

    Parameters
    ----------
    plan, offices
        As for `all_boxes`.

    Returns
    -------
    kinds : ndarray of shape (R,), int64
        Index into `room_boxes`.
    transforms : ndarray of shape (R, 3, 4), float64
        Rooms at the back are mirrored.
    """
    bases = _bases(plan, np.ones(len(offices), bool))
    transforms = np.zeros((len(bases), 3, 4))
    transforms[:, [0, 1], [0, 1]] = 1.0
    transforms[:, 2, 2] = bases[:, 2]
    transforms[:, :2, 3] = bases[:, :2]
    return np.where(_is_stairs(plan), 2, np.where(offices, 0, 1)), transforms


def _joined(groups: list[BoxList]) -> BoxList:
    return BoxList(
        np.concatenate([group.lows for group in groups]),
        np.concatenate([group.highs for group in groups]),
        np.concatenate([group.kinds for group in groups]),
    )


def _is_stairs(plan: Plan) -> NDArray[np.bool_]:
    room = np.arange(2 * plan.storeys * plan.bays)
    return (room % (2 * plan.bays) == 1) & (plan.bays > 1)


def _bases(plan: Plan, chosen: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Return x, y and side (1 front, -1 back) of the chosen rooms, shape (N, 3)."""
    room = np.flatnonzero(chosen)
    storey, rest = np.divmod(room, 2 * plan.bays)
    bay, back = np.divmod(rest, 2)
    return np.stack([bay * BAY, storey * STOREY, 1.0 - 2.0 * back], axis=1)


def _rows(rows: list[Row]) -> BoxList:
    table = np.asarray(rows, np.float64).reshape(-1, 7)
    return BoxList(table[:, :3], table[:, 3:6], table[:, 6].astype(np.int64))


def _placed(rows: tuple[Row, ...], bases: NDArray[np.float64]) -> BoxList:
    """Repeat a room's boxes for all rooms, ordered by box, then by room."""
    lows, highs, kinds = _rows(list(rows))
    flip = bases[None, :, 2] < 0.0
    shift = np.stack([bases[:, 0], bases[:, 1], np.zeros(len(bases))], axis=1)
    low = lows[:, None, :] + shift[None]
    high = highs[:, None, :] + shift[None]
    near, far = low[..., 2].copy(), high[..., 2].copy()
    low[..., 2] = np.where(flip, -far, near)
    high[..., 2] = np.where(flip, -near, far)
    return BoxList(low.reshape(-1, 3), high.reshape(-1, 3), np.repeat(kinds, len(bases)))


def _stairs() -> tuple[Row, ...]:
    """Return a straight flight of stairs from the corridor to a walkway one storey higher."""
    steps = 16
    rows: list[Row] = [
        (0.0, -SLAB, 0.0, BAY, 0.0, 1.45, CONCRETE),
        (0.0, -SLAB, 1.45, 1.8, 0.0, DEPTH, CONCRETE),
        (1.8, -SLAB, 5.3, BAY, 0.0, DEPTH, CONCRETE),
    ]
    rise, run = STOREY / steps, 3.85 / steps
    for step in range(steps):
        y, z = rise * step, 1.45 + run * step
        rows.append((2.1, max(0.0, y - 0.12), z, 3.9, y + rise, z + run + 0.02, CONCRETE))
    for post in range(9):
        z = 1.5 + 0.47 * post
        rows.append((1.72, 0.0, z, 1.75, 1.0, z + 0.03, FRAME))
    rows.append((1.7, 1.0, 1.5, 1.77, 1.05, 5.3, WOOD))
    return tuple(rows)


def _roof(plan: Plan) -> list[Row]:
    length, top = plan.bays * BAY, plan.storeys * STOREY
    out = 0.25
    rows: list[Row] = [
        (-out, top - SLAB, -DEPTH - out, length + out, top, DEPTH + out, CONCRETE),
        (-out, top, DEPTH, length + out, top + 0.7, DEPTH + out, BRICK),
        (-out, top, -DEPTH - out, length + out, top + 0.7, -DEPTH, BRICK),
        (-out, top, -DEPTH, 0.0, top + 0.7, DEPTH, BRICK),
        (length, top, -DEPTH, length + out, top + 0.7, DEPTH, BRICK),
    ]
    for unit in range(max(1, plan.bays // 3)):
        x = 1.2 + 3 * BAY * unit
        rows.append((x, top, -3.0, x + 1.6, top + 1.1, -1.2, FRAME))
        rows.append((x + 0.2, top + 1.1, -2.8, x + 1.4, top + 1.3, -1.4, CARPET))
    return rows


def _ends(plan: Plan, storey: int) -> list[Row]:
    """Return the outer walls at both ends of a storey's corridor, with windows."""
    rows: list[Row] = []
    y = storey * STOREY
    for x in (-0.2, plan.bays * BAY):
        low, high = x, x + 0.2
        rows += [
            (low, y - SLAB, 0.8, high, y + CLEAR, DEPTH, BRICK),
            (low, y - SLAB, -DEPTH, high, y + CLEAR, -0.8, BRICK),
            (low, y - SLAB, -0.8, high, y + 0.8, 0.8, BRICK),
            (low, y + 2.3, -0.8, high, y + CLEAR, 0.8, BRICK),
            (low + 0.07, y + 0.8, -0.03, high - 0.07, y + 2.3, 0.03, FRAME),
        ]
    return rows

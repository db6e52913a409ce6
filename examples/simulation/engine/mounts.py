"""Around an engine: pipes, pulley, oil filter, and the table that it stands on.

Positions as in `crank_drive`.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from engine.assembly import (
    ALONG_X,
    EXTRUDED_X,
    Detail,
    Piece,
    bar,
    bolt,
    piece,
    sweep,
    toward,
    turn,
)
from engine.crank_drive import (
    ALUMINIUM,
    COVER,
    CYLINDERS,
    EXHAUST,
    PAN,
    STEEL,
    TABLE,
    TURNED,
    WOOD,
)
from engine.valve_train import HEAD, OUTLET, ROW, SLANT

__all__ = ["FLOOR", "accessories", "manifolds", "stand"]

#: Height of the table's top.
FLOOR = -0.2

#: Where the exhaust pipes meet, and the intake pipes begin.
COLLECTOR = np.array([0.024, 0.035, 0.158])
PLENUM = np.array([0.0, 0.345, -0.165])


def manifolds(detail: Detail) -> list[Piece]:
    """Return the exhaust pipes with their collector, and the intake pipes with their plenum."""
    outlets = np.array([0.0, HEAD, ROW]) + OUTLET
    flange = [(0.0128, 0.0003), (0.0225, 0.0003), (0.0225, 0.008), (0.0128, 0.008)]
    exhaust, starts = [], []
    for x, (right, out) in zip(CYLINDERS + 0.02, ((-1, 1), (-1, -1), (1, -1), (1, 1)), strict=True):
        start = outlets + [x, 0.0, 0.0]
        end = COLLECTOR + [0.0182 * right, 0.0, 0.0182 * out]
        # The outer pipes bulge more: they pass in front of the inner ones.
        reach, height = (0.11, 0.13) if out > 0 else (0.07, 0.19)
        path = _bend(
            detail, start + 0.0095 * SLANT, start + reach * SLANT, end + [0.0, height, 0.0], end
        )
        exhaust.append(
            piece("exhaust", EXHAUST, sweep(detail, path, 0.0160, 0.0138, (1.0, 0.0, 0.0)))
        )
        starts.append(start)
    down = COLLECTOR - [0.0, 0.0004, 0.0]
    funnel = [
        *((0.0212, -0.075), (0.0235, -0.075), (0.0235, -0.062), (0.0445, -0.014)),
        *((0.0445, 0.0), (0.0425, 0.0), (0.0425, -0.0145), (0.0212, -0.0625)),
    ]
    tail = down + np.array([0.0, -0.0755, 0.0])
    tail_path = _bend(
        detail, tail, tail - [0, 0.06, 0], tail + [0.03, -0.075, 0], tail + [0.28, -0.085, 0]
    )
    intake = []
    for x in CYLINDERS - 0.02:
        start = np.array([x, HEAD + 0.02, -0.0645])
        end = np.array([x + 0.014, PLENUM[1] - 0.0425, PLENUM[2]])
        path = _bend(detail, start, start - [0, 0, 0.05], end - [0, 0.075, 0], end)
        intake.append(
            piece("intake", ALUMINIUM, sweep(detail, path, 0.018, 0.0155, (1.0, 0.0, 0.0)))
        )
    chamber, hollow = (
        [
            (0, -end),
            (radius - 0.012, -end),
            (radius, 0.012 - end),
            (radius, end - 0.012),
            (radius - 0.012, end),
            (0, end),
        ]
        for radius, end in ((0.045, 0.185), (0.042, 0.182))
    )
    throttle = [
        *((0.026, -0.25), (0.034, -0.25), (0.034, -0.244), (0.0285, -0.242)),
        *((0.0285, -0.195), (0.038, -0.193), (0.038, -0.1855), (0.026, -0.1855)),
    ]
    disc = [(0, -0.001), (0.0255, -0.001), (0.0255, 0.001), (0, 0.001)]
    spindle = [(0, -0.024), (0.0025, -0.024), (0.0025, 0.024), (0, 0.024)]
    butterfly = PLENUM + [-0.22, 0.0, 0.0]
    return [
        piece("intake", ALUMINIUM, turn(detail, chamber), PLENUM, ALONG_X),
        piece("intake", ALUMINIUM, turn(detail, hollow), PLENUM, ALONG_X, flipped=True),
        *exhaust,
        *intake,
        piece("exhaust", EXHAUST, turn(detail, funnel), down),
        piece("exhaust flange {}", EXHAUST, turn(detail, flange), starts, toward(SLANT)),
        piece("exhaust", EXHAUST, sweep(detail, tail_path, 0.0235, 0.0212, (0.0, 0.0, 1.0))),
        piece("throttle", ALUMINIUM, turn(detail, throttle), PLENUM, ALONG_X),
        piece("butterfly", TURNED, turn(detail, disc), butterfly, toward([1.0, 0.35, 0.0])),
        piece("butterfly", TURNED, turn(detail, spindle), butterfly, _along_z()),
    ]


def accessories(detail: Detail) -> list[Piece]:
    """Return the pulley, the bolts of crankshaft and flywheel, the oil filter and the dipstick."""
    grooves = [(0.07 if i % 2 == 0 else 0.066, -0.268 + 0.0024 * (i + 1)) for i in range(9)]
    pulley = [
        *((0.0163, -0.274), (0.024, -0.274), (0.026, -0.262), (0.058, -0.262), (0.060, -0.268)),
        *((0.07, -0.268), *grooves, (0.07, -0.244), (0.0163, -0.244)),
    ]
    can = [(0, 0), (0.034, 0), (0.037, 0.003), (0.037, 0.082), (0.031, 0.09), (0, 0.09)]
    inside = [
        (0, 0.002),
        (0.033, 0.002),
        (0.0352, 0.004),
        (0.0352, 0.081),
        (0.03, 0.0882),
        (0, 0.0882),
    ]
    element = [(0.014, 0.012), (0.03, 0.012), (0.03, 0.078), (0.014, 0.078)]
    filter_place = (-0.14, 0.02, 0.0955)
    angle = np.radians(np.arange(8) * 45.0)
    circle = np.stack([np.full(8, 0.236), 0.026 * np.cos(angle), 0.026 * np.sin(angle)], axis=1)
    stick = _bend(
        detail,
        np.array([-0.188, 0.0905, 0.082]),
        np.array([-0.188, 0.14, 0.086]),
        np.array([-0.196, 0.22, 0.12]),
        np.array([-0.194, 0.27, 0.1]),
    )
    return [
        piece("pulley", PAN, turn(detail, pulley), (0.0, 0.0, 0.0), ALONG_X),
        piece("oil filter", COVER, turn(detail, can), filter_place, _along_z()),
        piece("oil filter", COVER, turn(detail, inside), filter_place, _along_z(), flipped=True),
        piece("filter element", WOOD, turn(detail, element), filter_place, _along_z()),
        piece("crank bolt", TURNED, bolt(detail, 0.013, 0.01), (-0.291, 0.0, 0.0), EXTRUDED_X),
        piece("dipstick", TURNED, sweep(detail, stick, 0.003, 0.0, (1.0, 0.0, 0.0))),
        piece("flywheel bolts", STEEL, bolt(detail, 0.008, 0.006), circle, EXTRUDED_X, spare=True),
    ]


def stand(detail: Detail) -> list[Piece]:
    """Return a table, and blocks of wood on it under the oil pan."""
    blocks = [(0.02, 0.06, -0.165), (0.14, 0.18, -0.165), (-0.195, -0.155, -0.1048)]
    return [
        piece("table", TABLE, bar(detail, (-0.62, FLOOR - 0.006, -0.46), (0.62, FLOOR, 0.46))),
        *(
            piece("wood", WOOD, bar(detail, (low, FLOOR, z - 0.025), (high, top, z + 0.025)))
            for z in (0.06, -0.06)
            for low, high, top in blocks
        ),
    ]


def _bend(detail: Detail, *controls: ArrayLike) -> NDArray[np.float64]:
    """Return points on a cubic Bezier curve: enough of them for a pipe not to fold."""
    t = np.linspace(0.0, 1.0, max(12, detail.along(20)) + 1)[:, None]
    a, b, c, d = (np.asarray(control, np.float64) for control in controls)
    s = 1.0 - t
    return s**3 * a + 3 * s * s * t * b + 3 * s * t * t * c + t**3 * d


def _along_z() -> NDArray[np.float64]:
    """Return the rotation that turns the y axis to the z axis."""
    return np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])

"""Crank drive of a four-cylinder engine: block, liners, pistons, rods, crankshaft, oil pan.

Lengths are in metres, relative to the middle of the crankshaft's axis, which is the x axis; y is
up, and x points from the pulley to the flywheel.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from engine.assembly import (
    ALONG_X,
    EXTRUDED_X,
    UPRIGHT,
    Detail,
    Piece,
    bar,
    bolt,
    extrude,
    piece,
    turn,
)
from engine.outlines import arc, bevelled, gear, hole

__all__ = [
    "ALUMINIUM",
    "CERAMIC",
    "COVER",
    "CRANK_ANGLE",
    "CROWN",
    "CYLINDERS",
    "DECK",
    "EXHAUST",
    "IRON",
    "MAINS",
    "OIL",
    "PAN",
    "REAR",
    "RUBBER",
    "SEAL",
    "STEEL",
    "TABLE",
    "TURNED",
    "WOOD",
    "crankcase",
    "crankshaft",
    "oil_pan",
    "pin_heights",
    "pistons",
]

#: Materials, by index.
IRON, ALUMINIUM, STEEL, TURNED, PAN, COVER = range(6)
RUBBER, EXHAUST, CERAMIC, OIL, WOOD, TABLE = range(6, 12)

#: Positions of the cylinders and of the main bearings along the crankshaft.
CYLINDERS = np.array([-0.15, -0.05, 0.05, 0.15])
MAINS = np.array([-0.2, -0.1, 0.0, 0.1, 0.2])

BORE, THROW, ROD, CROWN = 0.042, 0.043, 0.140, 0.032

#: Height of the block's top.
DECK = 0.2160

#: Half the block's length.
REAR = 0.2115

#: Thickness of the walls left where a cavity would open to the outside. They are closed so that
#: each mesh is a solid, and too thin to be seen in an X-ray image.
SEAL = 0.0002

#: Angle of the first crank, degrees after top dead centre; the middle cranks are opposite.
CRANK_ANGLE = 30.0
ANGLES = np.radians(CRANK_ANGLE + np.array([0.0, 180.0, 180.0, 0.0]))


def pin_heights() -> NDArray[np.float64]:
    """Return the height of each piston's pin."""
    return THROW * np.cos(ANGLES) + np.sqrt(ROD**2 - (THROW * np.sin(ANGLES)) ** 2)


def crankcase(detail: Detail) -> list[Piece]:
    """Return the block, with a cavity around each liner, and the liners."""
    wall = np.array([[0.0457, 0.1], [0.048, 0.1], [0.048, DECK - SEAL]])
    jacket = [(0, 0.0852), (0.0457, 0.0852), *wall.tolist(), (0, DECK - SEAL)]
    top = DECK - 2 * SEAL
    liner = [
        *((BORE, 0.0855), (0.0455, 0.0855), (0.0455, DECK - 0.0085)),
        *((0.0478, DECK - 0.0085), (0.0478, top), (BORE, top)),
    ]
    cells = max(3, round(detail.quality / 8))
    corners = [(-0.05, -0.09), (0.0851, -0.09), (0.0851, 0.09), (-0.05, 0.09)]
    plate = bevelled(corners, detail.bevel, steps=cells)
    across = [(x, 0.0, 0.0) for x in CYLINDERS]
    bars = [
        *((side * 0.09, 0.0145, -0.058, 0.09, 0.005) for side in (-1, 1)),  # skirt
        *((side * 0.0725, 0.0825, 0.075, 0.09, 0.0225) for side in (-1, 1)),  # shelf
        *((side * 0.099, -0.054, -0.0579, -0.05, 0.006) for side in (-1, 1)),  # pan rail
    ]
    long = [
        bar(detail, (-REAR, low, z - half), (REAR, high, z + half))
        for z, _, low, high, half in bars
    ]
    ribs = [(x, 0.0, side * 0.0665) for side in (-1, 1) for x in np.linspace(-0.2, 0.2, 9)]
    return [
        piece("block", IRON, bar(detail, (-REAR, 0.085, -0.064), (REAR, DECK, 0.064))),
        piece("block", IRON, long[0]),
        piece("block", IRON, long[1]),
        piece("block", IRON, turn(detail, jacket, plain=True), across, flipped=True),
        piece("liner {}", STEEL, turn(detail, liner, plain=True), across),
        *(piece("block", IRON, solid) for solid in long[2:]),
        piece(
            "block",
            IRON,
            extrude(detail, plate, 0.023, hole(plate, 0.0276)),
            [(x - 0.0115, 0.0, 0.0) for x in MAINS],
            EXTRUDED_X,
        ),
        piece("block", IRON, bar(detail, (-0.003, 0.089, -0.0045), (0.003, 0.206, 0.0045)), ribs),
        piece("block", IRON, bar(detail, (-REAR, 0.204, 0.0635), (REAR, DECK, 0.069))),
        piece("block", IRON, bar(detail, (-REAR, 0.204, -0.069), (REAR, DECK, -0.0635))),
    ]


def pistons(detail: Detail) -> list[Piece]:
    """Return pistons with rings, pins, and rods that lead to the crankshaft's pins."""
    radius, groove = 0.0415, 0.0383
    cuts = [0.0065, 0.0095, 0.0145, 0.0165, 0.0220, 0.0240]
    steps = [(radius if i % 2 == k else groove, y) for i, y in enumerate(cuts) for k in (0, 1)]
    crown = [(radius, CROWN), (0.031, CROWN), (0.029, 0.0305), (0, 0.0305)]
    body = [
        *((0, 0.0215), (0.0335, 0.0215), (0.036, 0.017), (0.036, -0.028)),
        *((radius, -0.028), *steps, *crown),
    ]
    boss = [(0.0103, 0.016), (0.016, 0.016), (0.016, 0.0365), (0.0103, 0.0365)]
    ring = [(0.0387, 0.0001), (0.0418, 0.0001), (0.0418, 0.0019), (0.0387, 0.0019)]
    pin = [(0.006, -0.0325), (0.01, -0.0325), (0.01, 0.0325), (0.006, 0.0325)]
    heights = pin_heights()
    pins = np.stack([CYLINDERS, heights, np.zeros(4)], axis=1)
    cranks = np.stack([CYLINDERS, THROW * np.cos(ANGLES), THROW * np.sin(ANGLES)], axis=1)
    # Rods are made upright, with the big end at the origin.
    along = (pins - cranks) / ROD
    x = np.broadcast_to([1.0, 0.0, 0.0], along.shape)
    tilt = np.stack([x, along, np.cross(x, along)], axis=2)
    big = [(0.0241, -0.0135), (0.0335, -0.0135), (0.0335, 0.0135), (0.0241, 0.0135)]
    small = [(0.0104, -0.0125), (0.0155, -0.0125), (0.0155, 0.0125), (0.0104, 0.0125)]
    flanges = [
        bar(detail, (-0.0075, 0.0285, z - 0.0015), (0.0075, 0.1295, z + 0.0015))
        for z in (-0.0075, 0.0075)
    ]
    web = bar(detail, (-0.002, 0.0285, -0.0085), (0.002, 0.1285, 0.0085))
    bolts = [
        bar(detail, (-0.006, -0.017, z - 0.005), (0.006, 0.017, z + 0.005)) for z in (-0.033, 0.033)
    ]
    mirrored = np.diag([-1.0, 1.0, -1.0])
    bosses = [
        piece("piston {}", ALUMINIUM, turn(detail, boss), pins, side @ ALONG_X)
        for side in (np.eye(3), mirrored)
    ]
    rod = [
        piece("rod {}", STEEL, solid, offsets, tilt @ matrix)
        for solid, offsets, matrix in (
            (web, cranks, np.eye(3)),
            *((flange, cranks, np.eye(3)) for flange in flanges),
            (turn(detail, big), cranks, ALONG_X),
            (turn(detail, small), pins, ALONG_X),
            *((bolt, cranks, np.eye(3)) for bolt in bolts),
        )
    ]
    rings = [
        piece("rings {}", TURNED, turn(detail, ring, plain=True), pins + [0.0, low, 0.0])
        for low in (0.0070, 0.0145, 0.0220)
    ]
    return [
        piece("piston {}", ALUMINIUM, turn(detail, body), pins),
        rod[0],
        *bosses,
        piece("pin {}", TURNED, turn(detail, pin, plain=True), pins, ALONG_X),
        *rod[1:],
        *rings,
    ]


def crankshaft(detail: Detail) -> list[Piece]:
    """Return the crankshaft, with counterweights, timing gear and flange, and the flywheel."""
    main = [(0, -0.014), (0.027, -0.014), (0.027, 0.014), (0, 0.014)]
    journal = [(0, -0.017), (0.0235, -0.017), (0.0235, 0.017), (0, 0.017)]
    nose = [(0, -0.281), (0.016, -0.281), (0.016, -0.21), (0, -0.21)]
    flange = [(0, 0.212), (0.038, 0.212), (0.038, 0.222), (0, 0.222)]
    around = [(0.0, math.cos(angle), math.sin(angle)) for angle in ANGLES]
    x = np.array([1.0, 0.0, 0.0])
    frames = np.stack([np.stack([x, y, np.cross(x, y)], axis=1) for y in np.array(around)])
    fine = max(3, detail.around(0.06) // 3)
    cheeks = [
        *(arc((THROW, 0.0), 0.0305, -84.0, 84.0, fine), arc((0.0, 0.0), 0.034, 94.0, 100.0, 2)),
        *(arc((0.0, 0.0), 0.062, 116.0, 244.0, fine), arc((0.0, 0.0), 0.034, 260.0, 266.0, 2)),
    ]
    web = extrude(detail, bevelled(np.concatenate(cheeks), detail.bevel), 0.021)
    sides = [
        piece(
            "crankshaft",
            STEEL,
            web,
            [(at + low, 0.0, 0.0) for at in CYLINDERS],
            frames @ EXTRUDED_X,
        )
        for low in (-0.037, 0.016)
    ]
    pins = np.stack([CYLINDERS, THROW * np.cos(ANGLES), THROW * np.sin(ANGLES)], axis=1)
    teeth = min(max(6, round(0.6 * detail.quality)), 20)
    timing = gear(0.0235, 0.0262, teeth, smooth=detail.smooth)
    disc = [
        *((0.011, 0.222), (0.085, 0.222), (0.095, 0.224), (0.131, 0.224), (0.131, 0.250)),
        *((0.086, 0.250), (0.082, 0.236), (0.011, 0.236)),
    ]
    starter_teeth = min(max(8, round(3.0 * detail.quality)), 118)
    starter = gear(0.1345, 0.1405, starter_teeth, smooth=detail.smooth)
    return [
        piece("crankshaft", STEEL, turn(detail, nose), (0.0, 0.0, 0.0), ALONG_X),
        piece("flywheel", TURNED, turn(detail, disc), (0.0, 0.0, 0.0), ALONG_X),
        piece("crankshaft", STEEL, turn(detail, main), [(at, 0.0, 0.0) for at in MAINS], ALONG_X),
        piece("crankshaft", STEEL, turn(detail, journal), pins, ALONG_X),
        *sides,
        piece("crankshaft", STEEL, turn(detail, flange), (0.0, 0.0, 0.0), ALONG_X),
        piece("crankshaft", STEEL, extrude(detail, timing, 0.016), (-0.2345, 0.0, 0.0), EXTRUDED_X),
        piece(
            "flywheel",
            TURNED,
            extrude(detail, starter, 0.012, hole(starter, 0.1295)),
            (0.2245, 0.0, 0.0),
            EXTRUDED_X,
        ),
    ]


def oil_pan(detail: Detail) -> list[Piece]:
    """Return the oil pan: deep at the rear, hollow, with oil in its sump."""
    # About a point within the sump from which all corners are visible.
    middle = np.array([0.1, -0.09])
    outside = np.array(
        [
            (-0.207, -0.058),
            (-0.207, -0.098),
            (-0.035, -0.104),
            (-0.005, -0.165),
            (0.195, -0.165),
            (0.207, -0.058),
        ]
    )
    inside = np.array(
        [
            *((-0.205, -0.058 - SEAL), (-0.205, -0.096), (-0.0337, -0.102)),
            *((-0.0037, -0.163), (0.1932, -0.163), (0.205, -0.058 - SEAL)),
        ]
    )
    oil = np.array([(-0.0028, -0.1622), (0.1924, -0.1622), (0.1966, -0.125), (-0.0214, -0.125)])
    solids = [
        extrude(detail, bevelled(corners - middle, detail.bevel), depth)
        for corners, depth in ((outside, 0.186), (inside, 0.182), (oil, 0.1804))
    ]
    rails = [
        *(((-0.21, -0.066, z - 0.0065), (0.21, -0.058, z + 0.0065)) for z in (-0.0985, 0.0985)),
        *(((x - 0.003, -0.066, -0.092), (x + 0.003, -0.058, 0.092)) for x in (-0.2085, 0.2085)),
    ]
    spots = [(x, -0.07, z) for z in (0.1, -0.1) for x in np.linspace(-0.195, 0.195, 7)]
    return [
        piece("pan", PAN, solids[0], (*middle, -0.093)),
        piece("pan", PAN, solids[1], (*middle, -0.091), flipped=True),
        piece("oil", OIL, solids[2], (*middle, -0.0902)),
        *(piece("pan", PAN, bar(detail, low, high)) for low, high in rails),
        piece("pan bolts", TURNED, bolt(detail, 0.0045, 0.004), spots, UPRIGHT, spare=True),
    ]

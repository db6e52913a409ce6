"""Valve train of a four-cylinder engine: head, valves, springs, camshaft, timing belt, cover.

Positions as in `crank_drive`. Spark plugs and exhaust are on the side of high z.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

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
    sweep,
    toward,
    turn,
)
from engine.crank_drive import (
    ALUMINIUM,
    CERAMIC,
    COVER,
    CRANK_ANGLE,
    CYLINDERS,
    DECK,
    MAINS,
    REAR,
    RUBBER,
    SEAL,
    STEEL,
    TURNED,
)
from engine.outlines import arc, bevelled, circle, gear, hole, hull

__all__ = [
    "HEAD",
    "OUTLET",
    "PORT",
    "ROW",
    "SLANT",
    "camshaft",
    "cylinder_head",
    "head_cover",
    "spark_plugs",
    "valves",
]

#: Height of the head's bottom, above the gasket.
HEAD = DECK + 0.0012

#: z of the valves and of the camshaft.
ROW = -0.008

#: Normal (0, y, z) of the slanted side of the head; plugs and exhaust ports lead there.
SLANT = np.array([0.0, 0.574, 0.819]) / math.hypot(0.574, 0.819)

#: Distance of the slanted side from the head's lower edge at y = 0, z = 0.
SIDE = 0.0627

#: Where a port leaves its valve, relative to it, and the middle of its opening in the side.
PORT = np.array([0.004, 0.016, 0.032])
OUTLET = PORT + (SIDE - PORT[1] * SLANT[1] - (PORT[2] + ROW) * SLANT[2]) * SLANT

#: Height of the camshaft, and radius of its cams without their lobes, above the head's bottom.
CAM_HEIGHT, CAM_RADIUS, LIFT = 0.0972, 0.015, 0.0095

#: Half the cam angle for which a valve is open, degrees.
OPEN = 65.0

#: z of the points at the head's bottom that the plugs lead to.
PLUG = 0.012

FIRING_ORDER = (1, 3, 4, 2)

#: Crank angles after firing at which the valves are open the most.
PEAKS = {"intake": 468.0, "exhaust": 252.0}


def cam_angles(kind: str) -> NDArray[np.float64]:
    """Return how far each cam has turned past its valve, degrees of the camshaft."""
    turns = np.array([180.0 * FIRING_ORDER.index(cylinder) for cylinder in (1, 2, 3, 4)])
    return ((CRANK_ANGLE - turns) % 720.0 - PEAKS[kind]) / 2


def lobe(angles: ArrayLike) -> NDArray[np.float64]:
    """Return the radius of a cam at angles in degrees from its peak."""
    off = np.abs((np.asarray(angles, np.float64) + 180.0) % 360.0 - 180.0)
    rise = np.cos(np.minimum(off / OPEN, 1.0) * (np.pi / 2)) ** 2
    return CAM_RADIUS + LIFT * rise


def lifts(kind: str) -> NDArray[np.float64]:
    """Return how far each valve is open: its flat tappet touches the cam's lowest point."""
    angle = np.linspace(-90.0, 90.0, 361)
    reach = lobe(angle[None] - cam_angles(kind)[:, None]) * np.cos(np.radians(angle))
    return reach.max(axis=1) - CAM_RADIUS


def _places(kind: str, heights: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the positions of the four valves of a kind, at heights above the head's bottom."""
    x = CYLINDERS + (0.02 if kind == "exhaust" else -0.02)
    return np.stack([x, HEAD + heights, np.full(4, ROW)], axis=1)


RADII = {"intake": 0.0185, "exhaust": 0.016}


def cylinder_head(detail: Detail) -> list[Piece]:
    """Return the head, with cavities for valves, springs, plugs and ports, and the gasket."""
    middle = np.array([0.035, -0.01])
    corners = np.array([(0, -0.064), (0.08, -0.055), (0.08, 0.0205), (0.018, 0.064), (0, 0.064)])
    body = extrude(detail, bevelled(corners - middle, detail.bevel), 2 * REAR)
    cells = max(3, round(detail.quality / 12))
    plate = bevelled(
        [(-0.05, -0.064), (0.05, -0.064), (0.05, 0.064), (-0.05, 0.064)], detail.bevel, steps=cells
    )
    tower = [
        *((-0.0173, -0.024), (0.0, -0.024), *arc((0.0, 0.0), 0.0225, -70.0, 70.0, 9)),
        *((0.0, 0.024), (-0.0173, 0.024), (-0.0173, 0.012), (-0.0173, 0.0), (-0.0173, -0.012)),
    ]
    bearing = bevelled(tower, detail.bevel)
    end = SIDE - PLUG * SLANT[2] - SEAL
    well = [
        *((0, 0.0102), (0.0068, 0.0102), (0.0068, 0.028), (0.0108, 0.0285)),
        *((0.0108, end), (0, end)),
    ]
    holes = []
    for kind, radius in RADII.items():
        throat = radius - 0.003
        cavity = [
            *((0, SEAL), (radius + 0.001, SEAL), (radius + 0.001, 0.006), (throat, 0.009)),
            *((throat, 0.022), (0.008, 0.032), (0.0043, 0.034), (0.0043, 0.046)),
            *((0.0178, 0.046), (0.0178, 0.08 - SEAL), (0, 0.08 - SEAL)),
        ]
        places = _places(kind, np.zeros(4))
        holes.append(
            piece("head", ALUMINIUM, turn(detail, cavity, plain=True), places, flipped=True)
        )
    outward = [(0.0, *PORT[1:]), (0.0, *(OUTLET - SEAL * SLANT)[1:])]
    inward = [(0.0, 0.016, -0.021), (0.0, 0.02, -0.064 - ROW + 0.004)]
    ports = [
        piece("head", ALUMINIUM, sweep(detail, np.array(path), radius), places, flipped=True)
        for path, radius, places in (
            (outward, 0.0125, _places("exhaust", np.zeros(4)) + [PORT[0], 0.0, 0.0]),
            (inward, 0.0145, _places("intake", np.zeros(4))),
        )
    ]
    tilt = toward(SLANT)
    return [
        piece("head", ALUMINIUM, body, (-REAR, HEAD + middle[0], middle[1]), EXTRUDED_X),
        *holes,
        piece(
            "head",
            ALUMINIUM,
            extrude(detail, bearing, 0.014, hole(bearing, 0.0147)),
            [(x - 0.007, HEAD + CAM_HEIGHT, ROW) for x in MAINS],
            EXTRUDED_X,
        ),
        piece("head", ALUMINIUM, turn(detail, well, plain=True), _plugs(), tilt, flipped=True),
        *ports,
        piece(
            "gasket",
            STEEL,
            extrude(detail, plate, 0.0012, hole(plate, 0.0435)),
            [(x, DECK, 0.0) for x in CYLINDERS],
            UPRIGHT,
        ),
    ]


def valves(detail: Detail) -> list[Piece]:
    """Return valves with retainers, springs and tappets, as far open as the cams say."""
    tappet = [
        *((0, 0.0775), (0.0145, 0.0775), (0.0145, 0.062), (0.0165, 0.062)),
        *((0.0165, 0.082), (0, 0.082)),
    ]
    retainer = [(0, 0.073), (0.0128, 0.073), (0.0128, 0.0748), (0, 0.0748)]
    pieces, springs = [], []
    for kind, radius in RADII.items():
        profile = [
            *((0, 0.0035), (radius, 0.0035), (radius, 0.0055), (0.55 * radius, 0.0085)),
            *((0.0046, 0.016), (0.0038, 0.023), (0.0038, 0.0773), (0, 0.0773)),
        ]
        places = _places(kind, -lifts(kind))
        name = f"{kind} valve {{}}"
        pieces += [
            piece(name, TURNED, turn(detail, profile), places),
            piece(f"{kind} tappet {{}}", STEEL, turn(detail, tappet), places),
            piece(name, TURNED, turn(detail, retainer), places),
        ]
        for cylinder, lift in enumerate(lifts(kind)):
            end = 0.073 - 0.0017 - lift
            place = _places(kind, np.zeros(4))[cylinder]
            spring = sweep(detail, _helix(detail, 0.048, end), 0.0016)
            springs.append(piece(f"{kind} spring {cylinder + 1}", STEEL, spring, place))
    return pieces + springs


def camshaft(detail: Detail) -> list[Piece]:
    """Return the camshaft with its sprocket, and the timing belt."""
    shaft = [(0, -0.238), (0.0125, -0.238), (0.0125, 0.208), (0, 0.208)]
    journal = [(0, -0.008), (0.0144, -0.008), (0.0144, 0.008), (0, 0.008)]
    axis = np.array([0.0, HEAD + CAM_HEIGHT, ROW])
    count = detail.around(0.04)
    angle = np.arange(count) * (360.0 / count)
    around = np.stack([np.cos(np.radians(angle)), np.sin(np.radians(angle))], axis=1)
    cam = bevelled(lobe(angle)[:, None] * around, detail.bevel)
    solid = extrude(detail, cam, 0.016)
    cams = []
    for kind in RADII:
        turned = np.radians(180.0 + cam_angles(kind))
        frames = np.zeros((4, 3, 3))
        frames[:, 0, 0] = 1.0
        frames[:, 1, 1] = frames[:, 2, 2] = np.cos(turned)
        frames[:, 2, 1] = np.sin(turned)
        frames[:, 1, 2] = -frames[:, 2, 1]
        places = _places(kind, np.full(4, CAM_HEIGHT)) - [0.008, 0.0, 0.0]
        cams.append(piece("camshaft", STEEL, solid, places, frames @ EXTRUDED_X))
    teeth = min(max(12, round(1.2 * detail.quality)), 40)
    sprocket = gear(0.0498, 0.0525, teeth, smooth=detail.smooth)
    points = max(4, detail.around(0.05) // 2)
    center = (HEAD + CAM_HEIGHT, ROW)
    outer, inner = (
        hull((0.0265 + gap, 0.0528 + gap), center, points, smooth=detail.smooth)
        for gap in (0.0045, 0.0)
    )
    return [
        piece("camshaft", STEEL, turn(detail, shaft), axis, ALONG_X),
        *cams,
        piece(
            "timing belt",
            RUBBER,
            extrude(detail, outer, 0.0155, inner),
            (-0.23425, 0.0, 0.0),
            EXTRUDED_X,
        ),
        piece(
            "camshaft", STEEL, turn(detail, journal), [axis + [x, 0.0, 0.0] for x in MAINS], ALONG_X
        ),
        piece(
            "camshaft", STEEL, extrude(detail, sprocket, 0.016), axis - [0.2345, 0, 0], EXTRUDED_X
        ),
    ]


def head_cover(detail: Detail) -> list[Piece]:
    """Return the head cover, a shell over the camshaft, with its filler cap and bolts."""
    count = max(5, detail.around(0.03) // 2)
    shells = []
    for half, low, length in (
        (0.0285, 0.0802 - CAM_HEIGHT - SEAL, REAR),
        (0.0263, 0.0802 - CAM_HEIGHT, 0.2093),
    ):
        corners = [(low, -half), *arc((0.0, 0.0), half, -90.0, 90.0, count), (low, half)]
        ordered = np.array(corners)
        shells.append((extrude(detail, bevelled(ordered, detail.bevel), 2 * length), length))
    axis = np.array([0.0, HEAD + CAM_HEIGHT, ROW])
    cap = [
        *((0, 0.0284), (0.009, 0.0284), (0.009, 0.033), (0.018, 0.033)),
        *((0.018, 0.046), (0.016, 0.048), (0, 0.048)),
    ]
    rails = [
        bar(
            detail,
            (-REAR, HEAD + 0.0801, ROW + z - 0.0037),
            (REAR, HEAD + 0.0855, ROW + z + 0.0037),
        )
        for z in (-0.0322, 0.0322)
    ]
    spots = [
        (x, HEAD + 0.0855, ROW + z)
        for z in (0.0322, -0.0322)
        for x in np.linspace(-0.195, 0.195, 6)
    ]
    (outer, length), (inner, inner_length) = shells
    return [
        piece("cover", COVER, outer, axis - [length, 0, 0], EXTRUDED_X),
        piece("cover", COVER, inner, axis - [inner_length, 0, 0], EXTRUDED_X, flipped=True),
        *(piece("cover", COVER, rail) for rail in rails),
        piece("filler cap", RUBBER, turn(detail, cap), axis + [0.09, 0, 0]),
        piece("cover bolts", TURNED, bolt(detail, 0.0034, 0.005), spots, UPRIGHT, spare=True),
    ]


def spark_plugs(detail: Detail) -> list[Piece]:
    """Return the spark plugs: a thread and a hexagon, a ceramic insulator, and a terminal."""
    thread = [(0.0022, 0.0104), (0.0062, 0.0104), (0.0062, 0.029), (0.0022, 0.029)]
    insulator = [
        *((0, 0.0104), (0.0019, 0.0104), (0.0019, 0.0292), (0.0048, 0.032), (0.0048, 0.076)),
        *((0.0036, 0.079), (0, 0.079)),
    ]
    terminal = [(0, 0.0792), (0.003, 0.0792), (0.003, 0.088), (0, 0.088)]
    hexagon = circle(0.0095, 6).points
    outline = bevelled(hexagon, detail.bevel, steps=max(1, round(detail.quality / 32)))
    collar = extrude(detail, outline, 0.014, hole(outline, 0.0052))
    tilt = toward(SLANT)
    along = _plugs() + 0.03 * SLANT
    return [
        piece("plug {}", TURNED, collar, along, tilt @ UPRIGHT),
        piece("insulator {}", CERAMIC, turn(detail, insulator), _plugs(), tilt),
        piece("plug {}", TURNED, turn(detail, thread), _plugs(), tilt),
        piece("terminal {}", TURNED, turn(detail, terminal), _plugs(), tilt),
    ]


def _plugs() -> NDArray[np.float64]:
    """Return the points from which the plugs' heights are measured, along `SLANT`."""
    return np.stack([CYLINDERS, np.full(4, HEAD), np.full(4, PLUG)], axis=1)


def _helix(detail: Detail, low: float, high: float, turns: int = 4) -> NDArray[np.float64]:
    steps = turns * detail.along(28)
    angle = np.linspace(0.0, 2 * np.pi * turns, steps + 1)
    height = np.linspace(low, high, steps + 1)
    return np.stack([0.0115 * np.cos(angle), height, 0.0115 * np.sin(angle)], axis=1)

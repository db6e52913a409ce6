"""Shapes as users write them, from outside the package: for tests and benchmarks."""

from __future__ import annotations

import math
from typing import Any

import numba
import numpy as np

import raystream as rs

BALL = np.dtype([("center", "f8", 3), ("radius", "f8")])
#: Around the z axis.
TORUS = np.dtype([("center", "f8", 3), ("major", "f8"), ("minor", "f8")])
CAPSULE = np.dtype([("a", "f8", 3), ("b", "f8", 3), ("radius", "f8")])
DISC = np.dtype([("center", "f8", 3), ("normal", "f8", 3), ("radius", "f8")])
#: Where a x^2 + b y^2 + c z^2 = constant around the centre, within a box of half sides.
QUADRIC = np.dtype([("center", "f8", 3), ("factors", "f8", 3), ("constant", "f8"), ("half", "f8")])
#: A tube around a quadratic Bezier curve.
CURVE = np.dtype([("points", "f8", (3, 3)), ("radius", "f8")])
#: A box with rounded edges.
BOX = np.dtype([("center", "f8", 3), ("half", "f8", 3), ("round", "f8")])
#: A ball without what another ball cuts out of it.
BITTEN = np.dtype([("center", "f8", 3), ("radius", "f8"), ("bite", "f8", 3), ("bite_radius", "f8")])


@numba.njit
def dot(a: Any, b: Any) -> Any:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@numba.njit
def minus(a: Any, b: Any) -> Any:
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@numba.njit
def along(origin: Any, direction: Any, t: float) -> Any:
    return (
        origin[0] + t * direction[0],
        origin[1] + t * direction[1],
        origin[2] + t * direction[2],
    )


@numba.njit
def around(center: Any, x: float, y: float, z: float) -> Any:
    low = center[0] - x, center[1] - y, center[2] - z
    return low, (center[0] + x, center[1] + y, center[2] + z)


# Balls


@numba.njit
def ball_crossings(center: Any, radius: float, origin: Any, direction: Any) -> Any:
    """Both distances; NaN for a miss."""
    start, square = minus(origin, center), dot(direction, direction)
    middle = -dot(start, direction) / square
    nearest = along(start, direction, middle)
    half = math.sqrt((radius * radius - dot(nearest, nearest)) / square)
    return middle - half, middle + half


def ball_bounds(ball: Any) -> Any:
    return around(ball.center, ball.radius, ball.radius, ball.radius)


def ball_hits(ball: Any, origin: Any, direction: Any, span: Any, t: Any) -> int:
    t[1], t[0] = ball_crossings(ball.center, ball.radius, origin, direction)
    return 2 if t[0] == t[0] else 0


def ball_normal(ball: Any, point: Any) -> Any:
    return minus(point, ball.center)


def ball_distance(ball: Any, point: Any) -> float:
    place = minus(point, ball.center)
    return math.sqrt(dot(place, place)) - ball.radius


def bitten_bounds(ball: Any) -> Any:
    return around(ball.center, ball.radius, ball.radius, ball.radius)


def bitten_hits(ball: Any, origin: Any, direction: Any, span: Any, t: Any) -> int:
    first, last = ball_crossings(ball.center, ball.radius, origin, direction)
    begin, end = ball_crossings(ball.bite, ball.bite_radius, origin, direction)
    count = 0
    if not first <= last:
        return 0
    for crossing in (first, last):
        if not begin < crossing < end:
            t[count] = crossing
            count += 1
    for crossing in (begin, end):
        if first < crossing < last:
            t[count] = crossing
            count += 1
    return count


def bitten_normal(ball: Any, point: Any) -> Any:
    outer, inner = minus(point, ball.center), minus(ball.bite, point)
    from_outer = abs(math.sqrt(dot(outer, outer)) - ball.radius)
    from_inner = abs(math.sqrt(dot(inner, inner)) - ball.bite_radius)
    return outer if from_outer < from_inner else inner


# A torus: a quartic equation without its cubic term, from the point nearest to the centre


@numba.njit
def quartic(p: float, q: float, c: float, x: float) -> float:
    return ((x * x + p) * x + q) * x + c


@numba.njit
def quartic_root(p: float, q: float, c: float, low: float, high: float, x: float) -> float:
    """The root between two places, by Newton's method from x, or halves where it leaves them."""
    falls, least = quartic(p, q, c, low) > 0.0, 1e-15 * (high - low)
    for _ in range(80):
        value = quartic(p, q, c, x)
        if (value > 0.0) == falls:
            low = x
        else:
            high = x
        slope = (4.0 * x * x + 2.0 * p) * x + q
        following = x - value / slope if slope != 0.0 else low
        if abs(following - x) <= least + 4e-16 * abs(x):
            break
        x = following if low < following < high else 0.5 * (low + high)
    return x


@numba.njit
def extremes(p: float, q: float) -> Any:
    """Where x^4 + p x^2 + q x has its extremes: three, or one three times; increasing."""
    p, q = p / 6.0, q / 8.0
    rest = q * q + p * p * p
    if rest > 0.0:
        root = math.sqrt(rest)
        big = -q - root if q > 0.0 else -q + root
        cube = math.copysign(abs(big) ** (1.0 / 3.0), big)
        only = cube - p / cube if cube != 0.0 else 0.0
        return only, only, only
    size = math.sqrt(-p)
    cosine = -q / (size * size * size) if size > 0.0 else 0.0
    cosine = math.cos(math.acos(min(max(cosine, -1.0), 1.0)) / 3.0)
    sine = math.sqrt(max(1.0 - cosine * cosine, 0.0)) * 1.7320508075688772
    return size * (-cosine - sine), size * (sine - cosine), 2.0 * size * cosine


def torus_bounds(torus: Any) -> Any:
    reach = torus.major + torus.minor
    return around(torus.center, reach, reach, torus.minor)


def torus_hits(torus: Any, origin: Any, direction: Any, span: Any, t: Any) -> int:
    length = math.sqrt(dot(direction, direction))
    toward = direction[0] / length, direction[1] / length, direction[2] / length
    start = minus(origin, torus.center)
    middle = -dot(start, toward)
    x, y, z = along(start, toward, middle)
    major, minor = torus.major, torus.minor
    square = x * x + y * y + z * z
    room = (major + minor) ** 2 - square
    if room < 0.0:
        return 0
    k, four = square + major * major - minor * minor, 4.0 * major * major
    p = 2.0 * k - four * (toward[0] * toward[0] + toward[1] * toward[1])
    q = -2.0 * four * (x * toward[0] + y * toward[1])
    c = k * k - four * (x * x + y * y)
    end = 1.0000001 * math.sqrt(room)
    low, at_low, count = -end, 1.0, 0
    first, second, third = extremes(p, q)
    for place in (first, second, third, end):
        high = min(max(place, low), end)
        at_high = quartic(p, q, c, high) if place < end else 1.0
        if (at_low > 0.0) != (at_high > 0.0) and high > low:
            # Next to an extreme, the polynomial is about a parabola.
            share = at_low / (at_low - at_high)
            if place == end:
                share = math.sqrt(share)
            elif low == -end:
                share = 1.0 - math.sqrt(1.0 - share)
            guess = low + share * (high - low)
            t[count] = (middle + quartic_root(p, q, c, low, high, guess)) / length
            count += 1
        low, at_low = high, at_high
    return count


def torus_normal(torus: Any, point: Any) -> Any:
    x, y, z = minus(point, torus.center)
    inward = torus.major / max(math.sqrt(x * x + y * y), 1e-300)
    return x - x * inward, y - y * inward, z


def torus_distance(torus: Any, point: Any) -> float:
    x, y, z = minus(point, torus.center)
    beside = math.sqrt(x * x + y * y) - torus.major
    return math.sqrt(beside * beside + z * z) - torus.minor


# Fields of distances


@numba.njit
def segment_distance(a: Any, b: Any, point: Any) -> float:
    line, place = minus(b, a), minus(point, a)
    share = min(max(dot(place, line) / max(dot(line, line), 1e-300), 0.0), 1.0)
    beside = minus(place, (share * line[0], share * line[1], share * line[2]))
    return math.sqrt(dot(beside, beside))


@numba.njit
def curve_distance(points: Any, point: Any) -> float:
    """From a quadratic Bezier curve: the best of nine places, improved by Newton's method."""
    best, place = 1e300, 0.0
    a, b, c = minus(points[0], point), minus(points[1], point), minus(points[2], point)
    for k in range(9):
        s = k / 8.0
        x, y, z = along(
            along(
                ((1 - s) ** 2 * a[0], (1 - s) ** 2 * a[1], (1 - s) ** 2 * a[2]), b, 2 * s * (1 - s)
            ),
            c,
            s * s,
        )
        if x * x + y * y + z * z < best:
            best, place = x * x + y * y + z * z, s
    speed = 2.0 * (b[0] - a[0]), 2.0 * (b[1] - a[1]), 2.0 * (b[2] - a[2])
    bend = a[0] - 2 * b[0] + c[0], a[1] - 2 * b[1] + c[1], a[2] - 2 * b[2] + c[2]
    s = place
    for _ in range(8):
        at = along(along(a, speed, s), bend, s * s)
        turn = along(speed, bend, 2.0 * s)
        slope = dot(turn, turn) + 2.0 * dot(at, bend)
        if slope > 0.0:
            s = min(max(s - dot(at, turn) / slope, 0.0), 1.0)
    at = along(along(a, speed, s), bend, s * s)
    return math.sqrt(min(best, dot(at, at)))


@numba.njit
def box_distance(center: Any, half: Any, rounding: float, point: Any) -> float:
    x, y, z = minus(point, center)
    x, y, z = abs(x) - half[0] + rounding, abs(y) - half[1] + rounding, abs(z) - half[2] + rounding
    outer = max(x, 0.0), max(y, 0.0), max(z, 0.0)
    return math.sqrt(dot(outer, outer)) + min(max(max(x, y), z), 0.0) - rounding


def traced(distance: Any) -> Any:
    """The intersection of a field of distances: steps along the line by these, all the way."""
    measure = numba.njit(distance)

    def hits(shape: Any, origin: Any, direction: Any, span: Any, t: Any) -> int:
        length = math.sqrt(dot(direction, direction))
        at, count = span[0], 0
        before = measure(shape, along(origin, direction, at))
        least = 1e-4 * (span[1] - span[0]) + 1e-12 * abs(at)
        while at < span[1] and count < len(t):
            following = min(at + max(abs(before) / length, least), span[1])
            after = measure(shape, along(origin, direction, following))
            if (before < 0.0) != (after < 0.0):
                low, high = at, following
                for _ in range(60):
                    middle = 0.5 * (low + high)
                    is_behind = (measure(shape, along(origin, direction, middle)) < 0.0) == (
                        after < 0.0
                    )
                    low, high = (low, middle) if is_behind else (middle, high)
                t[count] = high
                count += 1
            at, before = following, after
        return count

    return hits


def capsule_bounds(capsule: Any) -> Any:
    (a, b, c), (d, e, f), r = capsule.a, capsule.b, capsule.radius
    low = min(a, d) - r, min(b, e) - r, min(c, f) - r
    return low, (max(a, d) + r, max(b, e) + r, max(c, f) + r)


def capsule_distance(capsule: Any, point: Any) -> float:
    return segment_distance(capsule.a, capsule.b, point) - capsule.radius


def curve_bounds(curve: Any) -> Any:
    (a, b, c), (d, e, f), (g, h, i) = curve.points[0], curve.points[1], curve.points[2]
    r = curve.radius
    low = min(a, d, g) - r, min(b, e, h) - r, min(c, f, i) - r
    return low, (max(a, d, g) + r, max(b, e, h) + r, max(c, f, i) + r)


def tube_distance(curve: Any, point: Any) -> float:
    return curve_distance(curve.points, point) - curve.radius


def box_bounds(box: Any) -> Any:
    return around(box.center, box.half[0], box.half[1], box.half[2])


def rounded_distance(box: Any, point: Any) -> float:
    return box_distance(box.center, box.half, box.round, point)


# Surfaces


def disc_bounds(disc: Any) -> Any:
    x, y, z = disc.normal
    square, r = x * x + y * y + z * z, disc.radius
    return around(
        disc.center,
        r * math.sqrt(max(1.0 - x * x / square, 0.0)),
        r * math.sqrt(max(1.0 - y * y / square, 0.0)),
        r * math.sqrt(max(1.0 - z * z / square, 0.0)),
    )


def disc_hits(disc: Any, origin: Any, direction: Any, span: Any, t: Any) -> int:
    facing = dot(disc.normal, direction)
    if facing == 0.0:
        return 0
    start = minus(disc.center, origin)
    t[0] = dot(disc.normal, start) / facing
    beside = minus(along(origin, direction, t[0]), disc.center)
    return 1 if dot(beside, beside) <= disc.radius * disc.radius else 0


def disc_normal(disc: Any, point: Any) -> Any:
    return disc.normal[0], disc.normal[1], disc.normal[2]


def quadric_bounds(quadric: Any) -> Any:
    return around(quadric.center, quadric.half, quadric.half, quadric.half)


def quadric_hits(quadric: Any, origin: Any, direction: Any, span: Any, t: Any) -> int:
    start = minus(origin, quadric.center)
    (a, b, c), (x, y, z), (dx, dy, dz) = quadric.factors, start, direction
    square = a * dx * dx + b * dy * dy + c * dz * dz
    half = a * x * dx + b * y * dy + c * z * dz
    rest = a * x * x + b * y * y + c * z * z - quadric.constant
    inside = half * half - square * rest
    if inside < 0.0:
        return 0
    stable = -half - math.copysign(math.sqrt(inside), half)
    count = 0
    if square != 0.0:
        t[count] = stable / square
        count += 1
    if stable != 0.0:
        t[count] = rest / stable
        count += 1
    return count


def quadric_normal(quadric: Any, point: Any) -> Any:
    x, y, z = minus(point, quadric.center)
    return quadric.factors[0] * x, quadric.factors[1] * y, quadric.factors[2] * z


ball = rs.Shape(ball_bounds, ball_hits, ball_distance, ball_normal, name="ball")
bitten = rs.Shape(bitten_bounds, bitten_hits, normal=bitten_normal, hits=4, name="bitten")
torus = rs.Shape(torus_bounds, torus_hits, torus_distance, torus_normal, hits=4, name="torus")
capsule = rs.Shape(capsule_bounds, traced(capsule_distance), capsule_distance, name="capsule")
tube = rs.Shape(curve_bounds, traced(tube_distance), tube_distance, hits=8, name="tube")
rounded = rs.Shape(box_bounds, traced(rounded_distance), rounded_distance, name="rounded")
disc = rs.Shape(disc_bounds, disc_hits, normal=disc_normal, hits=1, name="disc")
quadric = rs.Shape(quadric_bounds, quadric_hits, normal=quadric_normal, name="quadric")


# Cases: some shapes of each kind, and a mesh of the surface of one


def _places(rng: Any, count: int, kind: np.dtype[Any], **columns: Any) -> np.ndarray:
    records = np.zeros(count, kind)
    for name, one in columns.items():
        records[name] = one
    if "center" in records.dtype.names:
        records["center"] = rng.uniform(-4.0, 4.0, (count, 3))
    return records


def balls(rng: Any, count: int) -> np.ndarray:
    return _places(rng, count, BALL, radius=rng.uniform(0.3, 1.0, count))


def bitten_balls(rng: Any, count: int) -> np.ndarray:
    records = _places(rng, count, BITTEN, radius=1.0, bite_radius=0.8)
    records["bite"] = records["center"] + rng.uniform(0.3, 0.6, (count, 3))
    return records


def tori(rng: Any, count: int) -> np.ndarray:
    return _places(
        rng, count, TORUS, major=rng.uniform(0.8, 1.2, count), minor=rng.uniform(0.2, 0.5, count)
    )


def capsules(rng: Any, count: int) -> np.ndarray:
    records = _places(rng, count, CAPSULE, radius=rng.uniform(0.2, 0.5, count))
    records["a"] = rng.uniform(-4.0, 4.0, (count, 3))
    records["b"] = records["a"] + rng.uniform(-1.0, 1.0, (count, 3))
    return records


def tubes(rng: Any, count: int) -> np.ndarray:
    records = _places(rng, count, CURVE, radius=0.15)
    middle, half = rng.uniform(-4.0, 4.0, (count, 1, 3)), rng.uniform(-1.0, 1.0, (count, 1, 3))
    bends = rng.uniform(-0.3, 0.3, (count, 3, 3))
    records["points"] = middle + half * np.array([[-1.0], [0.0], [1.0]]) + bends
    return records


def rounded_boxes(rng: Any, count: int) -> np.ndarray:
    return _places(rng, count, BOX, half=rng.uniform(0.4, 0.9, (count, 3)), round=0.2)


def discs(rng: Any, count: int) -> np.ndarray:
    return _places(rng, count, DISC, normal=rng.normal(size=(count, 3)), radius=0.8)


def hyperboloids(rng: Any, count: int) -> np.ndarray:
    return _places(rng, count, QUADRIC, factors=[2.0, 2.0, -1.0], constant=0.5, half=1.0)


def _grid(points: Any, rows: int, columns: int, rows_close: bool = True) -> rs.Scene:
    """A mesh of a surface: `points` of two arrays in [0, 1]; the second one goes round."""
    u, v = np.meshgrid(np.linspace(0.0, 1.0, rows), np.linspace(0.0, 1.0, columns), indexing="ij")
    vertices = points(u, v).reshape(-1, 3)
    a = (np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)).ravel()
    b, c, d = a + 1, a + columns + 1, a + columns
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    return rs.Scene.from_arrays(vertices, faces)


def _turned(radius: Any, height: Any, v: Any) -> np.ndarray:
    angle = 2.0 * np.pi * v
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), height + 0.0 * angle], -1)


def _unit(u: Any, v: Any) -> np.ndarray:
    return _turned(np.sin(np.pi * u), np.cos(np.pi * u), v)


def ball_mesh(ball: Any, n: int) -> rs.Scene:
    return _grid(lambda u, v: ball["center"] + ball["radius"] * _unit(u, v), n, 2 * n)


def torus_mesh(torus: Any, n: int) -> rs.Scene:
    def points(u: Any, v: Any) -> np.ndarray:
        radius = torus["major"] + torus["minor"] * np.cos(2.0 * np.pi * u)
        return torus["center"] + _turned(radius, torus["minor"] * np.sin(2.0 * np.pi * u), v)

    return _grid(points, n, 2 * n)


def _across(axis: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    first = np.cross(axis, np.eye(3)[np.abs(axis).argmin()])
    first /= np.linalg.norm(first)
    return first, np.cross(axis, first)


def capsule_mesh(capsule: Any, n: int) -> rs.Scene:
    axis = capsule["b"] - capsule["a"]
    axis = axis / np.linalg.norm(axis)
    frame = np.array([*_across(axis), axis])

    def points(u: Any, v: Any) -> np.ndarray:
        ends = np.where((u < 0.5)[..., None], capsule["b"], capsule["a"])
        return ends + capsule["radius"] * (_unit(u, v) @ frame)

    return _grid(points, 2 * n, 2 * n)


def tube_mesh(tube: Any, n: int) -> rs.Scene:
    a, b, c = tube["points"]

    def points(u: Any, v: Any) -> np.ndarray:
        # The ends are half balls, as the curve's field of distances has them.
        s = np.clip((u - 0.25) * 2.0, 0.0, 1.0)[..., None]
        at = (1 - s) ** 2 * a + 2 * s * (1 - s) * b + s * s * c
        speed = (1 - s) * (b - a) + s * (c - b)
        speed /= np.linalg.norm(speed, axis=-1, keepdims=True)
        first = np.cross(speed, np.eye(3)[np.abs(np.cross(b - a, c - b)).argmax()])
        first /= np.linalg.norm(first, axis=-1, keepdims=True)
        second, end = np.cross(speed, first), np.clip(np.abs(u - 0.5) * 4.0 - 1.0, 0.0, 1.0)
        tilt, angle = (end * np.pi / 2)[..., None], (2.0 * np.pi * v)[..., None]
        around = np.cos(angle) * first + np.sin(angle) * second
        side = np.where(u < 0.5, -1.0, 1.0)[..., None]
        return at + tube["radius"] * (np.cos(tilt) * around + side * np.sin(tilt) * speed)

    return _grid(points, 8 * n + 1, 2 * n)


def rounded_mesh(box: Any, n: int) -> rs.Scene:
    def points(u: Any, v: Any) -> np.ndarray:
        unit = _unit(u, v)
        corner = np.where(np.abs(unit) < 1e-9, 0.0, np.sign(unit))
        return box["center"] + corner * (box["half"] - box["round"]) + box["round"] * unit

    return _grid(points, 4 * n + 1, 8 * n + 1)


def disc_mesh(disc: Any, n: int) -> rs.Scene:
    axis = disc["normal"] / np.linalg.norm(disc["normal"])
    frame = np.array([*_across(axis), axis])
    return _grid(
        lambda u, v: disc["center"] + _turned(u * disc["radius"], 0.0 * u, v) @ frame, 2, 4 * n
    )


def hyperboloid_mesh(quadric: Any, n: int) -> rs.Scene:
    def points(u: Any, v: Any) -> np.ndarray:
        z = (2.0 * u - 1.0) * quadric["half"]
        radius = np.sqrt((quadric["constant"] + z * z) / quadric["factors"][0])
        return quadric["center"] + _turned(radius, z, v)

    return _grid(points, 2 * n, 2 * n)


def bitten_mesh(ball: Any, n: int) -> rs.Scene:
    """Both caps meet in a circle, across the line of the centres."""
    axis = ball["bite"] - ball["center"]
    apart = np.linalg.norm(axis)
    frame = np.array([*_across(axis / apart), axis / apart])
    r, s = ball["radius"], ball["bite_radius"]
    outer = np.arccos((apart**2 + r**2 - s**2) / (2.0 * apart * r))
    inner = np.pi - np.arccos((apart**2 + s**2 - r**2) / (2.0 * apart * s))

    def points(u: Any, v: Any) -> np.ndarray:
        k = np.clip(u * 2.0, 0.0, 1.0)
        angle = np.where(u < 0.5, np.pi + k * (outer - np.pi), 0.0)
        one = ball["center"] + r * (_turned(np.sin(angle), np.cos(angle), v) @ frame)
        angle = inner + (np.pi - inner) * np.clip(u * 2.0 - 1.0, 0.0, 1.0)
        other = ball["bite"] + s * (_turned(np.sin(angle), np.cos(angle), v) @ frame)
        return np.where((u < 0.5)[..., None], one, other)

    return _grid(points, 4 * n + 1, 4 * n)


#: Shape, some records of it, and the mesh of one.
CASES = {
    "ball": (ball, balls, ball_mesh),
    "bitten": (bitten, bitten_balls, bitten_mesh),
    "torus": (torus, tori, torus_mesh),
    "capsule": (capsule, capsules, capsule_mesh),
    "tube": (tube, tubes, tube_mesh),
    "rounded": (rounded, rounded_boxes, rounded_mesh),
    "disc": (disc, discs, disc_mesh),
    "quadric": (quadric, hyperboloids, hyperboloid_mesh),
}


def some(names: Any, seed: int = 0, count: int = 20, offset: float = 0.0) -> rs.Scene:
    """A scene of some shapes of kinds."""
    scenes = []
    for name in names:
        shape, make, _ = CASES[name]
        records = make(np.random.default_rng(seed), count)
        for place in ("center", "bite", "a", "b", "points"):
            if place in records.dtype.names:
                records[place] += offset
        scenes.append(rs.Scene.shapes(shape, records))
    return rs.Scene.combine(scenes)


def rays_near(rng: Any, count: int, offset: float = 0.0) -> dict[str, Any]:
    """Rays from anywhere to anywhere; some along axes, limited, or very long or short."""
    origins = rng.uniform(-6.0, 6.0, (count, 3)) + offset
    directions = rng.uniform(-4.0, 4.0, (count, 3)) + offset - origins
    kind = rng.integers(0, 6, count)
    axes = np.eye(3)[rng.integers(0, 3, count)] * rng.choice([-1.0, 1.0], count)[:, None]
    directions[kind == 0] = axes[kind == 0]
    directions[kind == 1] *= 10.0 ** rng.uniform(-20, 20, (count, 1))[kind == 1]
    t_min, t_max = np.zeros(count, np.float32), np.full(count, np.inf, np.float32)
    t_min[kind == 2], t_max[kind == 3] = -np.inf, 1.0
    return {"origins": origins, "directions": directions, "t_min": t_min, "t_max": t_max}

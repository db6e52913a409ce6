"""Polygons of files: triangles that cover them, once, and nothing else."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import raystream as rs
from raystream.core.errors import RaystreamWarning
from raystream.scene.io.ear_clipping import clip_ears
from raystream.scene.io.polygons import Cut, cut_polygons

ANGLES = np.pi * (0.5 + np.arange(10) / 5)
RADII = np.tile([1.0, 0.3], 5)
STAR = np.stack([RADII * np.cos(ANGLES), RADII * np.sin(ANGLES), np.zeros(10)], axis=1)

#: A square of side 6 with a hole of side 2: an edge leads to it, and the same edge back.
HOLED = [(0, 0), (6, 0), (6, 6), (0, 6), (0, 0), (2, 2), (2, 4), (4, 4), (4, 2), (2, 2)]

#: From the file's up to a steep plane that no axis is along.
TURNS = {
    "z up": np.eye(3),
    "z down": np.diag([1.0, -1.0, -1.0]),
    "x up": np.eye(3)[[2, 0, 1]],
    "y down": np.array([[1.0, 0, 0], [0, 0, 1], [0, 1, 0]]),
    "steep": np.array([[2.0, -1, 2], [2, 2, -1], [-1, 2, 2]]) / 3,
}


def obj(polygons: Sequence[np.ndarray]) -> bytes:
    lines, count = [], 0
    for polygon in polygons:
        lines += [f"v {x!r} {y!r} {z!r}" for x, y, z in polygon.tolist()]
        lines.append("f " + " ".join(str(count + k + 1) for k in range(len(polygon))))
        count += len(polygon)
    return "\n".join(lines).encode()


def _listed(polygons: Sequence[np.ndarray]) -> tuple[str, str, int]:
    rows = "".join(f"{x!r} {y!r} {z!r}\n" for x, y, z in np.concatenate(polygons).tolist())
    firsts = np.cumsum([0, *map(len, polygons)]).tolist()
    faces = "".join(
        f"{len(polygon)} {' '.join(str(first + k) for k in range(len(polygon)))}\n"
        for polygon, first in zip(polygons, firsts, strict=False)
    )
    return rows, faces, firsts[-1]


def ply(polygons: Sequence[np.ndarray]) -> bytes:
    rows, faces, count = _listed(polygons)
    axes = "".join(f"property double {axis}\n" for axis in "xyz")
    head = f"ply\nformat ascii 1.0\nelement vertex {count}\n{axes}element face {len(polygons)}\n"
    list_line = "property list uchar int vertex_indices\nend_header\n"
    return (head + list_line + rows + faces).encode()


def off(polygons: Sequence[np.ndarray]) -> bytes:
    rows, faces, count = _listed(polygons)
    return f"OFF\n{count} {len(polygons)} 0\n{rows}{faces}".encode()


def aff(polygons: Sequence[np.ndarray]) -> bytes:
    words = ["v from 0 0 9 at 0 0 0 up 0 1 0 angle 40 hither 1 resolution 8 8"]
    for polygon in polygons:
        words.append(f"p {len(polygon)}")
        words += [f"{x!r} {y!r} {z!r}" for x, y, z in polygon.tolist()]
    return "\n".join(words).encode()


FORMATS = {"obj": obj, "ply": ply, "off": off, "nff": aff}


def read(folder: Path, suffix: str, polygons: Sequence[np.ndarray]) -> rs.Scene:
    path = folder / f"polygons.{suffix}"
    path.write_bytes(FORMATS[suffix](polygons))
    return rs.load(path)


def flat(corners: Sequence[tuple[float, float]]) -> np.ndarray:
    return np.array([(x, y, 0.0) for x, y in corners])


def cut(*polygons: np.ndarray) -> Cut:
    counts = np.array([len(polygon) for polygon in polygons])
    corners = np.concatenate(polygons)
    return cut_polygons(counts, np.cumsum(counts) - counts, np.arange(len(corners)), corners)


def normals_of(corners: np.ndarray) -> np.ndarray:
    """Normals of triangles, as long as their areas."""
    return np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) / 2


def newell(polygon: np.ndarray) -> np.ndarray:
    """The normal of a polygon, as long as its area."""
    return np.cross(polygon, np.roll(polygon, -1, axis=0)).sum(axis=0) / 2


def check_cover(triangles: np.ndarray, polygon: np.ndarray) -> None:
    """Triangles face as the polygon does, and have its area together."""
    assert len(triangles) == len(polygon) - 2
    normal = newell(polygon)
    area = np.linalg.norm(normal)
    along = normals_of(triangles) @ normal / area
    assert along.min() >= -1e-12 * area
    np.testing.assert_allclose(np.linalg.norm(normals_of(triangles), axis=1).sum(), area)


@pytest.mark.parametrize("suffix", FORMATS)
def test_a_star_has_its_area_and_is_not_hit_beside(tmp_path: Path, suffix: str) -> None:
    scene = read(tmp_path, suffix, [STAR])
    (mesh,) = scene.meshes
    areas = np.linalg.norm(normals_of(mesh.vertices[mesh.faces].astype(float)), axis=1)
    np.testing.assert_allclose(areas.sum(), 5 * 0.3 * np.sin(np.pi / 5), rtol=1e-6)
    tracer = rs.Tracer(scene)
    between = 0.6 * np.stack([np.cos(ANGLES), np.sin(ANGLES), np.zeros(10)], axis=1)
    origins = between + [0.0, 0.0, 5.0]
    hits = tracer.first_hit(origins, [0.0, 0.0, -1.0])
    assert hits.is_hit.tolist() == [True, False] * 5  # on the points, and between them
    assert hits.face_id.tolist() == [0, -1] * 5
    assert tracer.count_hits(origins, [0.0, 0.0, -1.0], crossings="surfaces").tolist() == [1, 0] * 5


@pytest.mark.parametrize("turn", TURNS)
@pytest.mark.parametrize("shift", range(10))
def test_a_star_in_any_plane_from_any_corner(turn: str, shift: int) -> None:
    for star in (STAR, STAR[::-1]):
        polygon = np.roll(star, shift, axis=0) @ TURNS[turn].T + [5.0, -3.0, 700.0]
        found = cut(polygon)
        assert found.crossed_count == 0
        check_cover(polygon[found.corners], polygon)


@pytest.mark.parametrize("suffix", FORMATS)
def test_a_bridged_hole_stays_open(tmp_path: Path, suffix: str) -> None:
    scene = read(tmp_path, suffix, [flat(HOLED)])
    points = np.stack(np.meshgrid(np.arange(6) + 0.4, np.arange(6) + 0.7), axis=-1).reshape(-1, 2)
    origins = np.concatenate([points, np.ones((36, 1))], axis=1)
    counts = rs.Tracer(scene).count_hits(origins, [0.0, 0.0, -1.0])
    in_hole = ((points > 2) & (points < 4)).all(axis=1)
    assert counts.tolist() == np.where(in_hole, 0, 1).tolist()


@pytest.mark.parametrize("turn", TURNS)
@pytest.mark.parametrize("shift", range(4))
def test_concave_quads_take_the_right_diagonal(turn: str, shift: int) -> None:
    arrow = flat([(0, 0), (4, 3), (0, 1), (-4, 3)])
    for quad in (arrow, arrow[::-1]):
        polygon = np.roll(quad, shift, axis=0) @ TURNS[turn].T
        found = cut(polygon)
        check_cover(polygon[found.corners], polygon)
        notch = int(np.argmin(np.abs(polygon - TURNS[turn] @ [0.0, 1.0, 0.0]).sum(axis=1)))
        assert all(notch in corners for corners in found.corners.tolist())


def test_where_the_fan_is_right_it_stays() -> None:
    """From its notch, an arrow is a fan; so are convex polygons, with corners in line or not."""
    arrow = flat([(0, 1), (-4, 3), (0, 0), (4, 3)])
    line = flat([(0, 0), (1, 0), (2, 0), (2, 2), (1, 2), (0, 2), (0, 1)])
    round_ = STAR[::2]
    rounded = (np.roll(line, 2, axis=0) @ TURNS["steep"].T).astype(np.float32).astype(float)
    warped = flat([(0, 0), (1, 0), (1, 1), (0, 1)]) + [
        [0.0, 0, 0],
        [0, 0, 0.3],
        [0, 0, 0],
        [0, 0, 0.3],
    ]
    for polygon in (arrow, line, round_, rounded, warped):
        steps = np.arange(1, len(polygon) - 1)
        fan = np.stack([0 * steps, steps, steps + 1], axis=1)
        assert cut(polygon).corners.tolist() == fan.tolist()


def test_corners_in_line_and_corners_given_twice() -> None:
    step = flat([(0, 0), (1, 0), (2, 0), (3, 0), (3, 1), (2, 1), (1, 1), (1, 2), (1, 3), (0, 3)])
    twice = np.repeat(step, 2, axis=0)
    for polygon in (step, twice):
        for shift in range(len(polygon)):
            rolled = np.roll(polygon, shift, axis=0)
            found = cut(rolled)
            assert found.crossed_count == 0
            check_cover(rolled[found.corners], rolled)


@pytest.mark.parametrize("suffix", FORMATS)
def test_outlines_that_cross_themselves_are_fans_with_one_warning(
    tmp_path: Path, suffix: str
) -> None:
    bow_tie = flat([(0, 0), (2, 2), (2, 0), (0, 2)])
    lopsided = flat([(0, 0), (2, 2), (2, 0), (0, 1)])
    pentagram = STAR[::2][[0, 2, 4, 1, 3]]
    polygons = [bow_tie, lopsided, STAR, pentagram]
    with pytest.warns(RaystreamWarning, match=rf"polygons\.{suffix}: 3 polygons .*cross") as caught:
        scene = read(tmp_path, suffix, polygons)
    assert len(caught) == 1
    corners = np.concatenate([mesh.vertices[mesh.faces] for mesh in scene.meshes])
    assert len(corners) == 2 + 2 + 8 + 3
    np.testing.assert_array_equal(corners[:2], bow_tie[[[0, 1, 2], [0, 2, 3]]])
    np.testing.assert_array_equal(corners[2:4], lopsided[[[0, 1, 2], [0, 2, 3]]])
    np.testing.assert_array_equal(corners[-3:], pentagram[[[0, 1, 2], [0, 2, 3], [0, 3, 4]]])


def test_what_cannot_be_a_polygon_is_a_fan_without_a_word() -> None:
    """With no area, not finite, or with vertices that do not exist."""
    nothing = flat([(0, 0), (1, 0), (2, 0), (1, 0)])
    endless = flat([(0, 0), (4, 3), (0, 1), (np.inf, 3)])
    unknown = flat([(0, 0), (np.nan, 3), (0, 1), (-4, 3)])
    for polygon in (nothing, endless, unknown):
        assert cut(polygon).corners.tolist() == [[0, 1, 2], [0, 2, 3]]
        assert cut(polygon).crossed_count == 0
    found = cut_polygons(
        np.array([4]), np.array([0]), np.array([0, 1, 2, 9]), flat([(4, 3), (0, 1), (-4, 3)])
    )
    assert found.corners.tolist() == [[0, 1, 2], [0, 2, 3]]


def test_spirals_and_combs_with_many_corners() -> None:
    angles = np.linspace(0.0, 12 * np.pi, 400)
    arm = np.stack([angles * np.cos(angles), angles * np.sin(angles)], axis=1)
    spiral = flat([*arm, *(arm * (1 + 1 / (1 + angles[:, None])))[::-1]])
    teeth = np.arange(200)
    comb = flat([*zip(teeth, np.where(teeth % 2, 9, 1), strict=True), (199, 0), (0, 0)])
    found = cut(spiral, comb, spiral[:, [1, 0, 2]])
    assert found.crossed_count == 0
    corners = np.concatenate([spiral, comb, spiral[:, [1, 0, 2]]])[found.corners]
    for number, polygon in enumerate((spiral, comb, spiral[:, [1, 0, 2]])):
        check_cover(corners[found.polygon_ids == number], polygon)


def test_neighbouring_ears_at_the_end_of_an_odd_outline() -> None:
    """Of an outline that touches itself: the last two corners alone are ears."""
    polygon = flat([(0, -1), (-2, 3), (1, -3), (-3, 1), (-1, 0)])
    triangles, is_cut = clip_ears(polygon, np.array([5]))
    assert len(triangles) == 3 * is_cut[0]


def test_polygons_with_too_many_pairs_are_left(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("raystream.scene.io.ear_clipping._MAX_PAIRS", -256 * 10 - 1)
    assert cut(STAR).crossed_count == 1


@st.composite
def simple_polygons(draw: st.DrawFn) -> list[tuple[int, int]]:
    """A triangle that grows a corner at a time, on a lattice: many corners are in line."""
    polygon = [(0, 0), (3, 0), (0, 3)]
    lattice = st.integers(-6, 6)
    for at, x, y in draw(st.lists(st.tuples(st.integers(0, 99), lattice, lattice), max_size=40)):
        k = at % len(polygon)
        ring = [*polygon[k + 1 :], *polygon[: k + 1]]  # the edge from the last to the first
        if all(
            not _touch(edge, other)
            for edge in ((ring[-1], (x, y)), ((x, y), ring[0]))
            for other in pairwise(ring)
            if not set(edge) & set(other)
        ) and _is_apart(ring, (x, y)):
            polygon.insert(k + 1, (x, y))
    return polygon


def _turn(a: tuple[int, int], b: tuple[int, int], c: tuple[int, int]) -> int:
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])


def _is_on(a: tuple[int, int], b: tuple[int, int], c: tuple[int, int]) -> bool:
    """Whether c lies on the edge from a to b."""
    return (
        _turn(a, b, c) == 0
        and min(a[0], b[0]) <= c[0] <= max(a[0], b[0])
        and min(a[1], b[1]) <= c[1] <= max(a[1], b[1])
    )


def _touch(edge: tuple, other: tuple) -> bool:
    (a, b), (c, d) = edge, other
    if any((_is_on(a, b, c), _is_on(a, b, d), _is_on(c, d, a), _is_on(c, d, b))):
        return True
    across = (_turn(a, b, c) > 0) != (_turn(a, b, d) > 0)
    return across and (_turn(c, d, a) > 0) != (_turn(c, d, b) > 0)


def _is_apart(ring: list[tuple[int, int]], new: tuple[int, int]) -> bool:
    """Whether a new corner between the ring's last and first one doubles back on no edge."""
    first, second, before, last = ring[0], ring[1], ring[-2], ring[-1]
    if new in ring or _is_on(new, first, second) or _is_on(first, second, new):
        return False
    if _is_on(last, new, before) or _is_on(before, last, new):
        return False
    return not (_is_on(last, new, first) or _is_on(new, first, last))


def _is_inside(polygon: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Whether points are inside a polygon, by how often rays along x cross it."""
    (ax, ay), (bx, by) = polygon.T, np.roll(polygon, -1, axis=0).T
    x, y = points[:, 0, None], points[:, 1, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        at = ax + (y - ay) * (bx - ax) / (by - ay)
    return (((ay > y) != (by > y)) & (at > x)).sum(axis=1) % 2 == 1


@given(
    st.lists(simple_polygons(), min_size=1, max_size=3),
    st.sampled_from(sorted(TURNS)),
    st.sampled_from([(1.0, 0.0), (1e-6, 1.0), (1e6, -3e7), (0.1, 0.3)]),
    st.booleans(),
)
def test_any_simple_polygon_is_covered_once(
    outlines: list[list[tuple[int, int]]], turn: str, placed: tuple[float, float], swap: bool
) -> None:
    scale, offset = placed
    for outline in outlines:
        if swap:
            outline.reverse()
    polygons = [flat(outline) @ TURNS[turn].T * scale + offset for outline in outlines]
    found = cut(*polygons)
    assert found.crossed_count == 0
    firsts = np.cumsum([0, *map(len, polygons)])
    steps = np.arange(-6, 6)
    points = np.stack(np.meshgrid(steps + 0.4321, steps + 0.5717), axis=-1).reshape(-1, 2)
    for number, outline in enumerate(outlines):
        corners = found.corners[found.polygon_ids == number] - firsts[number]
        shape = np.array(outline, float)
        areas = np.linalg.norm(normals_of(flat(outline)[corners]), axis=1)
        x, y = shape.T
        shoelace = abs(np.dot(x, np.roll(y, -1)) - np.dot(y, np.roll(x, -1))) / 2
        np.testing.assert_allclose(areas.sum(), shoelace, rtol=1e-12)
        covered = sum(_is_inside(shape[triangle], points).astype(int) for triangle in corners)
        np.testing.assert_array_equal(covered, _is_inside(shape, points).astype(int))


@given(st.lists(st.tuples(st.integers(-5, 5), st.integers(-5, 5)), min_size=4, max_size=9))
def test_any_corners_give_triangles(corners: list[tuple[int, int]]) -> None:
    polygon = flat(corners)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        triangles, is_cut = clip_ears(polygon, np.array([len(corners)]))
    assert len(triangles) == (len(corners) - 2 if is_cut[0] else 0)
    found = cut(polygon)
    assert len(found.corners) == len(corners) - 2
    assert found.corners.min() >= 0
    assert found.corners.max() < len(corners)

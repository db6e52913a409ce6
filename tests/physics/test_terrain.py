"""Terrain: viewsheds and hillshades against closed forms, and lines of sight in float64."""

from __future__ import annotations

import math
import warnings

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import raystream as rs
from lines_of_sight import clearances
from raystream.physics import terrain as module

#: Lines that clear the ground by less may be reported either way, in parts of the terrain's size.
TOLERANCE = 2.0**-20


def grid(count, spacing):
    """x and y of the centres."""
    side = spacing * np.arange(count)
    return np.meshgrid(side, side)


def hills(count, seed=0, height=40.0):
    """A smooth random surface, with steep places."""
    rng = np.random.default_rng(seed)
    x, y = grid(count, 1.0)
    total = np.zeros((count, count))
    for _ in range(12):
        fx, fy = rng.normal(size=2) * 8 / count
        total += np.sin(fx * x + fy * y + rng.uniform(0, 6)) / 12
    return height * total + rng.normal(size=total.shape) * 0.2


# Viewsheds in closed form.


@pytest.mark.parametrize("slope", [(0.0, 0.0), (0.3, -0.2), (-2.0, 1.0)])
def test_all_of_a_plane_is_visible(slope):
    x, y = grid(60, 10.0)
    ground = rs.terrain(slope[0] * x + slope[1] * y + 100.0, spacing=10.0)
    for observer in ((0.0, 0.0), (300.0, 300.0), (123.4, 567.8)):
        assert ground.viewshed(observer, height=1.5).all()


@pytest.mark.parametrize("turn", range(4))
def test_behind_the_rim_of_a_step_the_ground_is_hidden(turn):
    x, _ = grid(80, 1.0)
    plateau = 20.0
    heights = np.rot90(np.where(x <= 30, plateau, 0.0), turn)
    ground = rs.terrain(heights)
    ex, ey, height = 12.25, 40.5, 15.0
    centre = 39.5
    rx, ry = ex - centre, ey - centre
    for _ in range(turn):  # as rot90 turns arrays whose rows are y
        rx, ry = ry, -rx
    visible = np.rot90(ground.viewshed((rx + centre, ry + centre), height), -turn)
    # The line over the rim at x = 30; the ground there is 20, and falls to 0 at 31.
    with np.errstate(divide="ignore"):
        part = (30 - ex) / (x - ex)
    over_rim = (plateau + height) + part * (0.0 - plateau - height) - plateau
    assert visible[x <= 30].all()
    beyond = x >= 31
    certain = np.abs(over_rim) > 1e-3
    assert (visible == (over_rim > 0))[beyond & certain].all()
    assert 0.2 < visible[beyond].mean() < 0.8


def test_from_below_only_the_rim_of_a_step_is_visible():
    x, _ = grid(60, 1.0)
    ground = rs.terrain(np.where(x >= 30, 10.0, 0.0))
    visible = ground.viewshed((5.0, 29.0), height=2.0)
    assert (visible == (x <= 30)).all()
    above = ground.viewshed((5.0, 29.0), height=10.5)
    assert above.all()
    signs = ground.viewshed((5.0, 29.0), height=2.0, target_height=30.0)  # masts on the plateau
    # The line passes the rim at x = 30 above 10, if it does.
    with np.errstate(divide="ignore"):
        at_rim = 2.0 + (30 - 5) / (x - 5) * (40.0 - 2.0)
    assert (signs == ((x <= 30) | (at_rim > 10.0))).all()


def dome(count, radius):
    """The cap of a sphere, and unit normals; all corners lie on the sphere."""
    side = np.linspace(-0.4 * radius, 0.4 * radius, count)
    x, y = np.meshgrid(side, side)
    z = np.sqrt(radius**2 - x**2 - y**2)
    return side, np.stack([x, y, z], axis=-1)


def test_the_horizon_of_a_hemisphere():
    radius, height = 1000.0, 20.0
    side, points = dome(101, radius)
    spacing = side[1] - side[0]
    ground = rs.terrain(
        points[..., 2],
        transform=(spacing, 0, side[0] - spacing / 2, 0, spacing, side[0] - spacing / 2),
    )
    assert np.allclose(ground.x, side)
    visible = ground.viewshed((0.0, 0.0), height)
    distance = np.linalg.norm(points[..., :2], axis=-1)
    horizon = radius * math.sin(math.acos(radius / (radius + height)))
    assert visible[distance < horizon - 1e-3].all()  # nothing of the mesh is outside the sphere
    # Chords lie up to spacing**2 / (4 * radius) below it, by which one sees farther.
    sag = spacing**2 / (4 * radius)
    lower = radius - sag
    farther = radius * math.sin(math.acos(lower / (radius + height)) + math.acos(lower / radius))
    assert not visible[distance > farther].any()
    assert farther < 1.3 * horizon
    assert 0.1 < visible.mean() < 0.6


def test_what_is_visible_of_a_cone():
    steep = 0.5
    x, y = grid(121, 1.0)
    x, y = x - 60, y - 60
    r = np.hypot(x, y)
    ground = rs.terrain(100.0 - steep * r)
    assert ground.viewshed((60.0, 60.0), height=0.5).all()  # from the top
    eye = np.array([-40.0, 10.0])
    visible = ground.viewshed(eye + 60, height=4.0)
    eye_z = ground.elevation(*(eye + 60)) + 4.0
    # The ground below a cone is convex: a point is visible if the eye is above its tangent plane.
    with np.errstate(invalid="ignore"):
        above = eye_z - (100.0 - steep * (x * eye[0] + y * eye[1]) / r)
    assert visible[above > 1e-3].all()
    assert not visible[above < -1.5].any()  # the triangles are up to about that far from planes
    assert 0.1 < visible.mean() < 0.9


# Viewsheds of any ground, by profiles.


def check_viewshed(heights, spacing, observer, options):
    ground = rs.terrain(heights, spacing=spacing)
    visible = ground.viewshed(observer, **options)
    eye = [*observer, float(ground.elevation(*observer)) + options["height"]]
    gap = clearances(heights, spacing, eye, options.get("target_height", 0.0))
    size = max(
        np.ptp(heights), spacing[0] * (heights.shape[1] - 1), spacing[1] * (heights.shape[0] - 1)
    )
    certain = np.abs(gap) > TOLERANCE * size
    assert (visible == (gap > 0))[certain].all()
    return int(certain.sum()), int((~certain).sum()), float(visible.mean())


@pytest.mark.parametrize("seed", range(3))
def test_viewsheds_agree_with_profiles(seed):
    rng = np.random.default_rng(seed)
    certain = doubtful = 0
    for height, target_height in ((0.5, 0.0), (3.0, 0.0), (3.0, 1.7)):
        options = {"height": height, "target_height": target_height}
        observer = rng.uniform(0, 79 * 2.0), rng.uniform(0, 79 * 3.0)
        some, few, mean = check_viewshed(hills(80, seed), (2.0, 3.0), observer, options)
        certain, doubtful = certain + some, doubtful + few
        assert 0.01 < mean < 0.95
    assert doubtful < 1e-3 * certain


@pytest.mark.exhaustive
def test_a_million_lines_of_sight_agree_with_profiles():
    certain = doubtful = 0
    for seed in range(100):
        rng = np.random.default_rng(seed)
        options = {"height": rng.uniform(0.3, 8.0), "target_height": rng.choice([0.0, 1.7])}
        observer = tuple(rng.uniform(0, 99 * 5.0, 2))
        some, few, _ = check_viewshed(
            hills(101, seed, height=rng.uniform(5, 200)), (5.0, 5.0), observer, options
        )
        certain, doubtful = certain + some, doubtful + few
    print(f"{certain:,} lines agree, {doubtful:,} clear the ground by less than the tolerance")  # noqa: T201
    assert certain + doubtful > 1e6
    assert doubtful < 1e-3 * certain


@settings(max_examples=40)
@given(
    rows=st.integers(2, 7),
    columns=st.integers(2, 7),
    data=st.data(),
    turned=st.tuples(st.booleans(), st.booleans()),
)
def test_a_turned_raster_has_the_same_viewshed(rows, columns, data, turned):
    values = data.draw(
        st.lists(st.integers(0, 5), min_size=rows * columns, max_size=rows * columns)
    )
    heights = np.array(values, float).reshape(rows, columns) + np.linspace(0, 1e-2, columns)
    observer = data.draw(st.floats(0.05, columns - 1.05)), data.draw(st.floats(0.05, rows - 1.05))
    plain = rs.terrain(heights)
    visible = plain.viewshed(observer, height=2.3)
    shade = plain.hillshade(30.0, 40.0)
    step_x, step_y = (-1.0 if one else 1.0 for one in turned)
    other = heights[:: int(step_y), :: int(step_x)]
    # The diagonals of the squares turn with the rows, unless both directions do.
    corner_x, corner_y = (0.0 if s > 0 else n - 1.0 for s, n in ((step_x, columns), (step_y, rows)))
    transform = (step_x, 0, corner_x - step_x / 2, 0, step_y, corner_y - step_y / 2)
    turned_ground = rs.terrain(other, transform=transform)
    back = turned_ground.hillshade(30.0, 40.0)[:: int(step_y), :: int(step_x)]
    assert np.allclose(back, shade, atol=1e-6)
    normals = np.cross(
        *np.diff(
            turned_ground.scene.meshes[0].vertices[turned_ground.scene.meshes[0].faces], axis=1
        ).transpose(1, 0, 2)
    )
    assert (normals[:, 2] > 0).all()  # front faces are above
    if step_x == step_y:
        height = 2.3 + float(plain.elevation(*observer) - turned_ground.elevation(*observer))
        again = turned_ground.viewshed(observer, height=height)
        size = max(rows, columns, np.ptp(heights))
        eye = [*observer, float(plain.elevation(*observer)) + 2.3]
        certain = np.abs(clearances(heights, (1.0, 1.0), eye)) > TOLERANCE * size
        assert (again[:: int(step_y), :: int(step_x)] == visible)[certain].all()


def test_far_cells_are_not_visible():
    x, y = grid(50, 2.0)
    visible = rs.terrain(np.zeros((50, 50)), spacing=2.0).viewshed(
        (40.0, 50.0), height=3.0, max_distance=30.0
    )
    distance = np.sqrt((x - 40) ** 2 + (y - 50) ** 2 + 9)
    assert (visible == (distance <= 30)).all()


def test_a_hole_hides_nothing_and_is_not_visible():
    x, y = grid(40, 1.0)
    wall = np.where(np.abs(x - 20) < 0.5, 10.0, 0.0)
    wall[18:23, 19:22] = np.nan  # a gap in the wall
    ground = rs.terrain(wall)
    visible = ground.viewshed((5.0, 20.0), height=2.0)
    assert not visible[18:23, 19:22].any()
    behind = visible[:, 25:]
    # Through the gap, whose edges are the wall's corners at y = 17 and 23, at x = 20.
    at_wall = 20 + (y[:, 25:] - 20) * (20 - 5) / (x[:, 25:] - 5)
    assert behind[np.abs(at_wall - 20) < 2.7].all()
    assert not behind[np.abs(at_wall - 20) > 3.1].any()


SURFACES = ("mesh", "height field")
NAN = np.nan


def across(row, turn=0, count=5):
    """A raster of equal rows, turned, and the place of a point of its middle row."""
    heights = np.rot90(np.tile(np.array(row, float), (count, 1)), turn)

    def place(column):
        cells = np.zeros((count, len(row)))
        cells[count // 2, column] = 1.0
        y, x = np.argwhere(np.rot90(cells, turn))[0]
        return 10.0 * x, 10.0 * y

    def middle(values):
        return np.rot90(values, -turn)[count // 2]

    return heights, place, middle


#: Rows of heights with the eye 10 above the first one; the cells that it sees, by hand.
HOLES = {
    "a plateau behind a hole": ([0, 0, 0, NAN, NAN, 100, 100, 100, 100], 0.0, "111..1000"),
    "masts on it": ([0, 0, 0, NAN, NAN, 100, 100, 100, 100], 8.0, "111..1000"),
    "high masts on it": ([0, 0, 0, NAN, NAN, 100, 100, 100, 100], 60.0, "111..1111"),
    "an island between holes": ([0, 0, NAN, 50, 50, NAN, 0, 0, 90], 0.0, "11.10.000"),
    "a low island": ([0, 0, NAN, 1, 1, NAN, 0, 0, 0], 0.0, "11.11.111"),
    "a plateau over a low island": ([0, 0, NAN, 1, 1, NAN, 80, 80, 80], 0.0, "11.11.100"),
    "a slope that falls to the hole": ([0, 0, NAN, NAN, 20, 40, 60, 80, 100], 0.0, "11..11111"),
    "a valley behind a hole": ([100, 90, NAN, NAN, 0, 0, 0, 0, 0], 0.0, "11..00111"),
    "a hole behind a ridge": ([0, 0, 100, NAN, NAN, 0, 0, 0, 0], 0.0, "111..0000"),
    "a hole at the ridge": ([0, 0, 0, NAN, NAN, 0, 0, 0, 0], 0.0, "111..1111"),
}


@pytest.mark.parametrize("surface", SURFACES)
@pytest.mark.parametrize("name", HOLES)
def test_lines_of_sight_do_not_pass_below_known_ground(name, surface):
    row, target_height, wanted = HOLES[name]
    for turn in range(4):
        heights, place, middle = across(row, turn)
        ground = rs.terrain(heights, spacing=10.0, surface=surface)
        seen = ground.viewshed(place(0), height=10.0, target_height=target_height)
        kinds = middle(np.where(seen.mask, 2, seen.data))
        assert "".join("01."[kind] for kind in kinds) == wanted, turn


@pytest.mark.parametrize("surface", SURFACES)
def test_a_plateau_behind_a_hole_is_hidden_on_a_curved_earth(surface):
    heights, place, middle = across([0, 0, 0, NAN, NAN, 100, 100, 100, 100])
    ground = rs.terrain(heights, spacing=10.0, surface=surface)
    seen = ground.viewshed(place(0), height=10.0, earth_radius=1e5, refraction=0.1)
    assert middle(seen).tolist() == [True] * 3 + [None] * 2 + [True] + [False] * 3


def check_past_holes(surface, seed):
    """Compare lines past random holes with profiles; returns how many, and hidden from below."""
    rng = np.random.default_rng(seed)
    heights = hills(60, seed, height=80.0)
    for _ in range(4):
        row, column = rng.integers(2, 45, 2)
        heights[row : row + rng.integers(1, 20), column : column + rng.integers(1, 20)] = np.nan
    windows = np.lib.stride_tricks.sliding_window_view(np.isnan(heights), (2, 2))
    squares = np.pad(~windows.any(axis=(2, 3)), 1)  # strips of one cell have no triangles
    heights[~(squares[1:, 1:] | squares[1:, :-1] | squares[:-1, 1:] | squares[:-1, :-1])] = np.nan
    ground = rs.terrain(heights, spacing=(2.0, 3.0), surface=surface)
    certain = below = 0
    for observer in rng.uniform(0, [118.0, 177.0], (6, 2)):
        if np.isnan(ground.elevation(*observer)):
            continue
        eye = [*observer, float(ground.elevation(*observer)) + 3.0]
        for target_height in (0.0, 1.0):
            seen = ground.viewshed(observer, height=3.0, target_height=target_height)
            gap = clearances(heights, (2.0, 3.0), eye, target_height)
            is_certain = ~np.isnan(heights) & (np.abs(gap) > TOLERANCE * 180.0)
            assert (seen.data == (gap > 0))[is_certain].all()
            certain += is_certain.sum()
        points = np.stack([*np.meshgrid(ground.x, ground.y), heights + 1.0], axis=-1)
        clear = ~ground.tracer.any_hit(eye, points - eye, t_max=1.0)  # of triangles
        below += (clear & ~seen.data)[is_certain].sum()
    return certain, below


@pytest.mark.parametrize("surface", SURFACES)
def test_viewsheds_past_holes_agree_with_profiles(surface):
    certain, below = np.sum([check_past_holes(surface, seed) for seed in range(4)], axis=0)
    assert certain > 100_000
    assert below > 50


@pytest.mark.exhaustive
def test_a_million_lines_past_holes_agree_with_profiles():
    found = [check_past_holes(SURFACES[seed % 2], seed) for seed in range(4, 50)]
    certain, below = np.sum(found, axis=0)
    assert certain > 1_000_000
    assert below > 1_000


#: Rows of heights, 10 apart; which cells are in shadow of a sun behind the last one, by hand.
SHADOWS = {
    "a plateau": ([0, 0, 0, NAN, NAN, 100, 100, 100, 100, 100, 100], 20.0, "000..111111"),
    "a plateau before a hole": ([0, 0, 0, NAN, NAN, 100, 100, 100, NAN], 20.0, "000..111."),
    "an island": ([0, 0, NAN, 30, 30, NAN, 0, 0], 15.0, "00.11.11"),
    "two cells of a shadow of 36 m": ([0, 0, 0, 0, NAN, NAN, 30, 30, 30, NAN], 40.0, "1110..111."),
    "a plain": ([0, 0, 0, NAN, NAN, 0, 0, NAN], 5.0, "111..11."),
}


@pytest.mark.parametrize("surface", SURFACES)
@pytest.mark.parametrize("name", SHADOWS)
def test_shadows_fall_across_holes(name, surface):
    row, altitude, wanted = SHADOWS[name]
    flat = np.float32(math.sin(math.radians(altitude)))
    for turn, azimuth in enumerate((90.0, 180.0, 270.0, 0.0)):  # rows run north
        heights, _, middle = across(row, turn)
        ground = rs.terrain(heights, spacing=10.0, surface=surface)
        shade = middle(ground.hillshade(azimuth, altitude, shadows=True))
        kinds = np.where(np.isnan(shade), 2, np.abs(shade - flat) < 1e-6)
        assert "".join("01."[kind] for kind in kinds) == wanted
        from_valley = middle(ground.hillshade(azimuth + 180.0, altitude, shadows=True))
        assert (np.isnan(from_valley) == np.isnan(row)).all()
        assert from_valley[0] == pytest.approx(flat)


def test_no_data_is_not_hidden():
    heights = across([0, 0, 0, NAN, NAN, 100, 100])[0]
    for dem in (heights, np.ma.MaskedArray(np.nan_to_num(heights), np.isnan(heights))):
        seen = rs.terrain(dem, spacing=10.0).viewshed((0.0, 20.0), height=10.0)
        assert seen[2].tolist() == [True, True, True, None, None, True, False]
        assert seen.mean() == 4 / 5
    marked = np.where(np.isnan(heights), -9999, heights).astype(np.int16)
    seen = rs.terrain(marked, spacing=10.0, nodata=-9999).viewshed((0.0, 20.0), height=10.0)
    assert (seen.mask == np.isnan(heights)).all()
    assert not seen.data[seen.mask].any()
    whole = rs.terrain(np.zeros((4, 4))).viewshed((1.0, 1.0), height=1.0)
    assert type(whole) is np.ndarray
    assert whole.dtype == bool


def test_bands_do_not_change_the_answer(monkeypatch):
    heights = hills(70, 5)
    ground = rs.terrain(heights)
    wanted = ground.viewshed((35.0, 35.0), height=3.0), ground.hillshade(shadows=True)
    monkeypatch.setattr(module, "_CELLS_PER_BAND", 150)
    reports = []
    visible = ground.viewshed((35.0, 35.0), height=3.0, progress=lambda *done: reports.append(done))
    assert (visible == wanted[0]).all()
    assert reports == [(2 * k, 70) for k in range(1, 36)]
    assert np.array_equal(ground.hillshade(shadows=True), wanted[1])

    def stop(done, total):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        ground.hillshade(progress=stop)


# Hillshades.


@pytest.mark.parametrize("slope", [(0.0, 0.0), (0.3, -0.2), (-1.5, 0.7)])
@pytest.mark.parametrize("sun", [(315.0, 45.0), (90.0, 10.0), (0.0, 90.0), (-135.0, 70.0)])
def test_the_shade_of_a_plane(slope, sun):
    x, y = grid(20, 5.0)
    ground = rs.terrain(slope[0] * x + slope[1] * y, spacing=5.0)
    azimuth, altitude = np.radians(sun)
    # As GIS have it: from slope and aspect.
    steep = math.atan(math.hypot(*slope))
    aspect = math.atan2(-slope[0], -slope[1])  # downhill, clockwise from north
    wanted = math.sin(altitude) * math.cos(steep) + math.cos(altitude) * math.sin(steep) * math.cos(
        azimuth - aspect
    )
    for shadows in (False, True):
        shade = ground.hillshade(*sun, shadows=shadows)
        assert shade.dtype == np.float32
        assert np.abs(shade - max(wanted, 0.0)).max() < 1e-6


def test_the_shade_of_a_hemisphere():
    radius = 1000.0
    side, points = dome(201, radius)
    ground = rs.terrain(points[..., 2], spacing=side[1] - side[0])
    shade = ground.hillshade(200.0, 60.0)
    azimuth, altitude = math.radians(200.0), math.radians(60.0)
    sun = [
        math.cos(altitude) * math.sin(azimuth),
        math.cos(altitude) * math.cos(azimuth),
        math.sin(altitude),
    ]
    error = np.abs(shade - points @ sun / radius)
    assert error[1:-1, 1:-1].max() < 2e-5  # second order in the spacing
    assert error.max() < 6e-3  # first order at the border
    assert (ground.hillshade(200.0, 60.0, shadows=True) == shade).all()  # no shadows on a dome


@pytest.mark.parametrize(
    ("azimuth", "axis", "side"), [(90.0, 1, -1), (270.0, 1, 1), (0.0, 0, -1), (180.0, 0, 1)]
)
@pytest.mark.parametrize("order", [1, -1])
def test_the_length_of_a_walls_shadow(azimuth, axis, side, order):
    """The sun in the east casts shadows to the west, whichever way the rows run."""
    position = np.arange(101.0)
    across = np.where(position == 50, 10.0, 0.0)
    heights = np.broadcast_to(across if axis else across[:, None], (101, 101))
    transform = (1, 0, -0.5, 0, order, -0.5 if order > 0 else 100.5)
    altitude = 25.0
    ground = rs.terrain(heights[::order], transform=transform)
    shade = ground.hillshade(azimuth, altitude, shadows=True)[::order]
    line = shade[50] if axis else shade[:, 50]
    length = 10.0 / math.tan(math.radians(altitude))
    behind = side * (position - 50)
    assert (line[(behind >= 1) & (behind < length)] == 0).all()
    flat = math.sin(math.radians(altitude))
    assert np.allclose(line[(behind > max(length, 1.5)) | (behind < -1.5)], flat, atol=1e-6)


def test_holes_have_no_shade_and_leave_their_neighbours():
    heights = 0.5 * grid(9, 1.0)[0]
    heights[4, 4] = np.nan
    for shadows in (False, True):
        shade = rs.terrain(heights).hillshade(90.0, 45.0, shadows=shadows)
        assert np.isnan(shade[4, 4])
        shade[4, 4] = shade[0, 0]
        assert np.allclose(shade, shade[0, 0], atol=1e-6)
    heights[3, :] = heights[5, :] = np.nan  # row 4 has no neighbours above and below
    shade = rs.terrain(heights).hillshade()
    assert np.isnan(shade[3:6]).all()
    assert np.isfinite(shade[:3]).all()


# The raster.


def test_the_ground_between_centres():
    ground = rs.terrain([[0.0, 1.0], [2.0, 5.0]], spacing=(10.0, -10.0))
    assert ground.y.tolist() == [0.0, -10.0]
    inside = [(0, 0, 0), (10, 0, 1), (0, -10, 2), (10, -10, 5), (5, -5, 2.5), (5, 0, 0.5)]
    inside += [(7.5, -2.5, 1.75), (2.5, -7.5, 2.25)]  # on either side of the diagonal
    for x, y, z in inside:
        assert ground.elevation(x, y) == pytest.approx(z)
    outside = ground.elevation([-0.1, 10.1, 5, 5, np.nan], [-5, -5, 0.1, -10.1, -5])
    assert np.isnan(outside).all()
    assert ground.elevation(np.zeros((3, 1)), np.zeros(4)).shape == (3, 4)
    # It is where rays hit.
    rng = np.random.default_rng(0)
    rough = rs.terrain(hills(30, 1), spacing=3.0)
    x, y = rng.uniform(0, 87, (2, 500))
    down = np.stack([x, y, np.full(500, 100.0)], axis=-1)
    hits = rough.tracer.first_hit(down, [0.0, 0.0, -1.0])
    assert np.abs(100.0 - hits.t - rough.elevation(x, y)).max() < 1e-4


def test_rasters_in_many_forms():
    heights = hills(12, 3)
    wanted = rs.terrain(heights).viewshed((5.2, 5.7), height=1.0)
    for one in (heights.tolist(), heights[::-1][::-1], np.asfortranarray(heights)):
        assert (rs.terrain(one).viewshed((5.2, 5.7), height=1.0) == wanted).all()
    single = rs.terrain(heights.astype(np.float32)).heights
    assert single.dtype == np.float64
    whole = (heights * 100).astype(np.int16)
    with_holes = heights.copy()
    with_holes[3, 4] = np.nan
    marked = np.where(np.isnan(with_holes), -9999.0, with_holes)
    masked = np.ma.MaskedArray(whole, mask=np.isnan(with_holes))
    assert np.array_equal(rs.terrain(marked, nodata=-9999).heights, with_holes, equal_nan=True)
    assert np.isnan(rs.terrain(masked).heights).sum() == 1
    ground = rs.terrain(with_holes)
    assert ground.scene.triangle_count == 2 * 11 * 11 - 6
    assert ground.scene.skipped_count == 0
    assert np.isnan(with_holes).sum() == 1  # the caller's array is not changed
    assert "12 x 12 cells" in repr(ground)


def test_far_from_the_origin():
    """Projected coordinates: 500 km east, 5,000 km north."""
    heights = hills(60, 2)
    wanted = rs.terrain(heights, spacing=(30.0, -30.0)).viewshed((800.0, -700.0), height=4.0)
    ground = rs.terrain(heights, transform=(30, 0, 500_000 - 15, 0, -30, 5_000_000 + 15))
    visible = ground.viewshed((500_800.0, 4_999_300.0), height=4.0)
    assert (visible == wanted).mean() > 0.999


def test_other_tracers():
    heights = hills(20, 4)
    wanted = rs.terrain(heights).viewshed((9.3, 9.1), height=2.0)
    for options in ({"structure": "grid"}, {"structure": "bvh", "quality": "fast"}):
        assert (rs.terrain(heights, **options).viewshed((9.3, 9.1), height=2.0) == wanted).all()
    with pytest.raises(TypeError, match="qualty"):
        rs.terrain(heights, qualty="fast")


@pytest.mark.parametrize("spacing", [(1.0, 1.0), (2.0, -0.5)])
def test_a_height_field_has_the_results_of_the_mesh(spacing):
    heights = hills(60, 5)
    heights[np.random.default_rng(0).random(heights.shape) < 0.03] = np.nan
    heights[28:32, 28:32] = 30.0
    mesh = rs.terrain(heights, spacing=spacing)
    field = rs.terrain(heights, spacing=spacing, surface="height field")
    eye = (29.6 * spacing[0], 29.2 * spacing[1])
    for target_height in (0.0, 2.0):
        options = {"height": 5.0, "target_height": target_height}
        assert (field.viewshed(eye, **options) == mesh.viewshed(eye, **options)).all()
    shade = {"azimuth": 200.0, "altitude": 20.0, "shadows": True}
    np.testing.assert_array_equal(field.hillshade(**shade), mesh.hillshade(**shade))
    assert repr(field) == f"Terrain(60 x 60 cells, {2 * 59 * 59:,} triangles)"
    assert field.tracer.structure.report.byte_count < 8 * heights.size + 4096


BAD = [
    ({"surface": "triangles"}, ValueError, "surface: expected 'mesh' or 'height field'"),
    (
        {"dem": np.full((4, 4), np.nan), "surface": "height field"},
        ValueError,
        "dem: no square of four",
    ),
    ({"dem": np.zeros((5, 1))}, ValueError, r"dem: expected shape \(H, W\)"),
    ({"dem": np.zeros(5)}, ValueError, r"dem: expected shape \(H, W\)"),
    ({"dem": np.full((4, 4), np.nan)}, ValueError, "dem: no square of four"),
    ({"dem": np.full((4, 4), np.inf)}, ValueError, "dem: 16 heights are infinite"),
    ({"dem": np.array([["a", "b"], ["c", "d"]])}, TypeError, "dem: expected real numbers"),
    ({"dem": np.zeros((4, 4), complex)}, TypeError, "dem: expected real numbers"),
    ({"spacing": 0}, ValueError, "spacing: expected finite coordinates"),
    ({"spacing": np.nan}, ValueError, "spacing: expected finite coordinates"),
    ({"spacing": (1, 2, 3)}, ValueError, "spacing: expected 2 numbers"),
    ({"spacing": 1, "transform": (1, 0, 0, 0, 1, 0)}, ValueError, "spacing, transform"),
    ({"transform": (1, 0.5, 0, 0, 1, 0)}, ValueError, "transform: rotated"),
    ({"transform": (1, 0, 0)}, ValueError, "transform: expected 6 numbers"),
    ({"transform": (1, 0, 0, 0, 0, 0)}, ValueError, "transform: expected finite coordinates"),
]


@pytest.mark.parametrize(("arguments", "error", "match"), BAD)
def test_bad_rasters_are_named(arguments, error, match):
    with pytest.raises(error, match=match):
        rs.terrain(**({"dem": np.zeros((4, 4))} | arguments))


def test_bad_arguments_are_named():
    holes = np.zeros((6, 6))
    holes[0, :3] = np.nan
    ground = rs.terrain(holes)
    for observer, match in (
        ((9.0, 1.0), "observer: no ground"),
        ((0.5, 0.2), "observer: no ground"),
        ((np.nan, 1.0), "observer: no ground"),
        ((1.0, 1.0, 1.0), "observer: expected x and y"),
    ):
        with pytest.raises(ValueError, match=match):
            ground.viewshed(observer, height=2.0)
    for height in (0.0, -1.0, np.nan, np.inf, 1e-7):
        with pytest.raises(ValueError, match="height: expected a finite number above"):
            ground.viewshed((2.0, 2.0), height=height)
    for name in ("target_height", "max_distance"):
        for value in (-1.0, np.nan):
            with pytest.raises(ValueError, match=f"{name}: expected a number >= 0"):
                ground.viewshed((2.0, 2.0), height=2.0, **{name: value})
    for altitude in (0.0, -5.0, 91.0, np.nan):
        with pytest.raises(ValueError, match="altitude"):
            ground.hillshade(0.0, altitude)
    with pytest.raises(ValueError, match="azimuth"):
        ground.hillshade(np.inf)
    with pytest.raises(ValueError, match="x, y: shapes"):
        ground.elevation([1.0, 2.0], [1.0, 2.0, 3.0])


def test_too_large_a_raster_is_refused_beforehand(monkeypatch):
    monkeypatch.setattr("raystream.core.memory.available_memory", lambda: 10_000_000)
    with pytest.raises(MemoryError, match=r"dem: a terrain of 40,000 cells would take 0.0 GB"):
        rs.terrain(np.zeros((200, 200)))
    rs.terrain(np.zeros((200, 200)), surface="height field")
    monkeypatch.setattr("raystream.core.memory.available_memory", lambda: 1_000_000)
    with pytest.raises(MemoryError, match=r"dem: a terrain of 40,000 cells would take 0.0 GB"):
        rs.terrain(np.zeros((200, 200)), surface="height field")


def test_memory_per_cell_is_as_stated():
    """What the mesh and the structure keep, and the float64 arrays that come and go."""
    heights = hills(200, 1)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        ground = rs.terrain(heights)
    mesh = ground.scene.meshes[0]
    kept = ground.tracer.structure.report.byte_count + mesh.vertices.nbytes + mesh.faces.nbytes
    assert kept < 0.75 * module.BYTES_PER_CELL * heights.size

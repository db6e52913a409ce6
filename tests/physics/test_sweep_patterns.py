"""Sweep patterns against the manuals' formulas and closed forms."""

from __future__ import annotations

import math
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from raystream import sweep_patterns
from raystream.physics import spinning_sensors

SENSORS = {
    "vlp16": (spinning_sensors.VLP16, 16, (-15, 15), Fraction("55.296e-6")),
    "vlp32c": (spinning_sensors.VLP32C, 32, (-25, 15), Fraction("55.296e-6")),
    "vls128": (spinning_sensors.VLS128, 128, (-25, 15), Fraction("53.3e-6")),
}


def angles(pattern):
    """Degrees to the right of -z, 0 to 360, and above the horizon."""
    x, y, z = pattern.directions.T
    around = np.degrees(np.arctan2(x, -z)) % 360
    return around, np.degrees(np.arctan2(y, np.hypot(x, z)))


def difference(a, b):
    """Of angles around a circle."""
    return np.abs((a - b + 180) % 360 - 180)


@pytest.mark.parametrize("name", SENSORS)
@pytest.mark.parametrize("rate", [5.0, 10.0, 20.0])
def test_spinning_sensors(name, rate):
    table, count, ends, column_time = SENSORS[name]
    pattern = getattr(sweep_patterns, name)(rate)
    columns = int(1 / (Fraction(rate) * column_time))
    assert len(pattern) == columns * count
    assert pattern.period == 1 / rate
    assert np.array_equal(pattern.channels, np.tile(np.arange(count), columns))
    assert np.array_equal(pattern.columns, np.repeat(np.arange(columns), count))
    around, above = angles(pattern)
    assert len(set(table.elevations)) == count
    assert (table.elevations.min(), table.elevations.max()) == ends
    np.testing.assert_allclose(above, table.elevations[pattern.channels], atol=1e-12)
    expected = 360 * rate * pattern.times + table.azimuth_offsets[pattern.channels]
    assert difference(around, expected).max() < 1e-9
    np.testing.assert_allclose(np.linalg.norm(pattern.directions, axis=1), 1.0, rtol=1e-15)
    assert pattern.times.max() + float(column_time) > pattern.period - float(column_time)


def test_firing_times_are_the_manuals():
    """The formulas of the manuals, in rational numbers, of every laser in two columns."""
    # VLP-16, section 9.4: 55.296 * sequence + 2.304 * laser.
    # VLS-128: 53.3 * sequence + 2.665 * (laser / 8 + laser / 64), integer divisions.
    formulas = {
        "vlp16": lambda s, i: Fraction("55.296") * s + Fraction("2.304") * i,
        "vlp32c": lambda s, i: Fraction("55.296") * s + Fraction("2.304") * (i // 2),
        "vls128": lambda s, i: Fraction("53.3") * s + Fraction("2.665") * (i // 8 + i // 64),
    }
    for name, formula in formulas.items():
        count, pattern = SENSORS[name][1], getattr(sweep_patterns, name)()
        for column in (0, 1000):
            exact = [float(formula(column, laser) / 10**6) for laser in range(count)]
            rows = slice(column * count, (column + 1) * count)
            np.testing.assert_allclose(pattern.times[rows], exact, rtol=1e-14, atol=1e-20)


def test_the_angles_of_a_puck_are_every_other_degree():
    assert sorted(spinning_sensors.VLP16.elevations) == list(range(-15, 16, 2))
    # Sections of 1/9 degree in the middle of a VLS-128, of 1/3 degree in a VLP-32C.
    middle = np.sort(spinning_sensors.VLS128.elevations)
    middle = middle[np.abs(middle) < 4]
    np.testing.assert_allclose(np.diff(middle), 0.11, atol=0.011)
    middle = np.sort(spinning_sensors.VLP32C.elevations)
    np.testing.assert_allclose(np.diff(middle[np.abs(middle) <= 1.4]), 1 / 3, atol=1.1e-3)


@given(
    st.lists(st.floats(-89, 89), min_size=1, max_size=8),
    st.floats(0.5, 50),
    st.integers(1, 40),
    st.floats(-180, 180),
)
def test_azimuth_offsets_turn_the_pattern(elevations, rate, columns, offset):
    plain = sweep_patterns.spinning(elevations, rate=rate, columns=columns)
    turned = sweep_patterns.spinning(elevations, rate=rate, columns=columns, azimuth_offsets=offset)
    (around, above), (moved, height) = angles(plain), angles(turned)
    assert difference(moved, around + offset).max() < 1e-9
    np.testing.assert_allclose(height, above, atol=1e-12)
    assert np.array_equal(plain.times, turned.times)
    np.testing.assert_allclose(plain.times, plain.columns / (rate * columns), rtol=1e-14)


def test_firing_times_turn_each_channel():
    pattern = sweep_patterns.spinning([0, 10], rate=1.0, columns=4, firing_times=[0.0, 0.125])
    around, above = angles(pattern)
    np.testing.assert_allclose(around, [0, 45, 90, 135, 180, 225, 270, 315])
    np.testing.assert_allclose(above, [0, 10] * 4, atol=1e-14)


def test_a_raster_is_a_grid():
    pattern = sweep_patterns.raster(4, 2, fov=(40, 10), rate=5.0)
    around, above = angles(pattern)
    np.testing.assert_allclose((around + 180) % 360 - 180, [-15, -5, 5, 15] * 2, atol=1e-13)
    np.testing.assert_allclose(above, [2.5] * 4 + [-2.5] * 4, atol=1e-13)
    np.testing.assert_allclose(pattern.times, np.arange(8) * 0.025)
    assert pattern.channels.tolist() == [0] * 4 + [1] * 4
    assert pattern.columns.tolist() == [0, 1, 2, 3] * 2


def test_a_resonant_mirror_swings():
    """Azimuth is a cosine of time, elevation linear, and each line spans the field of view."""
    columns, rows = 100, 6
    pattern = sweep_patterns.mems(columns, rows, fov=(50, 30), rate=2.0)
    around, above = angles(pattern)
    middle = pattern.times + 0.25 / (columns * rows)  # half a pulse's time later
    expected = -25 * np.cos(2 * np.pi * (rows / 2 * 2.0) * middle)
    assert difference(around, expected).max() < 1e-9
    np.testing.assert_allclose(above, 15 - 30 * middle / 0.5, atol=1e-12)
    lines = ((around + 180) % 360 - 180).reshape(rows, columns)
    signs = np.sign(np.diff(lines, axis=1))
    assert (signs == np.array([1, -1] * 3)[:, None]).all()


def test_a_rosette_adds_two_circles():
    a, b, first, second = 6.0, 4.0, 3.0, -5.0
    pattern = sweep_patterns.rosette(
        2000, deflections=(a, b), speeds=(first, second), rate=1.0, start=0.25
    )
    x, y, z = pattern.directions.T
    angle = np.degrees(np.arccos(-z))
    time = 0.25 + pattern.times
    closed = np.sqrt(a * a + b * b + 2 * a * b * np.cos(2 * np.pi * (first - second) * time))
    np.testing.assert_allclose(angle, closed, atol=1e-9)
    sum_x = a * np.cos(2 * np.pi * first * time) + b * np.cos(2 * np.pi * second * time)
    sum_y = a * np.sin(2 * np.pi * first * time) + b * np.sin(2 * np.pi * second * time)
    np.testing.assert_allclose(np.arctan2(y, x), np.arctan2(sum_y, sum_x), atol=1e-9)
    assert angle.min() >= a - b - 1e-9
    assert angle.max() <= a + b + 1e-9
    ahead = sweep_patterns.rosette(4, deflections=(5, 5), speeds=(1, 0.5), rate=1.0, start=1.0)
    np.testing.assert_allclose(ahead.directions[0], [0, 0, -1], atol=1e-15)  # opposite prisms


def test_your_own():
    directions = [[0, 0, -3], [1e-300, 0, 0], [0, 1e300, 1e300]]
    pattern = sweep_patterns.SweepPattern(directions, [0.2, 0.1, 0], 0.2, [2, 1, 0], [7, 8, 9])
    half = math.sqrt(0.5)
    np.testing.assert_allclose(pattern.directions, [[0, 0, -1], [1, 0, 0], [0, half, half]])
    assert pattern.channels.dtype == pattern.columns.dtype == np.int32
    assert not pattern.times.flags.writeable
    assert len(sweep_patterns.SweepPattern(np.zeros((0, 3)), [], 1.0)) == 0


def call(name, *values, **options):
    return lambda: getattr(sweep_patterns, name)(*values, **options)


AHEAD = [[0, 0, -1]]


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (call("spinning", []), "elevations: expected an angle for each of at least one channel"),
        (call("spinning", 0.0), "elevations: expected an angle for each"),
        (call("spinning", [91]), "elevations: expected degrees from -90 to 90"),
        (call("spinning", [math.nan]), "elevations: expected degrees from -90 to 90"),
        (call("spinning", [0], columns=0), r"columns: expected a number from 1 to 2\*\*31 - 1"),
        (call("spinning", [0], columns=1 << 40), "columns: expected a number from 1 to"),
        (call("spinning", [0], rate=0), "rate: expected a number from 0.0001 to 1e"),
        (call("spinning", [0], rate=-10), "rate: expected a number from"),
        (call("spinning", [0], rate=math.nan), "rate: expected a finite number, got nan"),
        (call("spinning", [0], azimuth_offsets=[1, 2]), r"azimuth_offsets: expected shape \(\) or"),
        (call("spinning", [0], azimuth_offsets=math.inf), "azimuth_offsets: expected finite"),
        (call("spinning", [0], firing_times=1.0), "firing_times: expected seconds from 0 to"),
        (call("vlp16", 1e6), "rate: a revolution is shorter than a firing sequence"),
        (call("vls128", math.inf), "rate: expected a finite number"),
        (call("raster", 0, 5), "columns: expected a number from 1"),
        (call("raster", 5, 0), "rows: expected a number from 1"),
        (call("raster", 5, 5, fov=(400, 5)), "fov: expected degrees across, above 0 and at most"),
        (call("raster", 5, 5, fov=(math.nan, 5)), "fov: expected a finite number"),
        (call("mems", 5, 5, fov=5), "fov: expected two numbers, got 5"),
        (call("rosette", 0), "points: expected a number from 1"),
        (call("rosette", 5, deflections=(50, 50)), "deflections: expected two angles from 0"),
        (call("rosette", 5, deflections=(-1, 5)), "deflections: expected two angles from 0"),
        (call("rosette", 5, speeds=(math.inf, 5)), "speeds: expected a finite number"),
        (call("rosette", 5, start=math.nan), "start: expected a finite number"),
        (call("SweepPattern", [0, 0, -1], [0], 1.0), r"directions: expected shape \(N, 3\)"),
        (
            call("SweepPattern", [[0, 0, 0]], [0], 1.0),
            "directions: expected finite numbers, and no",
        ),
        (call("SweepPattern", [[0, 0, math.nan]], [0], 1.0), "directions: expected finite"),
        (call("SweepPattern", AHEAD, [0, 1], 1.0), r"times: expected shape \(1,\), got \(2,\)"),
        (call("SweepPattern", AHEAD, [2], 1.0), "times: expected numbers from 0 to the period, 1"),
        (call("SweepPattern", AHEAD, [math.nan], 1.0), "times: expected numbers from 0"),
        (call("SweepPattern", AHEAD, [0], 0.0), "period: expected a number above 0"),
        (call("SweepPattern", AHEAD, [0], 1.0, [-1]), "channels: expected numbers from 0"),
        (call("SweepPattern", AHEAD, [0], 1.0, [0], [0, 1]), r"columns: expected shape \(1,\)"),
    ],
)
def test_bad_values(make, message):
    with pytest.raises(ValueError, match=message):
        make()


def test_bad_types():
    with pytest.raises(TypeError, match="elevations: expected real numbers"):
        sweep_patterns.spinning(["up"])
    with pytest.raises(TypeError, match="channels: expected integers, got dtype float64"):
        sweep_patterns.SweepPattern(AHEAD, [0], 1.0, [0.5])
    with pytest.raises(TypeError):
        sweep_patterns.raster(2.5, 3)


def test_patterns_that_do_not_fit_are_refused():
    with pytest.raises(MemoryError, match="pulses would take"):
        sweep_patterns.raster(1 << 30, 1 << 30)
    with pytest.raises(MemoryError, match="pulses would take"):
        sweep_patterns.vls128(1e-4)

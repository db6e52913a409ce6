"""LiDAR pulses against surfaces with known echoes."""

from __future__ import annotations

import math

import numpy as np
import pytest

import raystream as rs
from conftest import EVERY_QUERY, TRACERS, assert_same_bits
from meshes import soup
from raystream.physics import lidar
from solid_meshes import tracer_of

DOWN = [0.0, 0.0, -1.0]
MATERIALS = rs.Material("leaf"), rs.Material("ground")
COLUMNS = (
    "ray_splits", "ranges", "positions", "intensity", "incidence_angle", "return_number",
    "return_count", "prim_id", "mesh_id", "material_id", "status",
)  # fmt: skip


def sheet(z, material=0, size=50.0, slope=0.0, offset=0.0):
    x = np.array([-size, size, size, -size]) + offset
    y = np.array([-size, -size, size, size])
    vertices = np.stack([x, y, z + slope * x], axis=1)
    return rs.Mesh(vertices, [[0, 1, 2], [0, 2, 3]], material_ids=material)


@pytest.fixture
def canopy():
    """Leaves at heights 4, 3 and 2 over ground at 0."""
    return tracer_of(sheet(4), sheet(3), sheet(2), sheet(0, 1), materials=MATERIALS)


FOLIAGE = {"reflectance": {"leaf": 0.5, "ground": 0.2}, "transmission": {"leaf": 0.4}}


def test_foliage_sends_several_returns(canopy):
    found = rs.lidar_returns(canopy, [[1, 2, 10.0]], [DOWN], **FOLIAGE)
    assert found.ranges == pytest.approx([6, 7, 8, 10])
    assert found.intensity == pytest.approx([0.3, 0.12, 0.048, 0.2 * 0.4**3])
    assert found.return_number.tolist() == [1, 2, 3, 4]
    assert found.return_count.tolist() == [4] * 4
    assert found.mesh_id.tolist() == [0, 1, 2, 3]
    assert found.material_id.tolist() == [0, 0, 0, 1]
    assert found.incidence_angle == pytest.approx([0] * 4)
    np.testing.assert_allclose(found.positions, [[1, 2, z] for z in (4, 3, 2, 0)])


def test_opaque_surfaces_end_a_pulse(canopy):
    found = rs.lidar_returns(canopy, [[1, 2, 10.0], [1, 2, -5.0], [1, 2, 3.5]], DOWN)
    assert found.counts.tolist() == [1, 0, 1]
    assert found.ranges == pytest.approx([6, 0.5])
    assert found.ray_id.tolist() == [0, 2]


def test_the_nearest_returns_are_kept(canopy):
    for number in (1, 2, 3, 4, 9):
        found = rs.lidar_returns(canopy, [1, 2, 10.0], DOWN, max_returns=number, **FOLIAGE)
        assert found.counts.item() == min(number, 4)
        assert set(found.return_count) == {min(number, 4)}


def test_what_is_too_weak_is_not_noticed(canopy):
    found = rs.lidar_returns(canopy, [1, 2, 10.0], DOWN, threshold=0.1, **FOLIAGE)
    assert found.intensity == pytest.approx([0.3, 0.12])
    # Dark leaves are passed, and the ground behind them is still seen.
    dark = {"reflectance": {"leaf": 0.01}, "transmission": {"leaf": 0.9}}
    found = rs.lidar_returns(canopy, [1, 2, 10.0], DOWN, **dark)
    assert found.ranges == pytest.approx([10])
    assert found.intensity == pytest.approx([0.9**3])


def test_a_slope_is_darker():
    tracer = tracer_of(sheet(0, slope=1.0))
    found = rs.lidar_returns(tracer, [0, 0, 10.0], [0, 0, -2.0], reflectance=0.8)
    assert found.ranges == pytest.approx([10])
    assert found.incidence_angle == pytest.approx([45])
    assert found.intensity == pytest.approx([0.8 * math.sqrt(0.5)])


def test_many_surfaces_are_followed_to_the_end():
    """More than are traced at first."""
    tracer = tracer_of(*(sheet(-z) for z in range(100)))
    arguments = {"transmission": 1.0 - 1e-3, "threshold": 0.0, "max_returns": 1000}
    found = rs.lidar_returns(tracer, [[0.1, 0.2, 5.0]] * 3, DOWN, **arguments)
    assert found.counts.tolist() == [100] * 3
    np.testing.assert_allclose(found.ranges[:100], 5 + np.arange(100), rtol=1e-6)
    together = rs.lidar_returns(tracer, [0.1, 0.2, 5.0], DOWN, **arguments, separation=10.0)
    assert together.counts.item() == 10
    assert together.intensity.sum() == pytest.approx(1 - (1 - 1e-3) ** 100)
    np.testing.assert_allclose(together.ranges, 9.5 + 10 * np.arange(10), atol=0.01)


def test_a_wide_pulse_sees_both_sides_of_an_edge():
    """Half of the beam hits a table, half the floor below."""
    tracer = tracer_of(sheet(2, offset=50.0), sheet(0, 1), materials=MATERIALS)
    found = rs.lidar_returns(
        tracer, [1e-9, 0, 12.0], DOWN, divergence=0.5, sub_rays=200, separation=0.5
    )
    assert found.counts.item() == 2
    assert found.ranges == pytest.approx([10, 12], abs=1e-3)
    assert found.intensity == pytest.approx([0.5, 0.5], abs=0.03)
    assert found.material_id.tolist() == [0, 1]


def test_the_cone_is_as_wide_as_it_says():
    edge = 10 * math.tan(math.radians(1.0))
    tracer = tracer_of(sheet(0, size=0.5 * edge))
    found = rs.lidar_returns(
        tracer, [0, 0, 10.0], DOWN, divergence=2.0, sub_rays=20_000, separation=1.0
    )
    share = edge**2 / (math.pi * edge**2)  # a square within a disk
    assert found.intensity == pytest.approx([share], rel=0.01)


def test_energy_is_kept(rng):
    """White, partly transparent surfaces return no more energy than arrives."""
    tracer = rs.Tracer(rs.Scene.from_arrays(*soup(200)))
    origins = rng.normal(size=(2000, 3)) * 2
    found = rs.lidar_returns(
        tracer, origins, 0.5 - origins, transmission=0.3, threshold=0.0, max_returns=10**6
    )
    assert np.bincount(found.ray_id, found.intensity).max() <= 1.0
    assert (np.diff(found.ranges)[np.diff(found.ray_id) == 0] >= 0).all()


@pytest.mark.parametrize("name", EVERY_QUERY)
def test_every_structure_gives_the_same_bits(name, rng):
    scene = rs.Scene.from_arrays(*soup(120))
    origins = rng.normal(size=(100, 3)) * 2
    directions = rng.random((100, 3)) - origins
    directions[::30] = 0.0
    options = {"transmission": 0.6, "divergence": 3.0, "sub_rays": 5, "separation": 0.1}
    tracer, oracle = rs.Tracer(scene, **TRACERS[name]), rs.Tracer(scene, "brute")
    for arguments in ({"transmission": 0.6}, options):
        found = rs.lidar_returns(tracer, origins, directions, **arguments)
        expected = rs.lidar_returns(oracle, origins, directions, **arguments)
        for column in COLUMNS:
            assert_same_bits(getattr(found, column), getattr(expected, column))
        assert found.status.tolist() == ([1] + [0] * 29) * 3 + [1] + [0] * 9
        assert len(found.ranges) > 50


def test_blocks_and_shapes(monkeypatch, canopy, rng):
    origins = rng.uniform(-5, 5, (20, 10, 3)) + [0, 0, 15]
    whole = rs.lidar_returns(canopy, origins, DOWN, **FOLIAGE)
    assert whole.counts.shape == whole.status.shape == (20, 10)
    monkeypatch.setattr(lidar, "_SUB_RAYS_PER_BLOCK", 64)
    seen = []
    parts = rs.lidar_returns(
        canopy, origins, DOWN, **FOLIAGE, progress=lambda done, total: seen.append((done, total))
    )
    for column in COLUMNS:
        assert_same_bits(getattr(parts, column), getattr(whole, column))
    assert seen == [(64, 200), (128, 200), (192, 200), (200, 200)]


def test_limits_and_nothing(canopy):
    found = rs.lidar_returns(canopy, [1, 2, 10.0], [0, 0, -2.0], t_min=3.25, **FOLIAGE)
    assert found.ranges == pytest.approx([7, 8, 10])
    assert len(rs.lidar_returns(canopy, np.zeros((0, 3)), DOWN).ranges) == 0
    assert rs.lidar_returns(rs.Tracer(rs.Scene()), [0, 0, 0], DOWN).counts.item() == 0


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"max_returns": 0}, "max_returns: expected at least 1, got 0"),
        ({"sub_rays": 0}, "sub_rays: expected at least 1, got 0"),
        ({"threshold": -1.0}, "threshold: expected a number from 0 to 1, got -1"),
        ({"divergence": 91.0}, "divergence: expected a number from 0 to 90, got 91"),
        ({"separation": math.nan}, "separation: expected a number from 0 to inf, got nan"),
        ({"transmission": 1.5}, "transmission: expected numbers from 0 to 1, got 1.5"),
        ({"reflectance": {"wood": 1.0}}, "reflectance: no material 'wood'"),
    ],
)
def test_bad_arguments(canopy, arguments, message):
    with pytest.raises(ValueError, match=message):
        rs.lidar_returns(canopy, [0, 0, 1], DOWN, **arguments)


# The least range of a sensor

WALLS = [0.2, 3.0, 4.0]


def walls() -> rs.Tracer:
    meshes = [sheet(-z, k) for k, z in enumerate(WALLS)]
    return tracer_of(*meshes, materials=[rs.Material(f"{k}") for k in range(3)])


@pytest.mark.parametrize(
    ("options", "ranges"),
    [
        ({}, [0.2]),
        ({"min_range": 0.5}, []),  # the beam ends at the wall that is too near
        ({"t_min": 0.5}, [3.0]),  # as if that were not there
        ({"min_range": 0.5, "transmission": 0.5}, [3.0, 4.0]),
        ({"min_range": 3.5, "transmission": 0.5}, [4.0]),
        ({"min_range": 0.5, "transmission": 0.5, "max_returns": 1}, [3.0]),
        ({"min_range": 0.5, "transmission": {"0": 0.5}}, [3.0]),
        ({"min_range": 0.5, "transmission": 0.5, "separation": 2.0}, [3.0 + 1.0 / 3.0]),
        ({"min_range": 0.5, "transmission": 0.5, "sub_rays": 3, "separation": 0.1}, [3.0, 4.0]),
        ({"min_range": 9.0, "transmission": 0.5}, []),
    ],
)
def test_returns_nearer_than_the_least_range_are_dropped(options, ranges) -> None:
    found = rs.lidar_returns(walls(), [0.1, 0.3, 0.0], DOWN, **options)
    assert found.ranges == pytest.approx(ranges)
    assert found.return_number.tolist() == list(range(1, len(ranges) + 1))
    assert found.return_count.tolist() == [len(ranges)] * len(ranges)


def test_a_range_is_in_scene_units_whatever_the_direction() -> None:
    for length in (0.01, 1.0, 100.0):
        found = rs.lidar_returns(
            walls(), [0.1, 0.3, 0.0], [0, 0, -length], min_range=3.5, transmission=0.5
        )
        assert found.ranges == pytest.approx([4.0])


def test_sweeps_have_a_least_range() -> None:
    pattern = rs.sweep_patterns.SweepPattern([[0, 0, -1]] * 2, [0.0, 1.0], period=1.0)
    nearer = rs.SensorTrack([0.0, 1.0], [[0.1, 0.3, 3.0], [0.1, 0.3, 0.3]])
    found = rs.lidar_sweep(walls(), pattern, nearer, min_range=0.6)
    assert found.counts.tolist() == [1, 0]
    assert found.ranges == pytest.approx([3.2])


@pytest.mark.parametrize("value", [-1.0, np.nan])
def test_a_wrong_least_range_is_refused(value) -> None:
    with pytest.raises(ValueError, match="min_range"):
        rs.lidar_returns(walls(), [0.0, 0.0, 1.0], DOWN, min_range=value)

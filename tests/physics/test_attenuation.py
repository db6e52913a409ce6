"""The Beer-Lambert law over known chords."""

from __future__ import annotations

import numpy as np
import pytest

import raystream as rs
from solid_meshes import box_chords, box_mesh, rays_from_outside, tracer_of

MATERIALS = rs.Material("steel"), rs.Material("foam"), rs.Material("foam")
LOW, HIGH = [[-1, -1, -1], [0.25, -0.5, -1], [-1, 0.5, -1]], [[0, 1, 1], [1, 0.5, 1], [1, 0.75, 1]]
MU = np.array([0.7, 0.1, 2.0])


@pytest.fixture
def tracer():
    meshes = [
        box_mesh(low, high, material_ids=i, name=f"box {i}")
        for i, (low, high) in enumerate(zip(LOW, HIGH, strict=True))
    ]
    return tracer_of(*meshes, materials=MATERIALS)


@pytest.mark.filterwarnings("ignore:thickness. meshes overlap")
def test_an_assembly_of_boxes(tracer, rng):
    origins, directions = rays_from_outside(rng, 5000)
    found = rs.thickness(tracer, origins, directions)
    depth = sum(
        mu * box_chords(origins, directions, low, high)
        for mu, low, high in zip(MU, LOW, HIGH, strict=True)
    )
    passed = rs.attenuation(found, MU)
    np.testing.assert_allclose(passed, np.exp(-depth), rtol=1e-4)
    assert passed.dtype == np.float64
    by_mesh = {"box 0": MU[0], 1: MU[1], "box 2": MU[2]}
    np.testing.assert_array_equal(rs.attenuation(found, by_mesh, by="mesh"), passed)
    np.testing.assert_array_equal(rs.attenuation(found, {"steel": 0.7, 1: 0.1, 2: 2.0}), passed)
    np.testing.assert_allclose(
        rs.attenuation(found, 0.5), np.exp(-0.5 * found.total_length()), rtol=1e-12
    )
    assert (rs.attenuation(found, 0.0) == 1.0).all()


def test_incomplete_rays_are_nan_unless_one_insists(tracer):
    found = rs.thickness(tracer, [[-0.5, 0.0, 0.0], [0.0, 0.0, 5.0]], [1.0, 0.0, 0.0])
    assert np.isnan(rs.attenuation(found, MU)).tolist() == [True, False]
    kept = rs.attenuation(found, MU, incomplete="ignore")
    assert kept == pytest.approx([np.exp(-0.75 * MU[1]), 1.0])


@pytest.mark.parametrize(
    ("coefficients", "message"),
    [
        ([1.0, 2.0], "coefficients: expected shape .3,., got .2,."),
        ([1.0, -2.0, 3.0], "coefficients: expected numbers >= 0, got -2"),
        ([1.0, np.nan, 3.0], "coefficients: expected numbers >= 0, got nan"),
        ({"steel": -1.0}, "coefficients.'steel'.: expected numbers >= 0"),
        ({"steel": [1.0, 2.0]}, "coefficients.'steel'.: expected shape"),
        ({"iron": 1.0}, "coefficients: no material 'iron'; there are 'steel', 'foam', 'foam'"),
        ({"foam": 1.0}, "coefficients: 'foam' has 2 matches; use their numbers"),
        ({3: 1.0}, "coefficients: no material 3; they are 0 to 2"),
        ({0: 1.0, "steel": 1.0}, "coefficients: material 0 .'steel'. is given twice"),
        ({"steel": 1.0}, "coefficients: none for material 1 .'foam'., which rays cross"),
    ],
)
def test_bad_coefficients(tracer, coefficients, message):
    found = rs.thickness(tracer, [-5.0, 0.0, 0.0], [1.0, 0.0, 0.0])
    with pytest.raises(ValueError, match=message):
        rs.attenuation(found, coefficients)


def test_bad_arguments(tracer):
    found = rs.thickness(tracer, [-5.0, 0.0, 0.0], [1.0, 0.0, 0.0])
    with pytest.raises(ValueError, match="by: expected 'mesh' or 'material', got 'name'"):
        rs.attenuation(found, MU, by="name")
    with pytest.raises(ValueError, match="incomplete: expected 'nan' or 'ignore', got 0"):
        rs.attenuation(found, MU, incomplete=0)
    with pytest.raises(TypeError, match="coefficients: expected real numbers"):
        rs.attenuation(found, ["a", "b", "c"])


def test_what_is_not_crossed_needs_no_coefficient(tracer):
    found = rs.thickness(tracer, [-0.5, 0.0, -5.0], [0.0, 0.0, 1.0])
    assert rs.attenuation(found, {"steel": 0.5}).item() == pytest.approx(np.exp(-1.0))

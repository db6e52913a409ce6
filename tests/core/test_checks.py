import math

import numpy as np
import pytest

from raystream.core.array_checks import checked_rays, checked_vertices, leading_shape
from raystream.core.checks import check_choice, check_finite, check_least


def test_names_that_are_known() -> None:
    check_choice("tone", "aces", ("linear", "aces"))
    check_choice("tone", "aces", {"linear": 0, "aces": 1})
    with pytest.raises(ValueError, match=r"^tone: expected one of 'linear', 'aces', got 'film'$"):
        check_choice("tone", "film", ("linear", "aces"))


def test_integers_that_are_large_enough() -> None:
    assert check_least("samples", np.int64(1), 1) == 1
    with pytest.raises(ValueError, match=r"^samples: expected at least 1, got 0$"):
        check_least("samples", 0, 1)
    with pytest.raises(TypeError):
        check_least("samples", 1.0, 1)


@pytest.mark.parametrize("value", [math.inf, -math.inf, math.nan])
def test_numbers_that_are_not_finite(value: float) -> None:
    check_finite("time", -1e300)
    with pytest.raises(ValueError, match=rf"^time: expected a finite number, got {value}$"):
        check_finite("time", value)


def _read(_: str, values: object) -> np.ndarray:
    return np.asarray(values, np.float64)


def _rays(*arguments: object) -> tuple[np.ndarray, ...]:
    return checked_rays(_read, np.broadcast_shapes, *arguments)


def test_rays_that_fit() -> None:
    origins, directions, t_min, t_max = _rays(np.zeros((4, 1, 3)), np.ones((5, 3)), 0.0, np.ones(5))
    assert origins.shape == (4, 1, 3)
    assert directions.shape == (5, 3)
    assert (t_min.shape, t_max.shape) == ((), (5,))
    assert leading_shape(np.broadcast_shapes, origins, directions) == (4, 5)


@pytest.mark.parametrize(
    ("arguments", "error"),
    [
        ((np.zeros(2), np.ones(3), 0.0, 1.0), r"origins: expected shape \(..., 3\), got \(2,\)"),
        (
            (np.zeros((2, 3)), np.ones((4, 3)), 0.0, 1.0),
            r"origins and directions: shapes \(2, 3\) and \(4, 3\) do not broadcast",
        ),
        (
            (np.zeros((2, 3)), np.ones(3), 0.0, np.ones(3)),
            r"t_max: shape \(3,\) does not broadcast to the rays' shape \(2,\)",
        ),
    ],
)
def test_rays_that_do_not_fit(arguments: tuple[object, ...], error: str) -> None:
    with pytest.raises(ValueError, match=error):
        _rays(*arguments)


def test_vertices() -> None:
    vertices = np.zeros((4, 3))
    assert checked_vertices(vertices, True) is vertices
    with pytest.raises(ValueError, match=r"vertices: expected shape \(V, 3\), got \(3,\)"):
        checked_vertices(np.zeros(3), True)
    with pytest.raises(TypeError, match="vertices: expected floating-point numbers, got dtype int"):
        checked_vertices(np.zeros((4, 3), np.int32), False)

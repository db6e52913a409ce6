"""Functions of shapes that are wrong: errors name function, file, line and record."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

import raystream as rs
import users_shapes as users
from users_shapes import CASES

BALLS = np.array([((0.0, 0.0, 5.0), 1.0), ((0.0, 0.0, 9.0), 1.0)], users.BALL)
RAY = [0.0, 0.0, 0.0], [0.0, 0.0, 1.0]


def balls(**changes: Any) -> rs.Shape:
    given = {
        "bounds": users.ball_bounds,
        "intersect": users.ball_hits,
        "distance": users.ball_distance,
        "normal": users.ball_normal,
    }
    return rs.Shape(**{**given, **changes})


def place_of(function: Any) -> str:
    line = function.__code__.co_firstlineno
    return rf"{function.__name__} \(.*test_errors\.py, line {line}\)"


def fails(shape: rs.Shape, kind: type[Exception], text: str, records: Any = BALLS) -> None:
    with pytest.raises(kind, match=text):
        rs.Tracer(rs.Scene.shapes(shape, records)).first_hit(*RAY)


def test_functions_that_cannot_be_compiled() -> None:
    def intersect(ball: Any, origin: Any, direction: Any, span: Any, t: Any) -> int:
        return ball.size  # there is no such field

    fails(balls(intersect=intersect), TypeError, rf"intersect: {place_of(intersect)}: .*size")


def test_results_of_wrong_types() -> None:
    def two(ball: Any) -> Any:
        return ball.center

    def text(ball: Any, origin: Any, direction: Any, span: Any, t: Any) -> Any:
        return "two"

    def flat(ball: Any, point: Any) -> Any:
        return 0.0, 1.0

    def nothing(ball: Any, point: Any) -> None:
        return None

    for role, function in [
        ("bounds", two),
        ("intersect", text),
        ("normal", flat),
        ("distance", nothing),
    ]:
        fails(balls(**{role: function}), TypeError, f"{role}: {place_of(function)}: ")


def test_wrong_arguments() -> None:
    def bounds(ball: Any, more: Any) -> Any:
        return (0.0, 0.0, 0.0), (1.0, 1.0, 1.0)

    with pytest.raises(TypeError, match=rf"{place_of(bounds)}: takes \(ball, more\)"):
        balls(bounds=bounds)
    with pytest.raises(TypeError, match="bounds: expected a Python function, got int"):
        balls(bounds=3)
    with pytest.raises(TypeError, match="normal: expected a function"):
        rs.Shape(users.ball_bounds, users.ball_hits)
    for hits in (0, 33, 1.5):
        with pytest.raises(ValueError, match="hits: expected an integer from 1 to 32"):
            balls(hits=hits)


def test_bounds_that_are_not_finite_or_reversed() -> None:
    records = BALLS.copy()
    records["radius"][1] = -1.0
    fails(
        balls(),
        ValueError,
        "bounds: ball_bounds .*: bounds of record 1 are .*low ones first",
        records,
    )
    records["radius"][1] = np.nan
    fails(balls(), ValueError, "bounds of record 1 are", records)


def test_distances_that_are_not_numbers() -> None:
    def intersect(ball: Any, origin: Any, direction: Any, span: Any, t: Any) -> int:
        t[0] = math.nan if ball.center[2] > 6.0 else 20.0
        return 1

    def none(ball: Any, origin: Any, direction: Any, span: Any, t: Any) -> int:
        return 2

    text = "wrote no distance, or a distance that is NaN, for record"
    for function, row in ((intersect, 1), (none, 0)):
        place = place_of(function)
        fails(balls(intersect=function), rs.RaystreamError, rf"intersect: {place}: {text} {row}")


def test_more_crossings_than_were_declared() -> None:
    def counts(ball: Any, origin: Any, direction: Any, span: Any, t: Any) -> int:
        return 3

    def writes(ball: Any, origin: Any, direction: Any, span: Any, t: Any) -> int:
        for k in range(3):
            t[k] = 4.0
        return 2

    place = place_of(counts)
    fails(balls(intersect=counts), rs.RaystreamError, f"{place}: returned a number that is not 0")
    place = place_of(writes)
    fails(balls(intersect=writes), rs.RaystreamError, f"{place}: raised an exception, perhaps by")


def test_a_fault_is_reported_once_and_by_every_query() -> None:
    def intersect(ball: Any, origin: Any, direction: Any, span: Any, t: Any) -> int:
        t[0] = math.nan if direction[0] == 0.0 else 4.0
        return 1

    for structure in ("bvh", "brute"):
        tracer = rs.Tracer(rs.Scene.shapes(balls(intersect=intersect), BALLS), structure)
        for name in ("first_hit", "any_hit", "count_hits", "multi_hit", "cast"):
            with pytest.raises(rs.RaystreamError, match="NaN"):
                getattr(tracer, name)(*RAY)
            getattr(tracer, name)([-9.0, 0.0, 5.0], [1.0, 0.0, 0.0])


def test_records_that_are_not_records() -> None:
    for records in (np.zeros((2, 4)), np.zeros((2, 2), users.BALL), np.array([None])):
        with pytest.raises(TypeError, match="records: expected a structured array"):
            rs.Scene.shapes(users.ball, records)
    with pytest.raises(TypeError, match="shape: expected a Shape, got int"):
        rs.Scene.shapes(3, BALLS)
    with pytest.raises(ValueError, match="material_ids: expected one number or shape"):
        rs.Scene.shapes(users.ball, BALLS, material_ids=[0, 0, 0])
    with pytest.raises(ValueError, match="material_ids: expected 0 to 0"):
        rs.Scene.shapes(users.ball, BALLS, material_ids=1)


def test_no_shapes_are_no_error() -> None:
    for structure in ("bvh", "brute"):
        tracer = rs.Tracer(rs.Scene.shapes(users.ball, BALLS[:0]), structure)
        assert not tracer.first_hit(*RAY).is_hit


# check()


@pytest.mark.parametrize("name", CASES)
def test_sound_shapes_pass(name) -> None:
    shape, make, _ = CASES[name]
    if name != "quadric":  # it is cut off by its bounds
        shape.check(make(np.random.default_rng(0), 10), lines=32)


def test_bounds_that_lie_are_found() -> None:
    def bounds(ball: Any) -> Any:
        (x, y, z), r = ball.center, ball.radius
        top = r if z < 6.0 else 0.8 * r
        return (x - r, y - r, z - r), (x + r, y + r, z + top)

    text = rf"bounds: {place_of(bounds)}: record 1: the crossing at \(.*\) is outside its bounds"
    with pytest.raises(ValueError, match=text):
        balls(bounds=bounds).check(BALLS)


def test_distances_and_normals_that_lie_are_found() -> None:
    def twice(ball: Any, point: Any) -> Any:
        x, y, z = ball.center
        length = math.sqrt((point[0] - x) ** 2 + (point[1] - y) ** 2 + (point[2] - z) ** 2)
        return 2.0 * (length - ball.radius)

    def other(ball: Any, point: Any) -> Any:
        return 0.5

    def none(ball: Any, point: Any) -> Any:
        return 0.0, 0.0, 0.0

    with pytest.raises(ValueError, match=f"{place_of(twice)}: record 0: .* but a crossing is"):
        balls(distance=twice).check(BALLS[:1])
    with pytest.raises(
        ValueError, match=f"{place_of(other)}: record .*: the distance of the cross"
    ):
        balls(distance=other).check(BALLS)
    with pytest.raises(ValueError, match=f"{place_of(none)}: record .*: there is no normal"):
        balls(normal=none).check(BALLS)


def test_distances_from_points_that_are_not_numbers() -> None:
    def distance(ball: Any, point: Any) -> float:
        return math.nan if ball.center[2] < 6.0 else 1.0

    tracer = rs.Tracer(rs.Scene.shapes(balls(distance=distance), BALLS))
    text = rf"distance: {place_of(distance)}: returned a distance that is NaN, for record 0"
    for name in ("closest_point", "signed_distance"):
        with pytest.raises(rs.RaystreamError, match=text):
            getattr(tracer, name)([0.0, 0.0, 0.0])


def test_hits_without_a_normal_are_no_error() -> None:
    def normal(ball: Any, point: Any) -> Any:
        return 0.0, 0.0, 0.0

    tracer = rs.Tracer(rs.Scene.shapes(balls(normal=normal), BALLS))
    hits = tracer.first_hit([[0.0, 0.0, 0.0], [0.0, 0.5, 0.0]], [0.0, 0.0, 1.0])
    known = rs.Tracer(rs.Scene.shapes(balls(), BALLS)).first_hit(hits.positions * [1, 1, 0], RAY[1])
    assert np.abs(hits.positions - known.positions).max() < 1e-5
    assert np.abs(hits.normals - known.normals).max() < 1e-5  # outwards from the middle
    assert np.isfinite(hits.spawn([0.0, 0.0, -1.0])).all()


def test_records_in_another_byte_order() -> None:
    swapped = BALLS.astype(BALLS.dtype.newbyteorder())
    own, other = (rs.Tracer(rs.Scene.shapes(users.ball, one)) for one in (BALLS, swapped))
    assert own.first_hit(*RAY).t == other.first_hit(*RAY).t


def test_what_shapes_cannot_be() -> None:
    scene = rs.Scene.shapes(users.ball, BALLS)
    with pytest.raises(ValueError, match="shapes of users, which cannot be instances; "):
        rs.Scene.instances(scene, np.eye(3, 4))
    with pytest.raises(ValueError, match="meshes: all other geometry would be lost"):
        scene.replace(meshes=[rs.Mesh(np.eye(3), [[0, 1, 2]])])
    with pytest.raises(ValueError, match="other numbers of triangles, samples, spheres or shapes"):
        rs.Tracer(scene).update(rs.Scene.shapes(users.ball, BALLS[:1]))


def test_a_bound_of_the_distance_is_found() -> None:
    def distance(ball: Any, point: Any) -> float:
        place = point[0] - ball.center[0], point[1] - ball.center[1], point[2] - ball.center[2]
        return 0.25 * (math.hypot(math.hypot(place[0], place[1]), place[2]) - ball.radius)

    shape = balls(distance=distance)
    with pytest.raises(ValueError, match=rf"{place_of(distance)}: record 0: its steps along the"):
        shape.check(BALLS)
    balls().check(BALLS)

"""Picking: all hits along a pixel's ray, and the ray's walk."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest

import raystream as rs
from raystream.scene.camera import Camera
from raystream.stepper import walk
from raystream.viewer.messages import MessageError
from raystream.viewer.picking import hits_along, pixel_ray
from raystream.viewer.walks import MAX_STEPS, walk_along

SIZE = 32, 24


@pytest.fixture(scope="module")
def scene():
    return rs.load("cornell")


def ray_at(scene, x, y, number=1):
    return pixel_ray({"number": number, "x": x, "y": y}, scene.camera, SIZE)


@pytest.mark.parametrize(("x", "y"), [(0.5, 0.5), (0.0, 0.0), (1.0, 1.0), (0.31, 0.77)])
def test_a_ray_is_that_of_its_pixel(scene, x, y):
    ray = ray_at(scene, x, y)
    column, row = min(int(32 * x), 31), min(int(24 * y), 23)
    seen = rs.render(scene, size=SIZE, layers=["prim_id"]).layers["prim_id"]
    found = hits_along(rs.Tracer(scene), ray)
    first = found["hits"][0]["prim_id"] if found["hits"] else -1
    assert first == seen[row, column]


def test_all_layers_are_told(scene):
    tracer, ray = rs.Tracer(scene), ray_at(scene, 0.46, 0.5)
    found = hits_along(tracer, ray)
    many = tracer.multi_hit(ray.origin, ray.direction)
    assert found["total"] == len(many.t) == 3
    assert [row["t"] for row in found["hits"]] == many.t.tolist()
    assert [row["prim_id"] for row in found["hits"]] == many.prim_id.tolist()
    first = found["hits"][0]
    assert (first["mesh"], first["material"]) == ("tall block", "white")
    assert np.allclose(first["position"], ray.origin + first["t"] * ray.direction)
    assert math.dist(first["normal"], [0, 0, 0]) == pytest.approx(1.0)
    json.dumps(found, allow_nan=False)


def test_instances_are_told_by_their_names(scene):
    row = np.tile(np.eye(3, 4), (2, 1, 1))
    row[1, 2, 3] = 2000.0
    placed = rs.Scene.instances(scene, row, names=["front", "back"], camera=scene.camera)
    found = hits_along(rs.Tracer(placed), ray_at(scene, 0.46, 0.5))
    assert {hit["mesh"] for hit in found["hits"]} == {"front", "back"}


def test_of_many_hits_only_the_first_are_told():
    sheets = np.arange(1500)[:, None, None] * [0, 0, 1.0] + [[0, 0, 1], [1, 0, 1], [0, 1, 1.0]]
    faces = np.arange(4500).reshape(-1, 3)
    scene = rs.Scene.from_arrays(sheets.reshape(-1, 3), faces)
    ray = pixel_ray(
        {"number": 1, "x": 0.5, "y": 0.5}, Camera((0.2, 0.2, 0.0), (0.2, 0.2, 1.0)), (3, 3)
    )
    found = hits_along(rs.Tracer(scene), ray)
    assert found["total"] == 1500
    assert [row["prim_id"] for row in found["hits"]] == list(range(1000))


@pytest.mark.parametrize("structure", ["bvh", "grid", "kdtree", "graph"])
def test_the_walk_is_that_of_the_stepper(scene, structure):
    tracer, ray = rs.Tracer(scene, structure), ray_at(scene, 0.4, 0.6)
    told = walk_along(tracer, ray)
    way = walk(tracer, ray.origin, ray.direction)
    assert told["walk_reason"] is None
    assert told["counts"] == told["walk"]["counts"] == way.counts
    steps = told["walk"]["steps"]
    assert [step["kernel"] for step in steps] == [step.kernel for step in way.steps]
    assert [step["tested"] for step in steps] == [list(step.tested) for step in way.steps]
    assert steps[-1]["prim_id"] == way.prim_id
    assert told["walk"]["more"] == 0
    json.dumps(told, allow_nan=False)


def test_a_long_walk_is_cut_off_and_says_so(scene):
    tracer = rs.Tracer(scene, "grid", resolution=(1, 1, 400))
    ray = pixel_ray(
        {"number": 1, "x": 0.5, "y": 0.5}, Camera((278, 548.5, -9), (278, 548.5, 0)), SIZE
    )
    told = walk_along(tracer, ray)
    assert len(told["walk"]["steps"]) == MAX_STEPS
    assert (told["walk"]["is_whole"], told["walk"]["more"]) == (False, None)
    assert told["counts"]["steps"] > MAX_STEPS


def test_brute_force_has_no_walk_but_counts(scene):
    told = walk_along(rs.Tracer(scene, "brute"), ray_at(scene, 0.5, 0.5))
    assert told["walk"] is None
    assert "brute" in told["walk_reason"]
    assert told["counts"]["tests"] == 36


@pytest.mark.parametrize(
    ("fields", "fault"),
    [
        ({"number": 1, "x": 0.5}, "y: is missing"),
        ({"number": 1, "x": 1.5, "y": 0.5}, "x: expected a number from 0 to 1"),
        ({"number": 1, "x": "left", "y": 0.5}, "x: expected a number"),
        ({"number": -1, "x": 0.5, "y": 0.5}, "number: expected an integer"),
    ],
)
def test_what_is_no_pixel_is_said(scene, fields, fault):
    with pytest.raises(MessageError, match=fault):
        pixel_ray(fields, scene.camera, SIZE)

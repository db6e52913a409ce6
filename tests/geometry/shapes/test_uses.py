"""A shape from outside the package in all queries, analyses, images and the viewer."""

from __future__ import annotations

import dataclasses
import pickle
from typing import Any

import numpy as np
import pytest

import raystream as rs
import users_shapes as users
from conftest import assert_same_bits
from raystream.viewer import RenderService
from raystream.viewer.picking import hits_along, pixel_ray
from users_shapes import CASES, rays_near, some
from viewer.pages import Page, decode

#: Two tori, one above the other; and rays through the tube of the first one.
TORI = np.array([((0.0, 0.0, 0.0), 2.0, 0.5), ((0.0, 0.0, 4.0), 2.0, 0.5)], users.TORUS)
ALONG_X = ([-9.0, 0.0, 0.0], [1.0, 0.0, 0.0])


def tori(**parts: Any) -> rs.Scene:
    return rs.Scene.shapes(users.torus, TORI, **parts)


@pytest.mark.parametrize("structure", ["bvh", "brute"])
def test_all_queries_of_a_torus(structure) -> None:
    tracer = rs.Tracer(tori(), structure)
    hits = tracer.multi_hit(*ALONG_X)
    assert hits.t.tolist() == [6.5, 7.5, 10.5, 11.5]
    assert hits.prim_id.tolist() == [0] * 4
    assert hits.mesh_id.tolist() == [0] * 4
    np.testing.assert_allclose(hits.positions[:, 0], [-2.5, -1.5, 1.5, 2.5], atol=2e-6)
    np.testing.assert_allclose(hits.normals[:, 0], [-1.0, 1.0, -1.0, 1.0], atol=2e-6)
    assert tracer.first_hit(*ALONG_X).t == 6.5
    assert tracer.first_hit(*ALONG_X, t_min=7.0).t == 7.5
    assert tracer.any_hit(*ALONG_X)
    assert not tracer.any_hit(*ALONG_X, t_max=6.0)
    assert tracer.count_hits(*ALONG_X) == 4
    assert tracer.count_hits(*ALONG_X, t_min=-np.inf, t_max=11.0) == 3
    assert len(tracer.multi_hit(*ALONG_X, max_hits=3).t) == 3
    assert tuple(tracer.cast(*ALONG_X))[::3] == (6.5, 0)
    again = tracer.first_hit([0.0, 2.0, 9.0], [0.0, 0.0, -2.0])
    assert (again.t, again.prim_id) == (2.25, 1)


def test_limits_belong_to_the_interval() -> None:
    tracer = rs.Tracer(tori())
    assert tracer.count_hits(*ALONG_X, t_min=7.5, t_max=10.5) == 2


def test_equal_distances_go_to_the_lowest_prim_id() -> None:
    twice = rs.Scene.shapes(users.torus, TORI[[0, 0]])
    for structure in ("bvh", "brute"):
        hits = rs.Tracer(twice, structure).multi_hit(*ALONG_X)
        assert hits.t.tolist() == [6.5, 6.5, 7.5, 7.5, 10.5, 10.5, 11.5, 11.5]
        assert hits.prim_id.tolist() == [0, 1] * 4


def test_counters_count_shapes() -> None:
    tracer = rs.Tracer(tori(), "brute", counters=True)
    tracer.first_hit(*ALONG_X)
    assert tracer.counters.tests.item() == 2


def test_filters_and_programs() -> None:
    rays = rays_near(np.random.default_rng(0), 800)
    scene = some(CASES, 1, 6)

    def leaves_odd(hit: Any) -> bool:
        return hit.prim_id % 2 == 1 and not hit.is_entering

    for structure in ("bvh", "brute"):
        tracer = rs.Tracer(scene, structure)
        hits = tracer.multi_hit(**rays)
        cosine = (hits.normals * rays["directions"][hits.ray_id]).sum(axis=1)
        keeps = (hits.prim_id % 2 == 1) & (cosine >= 0.0)
        wanted = np.bincount(hits.ray_id[keeps], minlength=800)
        assert_same_bits(tracer.count_hits(**rays, on_hit=leaves_odd), wanted)
        first = tracer.first_hit(**rays, on_hit=leaves_odd)
        rows = np.flatnonzero(keeps)
        ray_ids, at = np.unique(hits.ray_id[rows], return_index=True)
        wanted = np.full(800, np.inf, np.float32)
        wanted[ray_ids] = hits.t[rows[at]]
        assert_same_bits(first.t, wanted)
        skipping = tracer.first_hit(**rays, skip_prim_ids=tracer.first_hit(**rays).prim_id)
        assert (
            skipping.prim_id[skipping.is_hit] != hits.prim_id[hits.ray_splits[:-1]][skipping.is_hit]
        ).all()


def test_masks() -> None:
    both = rs.Scene.combine(
        [rs.Scene.shapes(users.torus, TORI[:1], mask=1), rs.Scene.shapes(users.torus, TORI, mask=2)]
    )
    for structure in ("bvh", "brute"):
        tracer = rs.Tracer(both, structure)
        assert tracer.first_hit(*ALONG_X, mask=2).prim_id == 1
        assert tracer.count_hits(*ALONG_X, mask=3) == 8
        assert not tracer.any_hit(*ALONG_X, mask=4)


def test_rays_leave_shapes() -> None:
    scene = some(["torus", "capsule", "rounded", "quadric"], 4, 30)
    tracer, rng = rs.Tracer(scene), np.random.default_rng(5)
    hits = tracer.first_hit(**rays_near(rng, 2000))
    hits = hits[hits.is_hit]
    outward = tracer.first_hit(*hits.spawn(hits.normals))
    near = outward.is_hit & (outward.t < 1e-3)
    assert not (near & (outward.prim_id == hits.prim_id)).any()


def test_closest_points_and_inside() -> None:
    tracer = rs.Tracer(tori())
    near = tracer.closest_point([[2.0, 0.0, 3.0], [4.0, 0.0, 0.5], [2.0, 0.0, 0.1]])
    np.testing.assert_allclose(near.distance, [0.5, np.hypot(2.0, 0.5) - 0.5, 0.4], atol=1e-12)
    assert near.prim_id.tolist() == [1, 0, 0]
    wanted = [2.0 + 0.5 * 2.0 / np.hypot(2.0, 0.5), 0.0, 0.25 / np.hypot(2.0, 0.5)]
    np.testing.assert_allclose(near.positions[1], wanted, atol=1e-9)
    points = np.random.default_rng(6).uniform(-3.0, 6.0, (2000, 3))
    inside = np.zeros(len(points), bool)
    distance = np.full(len(points), np.inf)
    for x, y, z in TORI["center"]:
        ring = np.hypot(np.hypot(points[:, 0] - x, points[:, 1] - y) - 2.0, points[:, 2] - z) - 0.5
        inside |= ring < 0.0
        distance = np.minimum(distance, np.abs(ring))
    for structure in ("bvh", "brute"):
        other = rs.Tracer(tori(), structure)
        assert_same_bits(other.contains(points), inside)
        assert_same_bits(other.contains(points, method="winding"), inside)
        found = other.signed_distance(points)
        np.testing.assert_allclose(np.abs(found), distance, atol=1e-12)
        assert_same_bits(found != np.abs(found), inside)


def test_closest_points_of_all_kinds_agree_with_brute_force() -> None:
    names = ["ball", "torus", "capsule", "tube", "rounded"]
    scene, points = some(names, 7, 12), np.random.default_rng(8).uniform(-6.0, 6.0, (800, 3))
    a, b = (rs.Tracer(scene, one).closest_point(points) for one in ("bvh", "brute"))
    for column in ("distance", "prim_id", "u", "v"):
        assert_same_bits(getattr(a, column), getattr(b, column))
    places = a.positions - points
    np.testing.assert_allclose(np.linalg.norm(places, axis=1), a.distance, atol=1e-5)


def test_what_has_no_distance_says_so() -> None:
    tracer = rs.Tracer(some(["disc"]))
    for call in (tracer.closest_point, tracer.contains, tracer.winding_number):
        with pytest.raises((rs.RaystreamError, ValueError), match="shapes without distance="):
            call([[0.0, 0.0, 0.0]])


def test_thickness_and_lidar() -> None:
    tracer = rs.Tracer(tori())
    found = rs.thickness(tracer, *ALONG_X)
    np.testing.assert_allclose(found.path_length, [1.0, 1.0], atol=1e-5)
    assert not len(found.unpaired_ray)
    scan = rs.lidar_returns(tracer, [ALONG_X[0]], ALONG_X[1])
    np.testing.assert_allclose(scan.ranges, [6.5], rtol=1e-6)
    np.testing.assert_allclose(scan.intensity, [1.0], atol=1e-5)


def test_visibility_and_visible_faces() -> None:
    tracer = rs.Tracer(tori())
    seen = rs.visibility(tracer, [ALONG_X[0]], [[-3.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0, 0, 9.0]])
    assert seen.tolist() == [[True, False, True]]
    hits = tracer.first_hit(np.tile(ALONG_X[0], (2, 1)), [[1.0, 0.0, 0.0], [9.0, 2.0, 4.0]])
    eyes = [ALONG_X[0], [9.0, 0.0, 0.0]]
    assert rs.visibility(tracer, eyes, hits)[:, 0].tolist() == [True, False]
    assert rs.visibility(tracer, eyes, hits)[0].tolist() == [True, True]
    # In an image of two by two pixels, rays pass beside the tori.
    camera = rs.Camera((-60.0, 0.0, 2.0), (0.0, 0.0, 2.0))
    found = rs.visible_faces(tracer, camera, size=(2, 2))
    assert found.prim_ids.tolist() == [0, 1]
    with pytest.raises(ValueError, match="those of hits, for shapes"):
        rs.surface_points(tracer, [0])


def test_images_and_heat_maps() -> None:
    scene = tori(materials=[rs.Material(diffuse=(0.8, 0.2, 0.1))])
    image = rs.render(scene, size=(40, 30))
    assert np.isfinite(image.pixels).all()
    assert image.pixels.max() > 0.0
    glass = dataclasses.replace(scene.materials[0], opacity=0.5)
    rs.render(scene.replace(materials=[glass]), "raycast", size=(16, 12))
    heat = rs.heatmap(rs.Tracer(scene, counters=True), size=(16, 12))
    assert heat.counts.max() > 0


def test_updates_move_shapes() -> None:
    tracer, moved = rs.Tracer(tori()), TORI.copy()
    moved["center"][:, 2] += 1.0
    tracer.update(rs.Scene.shapes(users.torus, moved))
    assert tracer.first_hit([2.0, 0.0, 9.0], [0.0, 0.0, -1.0]).t == 3.5
    with pytest.raises(ValueError, match="other numbers"):
        tracer.update(rs.Scene.shapes(users.torus, moved[:1]))


def test_copies_and_names() -> None:
    tracer = rs.Tracer(tori())
    again = pickle.loads(pickle.dumps(tracer.structure.triangles))
    assert len(again) == 2
    scene = rs.Scene.combine([rs.load("cornell"), tori(), some(["disc"])])
    count = len(scene.meshes)
    assert [scene.mesh_name(count), scene.mesh_name(count + 1)] == ["torus", "disc"]
    assert "2 of torus" in repr(scene)


def test_other_structures_and_devices_say_so() -> None:
    for structure in ("grid", "kdtree", "graph"):
        with pytest.raises(ValueError, match="shapes of users"):
            rs.Tracer(tori(), structure)


def test_files_are_loaded_with_the_scene(tmp_path) -> None:
    path = tmp_path / "tori.npz"
    rs.Tracer(tori()).save(path)
    assert rs.Tracer.load(path, tori()).first_hit(*ALONG_X).t == 6.5
    with pytest.raises(rs.FileFormatError, match="functions are not in files"):
        rs.Tracer.load(path)
    moved = TORI.copy()
    moved["minor"] = 0.4
    slower = rs.Shape(users.torus_bounds, users.torus_hits, normal=users.torus_normal, hits=4)
    for other in (rs.Scene.shapes(users.torus, moved), rs.Scene.shapes(slower, TORI)):
        with pytest.raises(rs.FileFormatError, match="other geometry"):
            rs.Tracer.load(path, other)


def test_the_viewer_shows_and_picks_them() -> None:
    camera = rs.Camera((-9.0, 0.0, 0.0), (0.0, 0.0, 0.0), up=(0.0, 0.0, 1.0))
    scene = tori(camera=camera)
    service = RenderService(scene, "tori", settings={"samples": 1})
    try:
        page = Page(service)
        frame = page.frame(done=True)
        assert decode(frame).std() > 10.0
        page.client.leave()
    finally:
        service.close()
    ray = pixel_ray({"number": 1, "x": 0.5, "y": 0.5}, camera, (33, 33))
    found = hits_along(rs.Tracer(scene), ray)
    assert found["total"] == 4
    assert [one["mesh"] for one in found["hits"]] == ["torus"] * 4
    np.testing.assert_allclose(found["hits"][0]["position"], [-2.5, 0.0, 0.0], atol=1e-5)

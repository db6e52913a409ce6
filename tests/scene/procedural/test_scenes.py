"""The built-in scenes: of the requested size, repeatable, valid, and lit."""

from __future__ import annotations

import numpy as np
import pytest

import raystream as rs
from raystream.scene.procedural import (
    BUILTIN,
    MAX_INSTANCED_TRIANGLES,
    MAX_TRIANGLES,
    MIN_TRIANGLES,
    generate,
)
from raystream.scene.procedural.building import BOOK_COLORS, inside_camera
from raystream.scene.procedural.forest import inside_camera as forest_inside_camera
from raystream.scene.procedural.forest import top_camera
from raystream.scene.procedural.rooms import BOOK, COLORS
from scene.procedural.closed import open_edges

#: Largest share by which the count may differ from targets of at least these.
CLOSENESS = ((0, 0.5), (36, 0.34), (100, 0.15), (10_000, 0.05), (100_000, 0.02))

BOX = {"floor", "ceiling", "back wall", "right wall", "left wall", "light"}

#: Meshes with edges that belong to one triangle only.
OPEN = {
    "cornell": BOX,
    "cornell_mirrors": BOX,
    "cornell_open": BOX | {"short block", "tall block"},
    "boxes": {"lamp"},
    "building": {"lawn"},
    "forest": {"ground", "leaves"},
    "robots": {"ground"},
}

#: The default counts, mostly of the papers' scenes, and how near the scenes come.
DEFAULTS = {
    "cornell": (36, 0),
    "cornell_mirrors": (36, 0),
    "cornell_open": (32, 0),
    "three_boxes": (36, 0),
    "cubes": (2064, 0),
    "spheres": (2064, 0),
    "boxes": (61_562, 0),
    "building": (1_500_000, 15_000),
    "forest": (1_000_000, 1_000),
    "robots": (71_708, 10),
}


def assert_close(name, target, count):
    share = [share for least, share in CLOSENESS if target >= least][-1]
    assert abs(count - target) <= share * target, f"{name}: {count} for {target}"


@pytest.mark.parametrize("name", BUILTIN)
def test_counts_come_close_to_targets(name):
    targets = [24, *range(36, 51), 60, 77, 99, 100, 150, 311, 480, 1000, 2222, 9999, 31_000]
    for target in targets:
        assert_close(name, target, generate(name, target).triangle_count)


@pytest.mark.parametrize("target", [100_000, 1_000_000])
@pytest.mark.parametrize("name", BUILTIN)
def test_large_counts_come_close_to_targets(name, target):
    assert_close(name, target, generate(name, target).triangle_count)


@pytest.mark.parametrize("name", BUILTIN)
def test_defaults_are_the_documented_counts(name):
    count, tolerance = DEFAULTS[name]
    assert BUILTIN[name].triangles == count
    assert abs(generate(name).triangle_count - count) <= tolerance


@pytest.mark.parametrize("name", BUILTIN)
@pytest.mark.parametrize("target", [24, 50, 333, 1000, 20_000])
def test_meshes_are_sound(name, target):
    scene = generate(name, target)
    assert scene.skipped_count == 0
    for mesh in scene.meshes:
        assert mesh.triangle_count > 0
        assert np.isfinite(mesh.vertices).all()
        assert len(np.unique(mesh.faces)) == len(mesh.vertices), f"{mesh}: unused vertices"
        if mesh.name not in OPEN.get(name, ()):
            assert open_edges(mesh.faces) == 0, mesh
        if mesh.normals is not None:
            np.testing.assert_allclose(np.linalg.norm(mesh.normals, axis=1), 1.0, atol=1e-4)
        if mesh.colors is not None:
            assert mesh.colors.min() >= 0.0
            assert mesh.colors.max() <= 1.0


@pytest.mark.parametrize("name", BUILTIN)
def test_no_triangle_of_a_large_scene_is_degenerate(name):
    assert generate(name, 300_000).skipped_count == 0


@pytest.mark.parametrize("name", BUILTIN)
def test_same_arguments_give_the_same_bits(name):
    for first, second in zip(
        generate(name, 30_000).meshes, generate(name, 30_000).meshes, strict=True
    ):
        for attribute in ("vertices", "faces", "normals", "colors", "texcoords", "material_ids"):
            one, other = getattr(first, attribute), getattr(second, attribute)
            assert (one is None) == (other is None)
            if one is not None:
                assert one.tobytes() == other.tobytes(), (first.name, attribute)


@pytest.mark.parametrize("name", BUILTIN)
def test_scenes_have_lights_and_use_their_materials(name):
    scene = generate(name)
    assert scene.lights or scene.area_lights
    used = np.unique(np.concatenate([mesh.material_ids for mesh in scene.meshes]))
    np.testing.assert_array_equal(used, np.arange(len(scene.materials)))
    assert scene.name == name


@pytest.mark.parametrize("name", BUILTIN)
@pytest.mark.parametrize("target", [36, 20_000, None])
def test_cameras_see_much_of_the_scene(name, target):
    scene = generate(name, target)
    assert visible_share(scene, scene.camera) > 0.2


def visible_share(scene, camera):
    """Share of vertices, those of the largest mesh, that lie within an image of 4:3."""
    mesh = max(scene.meshes, key=lambda mesh: mesh.triangle_count)
    right, up, ahead = camera.basis() @ (mesh.vertices - np.asarray(camera.eye)).T
    reach = np.tan(np.radians(camera.fov) / 2) * ahead
    return float(np.mean((ahead > 0) & (np.abs(up) < reach) & (np.abs(right) < reach * 4 / 3)))


def test_light_of_the_cornell_box_shines_down_from_below_the_ceiling():
    scene = generate("cornell", 500)
    (light,) = scene.area_lights
    corners = scene.triangles.corners[light.prim_ids].astype(np.float64)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert (normals[:, 1] < 0.0).all()
    assert np.abs(normals[:, 1]).sum() / 2 == pytest.approx(130 * 105, rel=1e-5)
    assert 540.0 < corners[..., 1].max() < 548.8


def test_polished_cornell_box_makes_no_light():
    matte, polished = generate("cornell"), generate("cornell_mirrors")
    seen = set()
    for one, other in zip(matte.meshes, polished.meshes, strict=True):
        np.testing.assert_array_equal(one.vertices, other.vertices)
        before = matte.materials[one.material_ids[0]]
        after = polished.materials[other.material_ids[0]]
        share = np.array(after.reflection)
        np.testing.assert_allclose(after.diffuse, (1.0 - share) * before.diffuse)
        assert after.emission == before.emission
        seen.add(after.reflection[0])
    assert seen == {0.0, 0.3, 0.8}


@pytest.mark.parametrize("target", [32, 1000])
def test_blocks_of_the_open_cornell_box_lack_only_their_bottoms(target):
    for mesh in generate("cornell_open", target).meshes[5:7]:
        corners = mesh.vertices[mesh.faces].astype(np.float64)
        assert (corners[..., 1].max(axis=1) > 0.0).all()
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        # The normals of the sides cancel, that of the top has no counterpart.
        np.testing.assert_allclose(normals.sum(axis=0)[[0, 2]], 0.0, atol=0.05)
        assert normals[:, 1].sum() / 2 > 20_000.0  # the top, square millimetres
    closed, opened = generate("cornell"), generate("cornell_open")
    for one, other in zip(closed.meshes, opened.meshes, strict=True):
        np.testing.assert_array_equal(one.vertices, other.vertices)


def test_cubes_are_apart_and_inside_the_room():
    room, cubes = generate("cubes").meshes
    corners = cubes.vertices.reshape(-1, 8, 3)
    assert len(corners) == 171
    assert (room.vertices.min(axis=0) < cubes.vertices.min(axis=0)).all()
    assert (cubes.vertices.max(axis=0) < room.vertices.max(axis=0)).all()
    low, high = corners.min(axis=1), corners.max(axis=1)
    overlap = (low[:, None] <= high[None]) & (low[None] <= high[:, None])
    np.testing.assert_array_equal(overlap.all(axis=2), np.eye(171, dtype=bool))


def test_three_boxes_stand_on_each_other():
    base, *boxes = generate("three_boxes").meshes
    assert len(boxes) == 2
    for mesh in boxes:
        assert mesh.vertices[:, 1].min() == base.vertices[:, 1].max() == 0.0
        assert (np.abs(mesh.vertices) < np.abs(base.vertices).max(axis=0))[:, [0, 2]].all()


def test_walls_of_the_cornell_box_face_inward():
    scene = generate("cornell")
    for mesh in scene.meshes[:5]:
        corners = mesh.vertices[mesh.faces].astype(np.float64)
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        inward = np.array([278.0, 274.0, 280.0]) - corners.mean(axis=1)
        assert (np.einsum("fk,fk->f", normals, inward) > 0.0).all(), mesh.name


def test_robots_are_small_and_dense_in_a_huge_city():
    scene = generate("robots")
    robots = next(mesh for mesh in scene.meshes if mesh.name == "robots")
    extent = scene.bounds[1] - scene.bounds[0]
    crowd = robots.vertices.max(axis=0) - robots.vertices.min(axis=0)
    assert robots.triangle_count > 0.8 * scene.triangle_count
    assert np.prod(crowd) < 1e-6 * np.prod(extent)
    assert robots.vertices[:, 1].min() >= -1e-4


def test_other_views_stand_inside_and_above():
    building, forest = generate("building", 50_000), generate("forest", 50_000)
    for scene, view in (
        (building, inside_camera(building)),
        (forest, forest_inside_camera(forest)),
    ):
        low, high = scene.bounds
        assert (low < view.eye).all()
        assert (view.eye < high).all()
    view = top_camera(forest)
    assert view.eye[1] > forest.bounds[1, 1]
    assert visible_share(forest, view) > 0.8


@pytest.mark.parametrize("name", BUILTIN)
def test_sizes_out_of_range_are_refused(name):
    for size in (0, -1, MIN_TRIANGLES - 1, MAX_TRIANGLES + 1, 2**31, 10**12):
        with pytest.raises(ValueError, match="triangles: expected 24 to 500,000,000"):
            generate(name, size)
    for size in (1e6, "1000", True):
        with pytest.raises(TypeError, match="triangles: expected an integer"):
            generate(name, size)


INSTANCED = [name for name, one in BUILTIN.items() if one.make_instanced]


@pytest.mark.parametrize("target", [60, 1000, 30_000])
@pytest.mark.parametrize("name", INSTANCED)
def test_scenes_of_instances_have_the_same_triangles(name, target):
    """In the same order, by mesh, but for rooms; these and trees have other shades."""
    plain, instanced = generate(name, target), generate(name, target, instances=True)
    assert instanced.placements is not None
    copies = {mesh.name: [] for mesh in plain.meshes}
    for mesh in instanced.flattened().meshes:
        copies[mesh.name].append(mesh)
    assert set(copies) == {mesh.name for mesh in instanced.meshes}
    for mesh in plain.meshes:
        own = copies[mesh.name]
        if name == "building" and len(own) > 1 and mesh.name != "furnishings":
            assert sum(one.triangle_count for one in own) == mesh.triangle_count
            continue
        placed = np.concatenate([one.vertices[one.faces] for one in own])
        reach = np.abs(mesh.vertices).max()
        np.testing.assert_allclose(placed, mesh.vertices[mesh.faces], atol=4e-7 * reach, rtol=0)
        ids = np.concatenate([one.material_ids for one in own])
        np.testing.assert_array_equal(ids, mesh.material_ids)
        if name != "forest":
            colors = np.concatenate(
                [np.ones((len(m.vertices), 3)) if m.colors is None else m.colors for m in own]
            )
            np.testing.assert_allclose(colors, 1.0 if mesh.colors is None else mesh.colors)
    for part in ("camera", "lights", "background", "name"):
        assert repr(getattr(instanced, part)) == repr(getattr(plain, part))


def test_a_building_of_instances_has_the_same_rooms():
    """Those at the back are mirrored; the first of a corridor has stairs."""
    plain, instanced = (
        rs.load("building", triangles=30_000, instances=own) for own in (False, True)
    )
    assert len(instanced.placements) > 50
    rng = np.random.default_rng(0)
    low, high = plain.meshes[1].vertices.min(axis=0), plain.meshes[1].vertices.max(axis=0)
    rays = rng.uniform(low - 1.0, high + 1.0, (20_000, 3)), rng.normal(size=(20_000, 3))
    hits, same = rs.Tracer(plain).first_hit(*rays), rs.Tracer(instanced).first_hit(*rays)
    np.testing.assert_allclose(same.t, hits.t, rtol=1e-4, atol=1e-4)
    walls = [one.colors for one in instanced.meshes if one.name == "walls and furniture"]
    colors = np.concatenate(walls)
    paints = np.concatenate([np.delete(COLORS, BOOK, axis=0), BOOK_COLORS])
    ratios = colors[:, None] / paints[None]
    is_paint = (np.ptp(ratios, axis=2) < 1e-4) & (ratios[..., 0] > 0.939) & (ratios[..., 0] < 1.001)
    assert is_paint.any(axis=1).all()
    assert is_paint.any(axis=0).all()
    cosines = np.einsum("nk,nk->n", hits.normals, same.normals)[hits.is_hit]
    assert (cosines > 0.999).mean() > 0.99  # but where boxes touch


@pytest.mark.parametrize("name", INSTANCED)
def test_a_billion_triangles_are_few_in_memory(name):
    """Scenes that are too large for copies are made of instances."""
    scene = rs.load(f"{name}:1000000000")
    placed = scene.placements
    assert scene.triangle_count < 3_000_000
    first_ids = scene.geometry.triangles.first_ids
    assert abs(first_ids[-1] - 1e9) < 1e6
    assert len(first_ids) == len(placed) + 1


def test_only_some_scenes_have_instances():
    message = "instances: only for glTF files and the built-in scenes building, forest, robots, "
    message += "not for"
    with pytest.raises(ValueError, match=message):
        rs.load("cornell", instances=True)
    for name in INSTANCED:
        with pytest.raises(ValueError, match="expected 24 to 2,000,000,000"):
            rs.load(name, triangles=MAX_INSTANCED_TRIANGLES + 1)
        assert rs.load(name, triangles=500, instances=True).placements is not None
        assert rs.load(name, triangles=500).placements is None
    with pytest.raises(ValueError, match="expected 24 to 500,000,000"):
        rs.load("boxes", triangles=MAX_TRIANGLES + 1)
    with pytest.raises(ValueError, match="not for samples"):
        rs.load("bunny", instances=True)


def test_numpy_integers_are_sizes():
    assert generate("spheres", np.int64(2064)).triangle_count == 2064


def test_unknown_names_are_refused_with_the_known_ones():
    with pytest.raises(ValueError, match=r"no built-in scene 'castle'.*cornell.*robots"):
        generate("castle")
    assert all("\n" not in builtin.description for builtin in BUILTIN.values())

"""Files of scenes with instances, spheres and height fields, and in float64."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import raystream as rs
from conftest import assert_same_bits
from meshes import icosphere
from raystream.core.npz import read_npz, write_npz

ROUND = rs.Scene.from_arrays(*icosphere(1))
FIELD = rs.Scene.height_field(np.eye(4), origin=(-2, -2, 0))
BALLS = rs.Scene.spheres([[0, 0, 3], [1, 1, 4]], [1.0, 0.5])
PLACES = np.stack([np.eye(3, 4), np.eye(3, 4) + [0, 0, 0, 1.5]])
SCENES: dict[str, tuple[rs.Scene, dict[str, Any]]] = {
    "spheres": (BALLS, {}),
    "fields": (FIELD, {}),
    "all primitives": (rs.Scene.combine([ROUND, FIELD, BALLS]), {}),
    "instances": (rs.Scene.instances([ROUND, ROUND], PLACES, [0, 1]), {}),
    "worlds": (rs.Scene.instances(ROUND, PLACES, worlds=[0, 1]), {}),
    "float64": (ROUND, {"precision": "float64"}),
}


@pytest.mark.parametrize("structure", ["bvh", "brute"])
@pytest.mark.parametrize("kind", SCENES)
def test_a_file_gives_the_same_hits(kind: str, structure: str, tmp_path: Path) -> None:
    scene, options = SCENES[kind]
    tracer = rs.Tracer(scene, structure, **options)
    path = tmp_path / "a.npz"
    tracer.save(path)
    rng = np.random.default_rng(1)
    rays = rng.uniform(-3.0, 3.0, (400, 3)), rng.normal(size=(400, 3))
    worlds = {"worlds": rng.integers(0, 2, 400)} if kind == "worlds" else {}
    wanted = tracer.first_hit(*rays, **worlds)
    for given in (None, scene):
        found = rs.Tracer.load(path, given).first_hit(*rays, **worlds)
        for name in ("t", "u", "v", "prim_id", "instance_id", "mesh_id"):
            assert_same_bits(getattr(found, name), getattr(wanted, name))


def test_another_scene_is_recognised(tmp_path: Path) -> None:
    rs.Tracer(BALLS).save(tmp_path / "a.npz")
    other = rs.Scene.spheres([[0, 0, 3], [1, 1, 4]], [1.0, 0.75])
    for scene in (other, FIELD, ROUND):
        with pytest.raises(rs.FileFormatError, match="other geometry than the scene's"):
            rs.Tracer.load(tmp_path / "a.npz", scene)


@pytest.mark.parametrize(
    ("kind", "name", "value"),
    [
        ("spheres", "spheres.radii", [1.0, -1.0]),
        ("spheres", "spheres.radii", [1.0]),
        ("spheres", "spheres.centers", [[0.0, 0.0, np.nan]] * 2),
        ("spheres", "spheres.material_ids", [0.5, 0.5]),
        ("fields", "field0.x", [0.0, 1.0, 0.5, 2.0]),
        ("fields", "field0.y", [0.0, 1.0, np.nan, 2.0]),
        ("fields", "field0.y", [0.0, 1.0, 2.0, 1e300]),
        ("fields", "field0.base", [0.0, -1.0]),
        ("fields", "field0.base", [0.0, 2.0**31 - 1.0]),  # a scene has as many materials
        ("fields", "field0.base", [1e300, 0.0]),
        ("spheres", "spheres.material_ids", np.array([0, 2**31 - 1], np.int32)),
        ("fields", "field0.heights", [0.0]),
        ("float64", "faces", np.array([[0, 1, 999]])),
        ("float64", "mesh_splits", np.array([0, 999])),
        ("instances", "object_ids", np.array([0, 2], np.int32)),
        ("instances", "transforms", np.zeros((2, 3, 4))),
        ("instances", "mesh_splits", np.array([0, 1])),
        ("worlds", "worlds", np.array([0, -2], np.int32)),
    ],
)
def test_damaged_files_are_refused(kind: str, name: str, value: Any, tmp_path: Path) -> None:
    scene, options = SCENES[kind]
    path = tmp_path / "a.npz"
    rs.Tracer(scene, **options).save(path)
    write_npz(path, {**read_npz(path), f"triangles.{name}": np.asarray(value)})
    with pytest.raises(rs.FileFormatError):
        rs.Tracer.load(path)


@pytest.mark.parametrize("other", [ROUND, BALLS], ids=["meshes", "spheres"])
def test_objects_of_both_precisions_are_refused(other: rs.Scene, tmp_path: Path) -> None:
    path, objects = tmp_path / "a.npz", [other, ROUND]
    rs.Tracer(rs.Scene.instances([ROUND, ROUND], PLACES, [0, 1]), precision="float64").save(path)
    wide = read_npz(path)
    rs.Tracer(rs.Scene.instances(objects, PLACES, [0, 1])).save(path)
    begin = "triangles.object1."
    mixed = {name: one for name, one in read_npz(path).items() if not name.startswith(begin)}
    write_npz(path, mixed | {name: one for name, one in wide.items() if name.startswith(begin)})
    with pytest.raises(rs.FileFormatError, match="float32 beside others in float64"):
        rs.Tracer.load(path)


@pytest.mark.parametrize("precision", ["float32", "float64"])
def test_instances_of_all_bits_keep_them(precision: Any, tmp_path: Path) -> None:
    faint = rs.Mesh(*icosphere(1)).with_mask(2)
    scene = rs.Scene.instances(faint, PLACES, masks=[2**32 - 1, 2**32 - 1])
    tracer = rs.Tracer(scene, precision=precision)
    tracer.save(tmp_path / "a.npz")
    for given in (None, scene):
        loaded = rs.Tracer.load(tmp_path / "a.npz", given)
        assert loaded.count_hits([0.1, 0.2, -9.0], [0.0, 0.0, 1.0], mask=1) == 2


def test_many_objects_and_fields(tmp_path: Path) -> None:
    count = 350
    places = np.tile(np.eye(3, 4), (count, 1, 1))
    places[:, 0, 3] = 3.0 * np.arange(count)
    meshes = [rs.Mesh(*icosphere(0)).with_mask(k % 2 + 1) for k in range(count)]
    objects = rs.Scene.instances(meshes, places, np.arange(count))
    fields = [rs.Scene.height_field(np.eye(2) + k, mask=k % 2 + 1) for k in range(count)]
    for scene in (objects, rs.Scene.combine(fields)):
        tracer = rs.Tracer(scene)
        tracer.save(tmp_path / "a.npz")
        loaded = rs.Tracer.load(tmp_path / "a.npz")
        origins = np.array([[3.0 * k + 0.2, 0.1, -9.0] for k in range(count)])
        for mask in (1, 2):
            found, wanted = (
                one.multi_hit(origins, [0.0, 0.0, 1.0], mask=mask) for one in (loaded, tracer)
            )
            assert len(wanted.t)
            for name in ("t", "prim_id", "instance_id", "mesh_id"):
                assert_same_bits(getattr(found, name), getattr(wanted, name))


@pytest.mark.parametrize("kind", ["spheres", "fields", "all primitives"])
def test_moved_primitives_are_where_they_moved(kind: str) -> None:
    field = rs.Scene.height_field(1.0 - np.eye(4), origin=(-1, -2, 1))
    balls = rs.Scene.spheres([[0, 1, 3], [1, -1, 4]], [0.5, 1.5])
    moved = {"spheres": balls, "fields": field}.get(kind, rs.Scene.combine([ROUND, field, balls]))
    tracer = rs.Tracer(SCENES[kind][0])
    assert tracer.update(moved).rebuilt
    rng = np.random.default_rng(2)
    rays = rng.uniform(-3.0, 3.0, (400, 3)), rng.normal(size=(400, 3))
    found, wanted = tracer.first_hit(*rays), rs.Tracer(moved).first_hit(*rays)
    assert_same_bits(found.t, wanted.t)
    assert_same_bits(found.prim_id, wanted.prim_id)
    with pytest.raises(ValueError, match="make another tracer"):
        tracer.update(rs.Scene.spheres([[0, 0, 0]], 1.0))

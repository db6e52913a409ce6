"""Bundles arrive unchanged and once, through mapped files or over the network."""

from __future__ import annotations

import json
import os
import sys
import tempfile
from pathlib import Path

import numpy as np
import pytest

from extras import need

need("distributed")

import raystream as rs
from conftest import assert_same_bits
from raystream.cluster import bundles, folder, scene_bundles, scheduler_store, uploader
from raystream.cluster.errors import ClusterError


def rich_scene() -> rs.Scene:
    """Everything that a scene can have beside a camera."""
    rng = np.random.default_rng(3)
    picture = rs.Texture(
        rng.integers(0, 255, (4, 5, 3), np.uint8),
        name="p",
        wrap=("mirror", "clamp"),
        transform=(1, 0, 0.5, 0, 2, 1 / 3),
    )
    materials = [
        rs.Material("a", textures={"diffuse": picture, "opacity": picture}, alpha_cutoff=0.5),
        rs.Material("b", emission=(1.0, 0.1, 1e-30), roughness=0.3, double_sided=False),
        rs.Material("c", textures={"bump": rs.Texture(b"no image"), "diffuse": picture}),
    ]
    vertices = rng.random((6, 3))
    faces = [[0, 1, 2], [3, 4, 5]]
    pale = np.column_stack([vertices, vertices[:, 0]])
    attributes = {"normals": vertices, "colors": vertices, "texcoords": vertices[:, :2]}
    lights = [
        rs.PointLight((1, 2, 3), falloff="none"),
        rs.DirectionalLight((0, -1, 0), (0.1, 0.2, 1 / 3)),
        rs.EnvironmentLight((1, 1, 2), rng.random((2, 4, 3)), up=(0, 0, 1), rotation=20.0),
        rs.EnvironmentLight(),
        rs.SpotLight((1, 2, 3), (0, 0, -1), (0.1, 0.2, 1 / 3), 5, 50),
    ]
    return rs.Scene(
        [
            rs.Mesh(vertices, faces, material_ids=[0, 1], name="one", **attributes),
            rs.Mesh(vertices.astype(np.float32) + 2, faces[:1], material_ids=2, colors=pale),
            rs.Mesh(np.empty((0, 3)), np.empty((0, 3), int)),
        ],
        materials=materials,
        lights=lights,
        background=(0.25, 0.5, 1 / 7),
        up=(0, 0, 2),
        name="all",
    )


def test_a_scene_comes_out_as_it_went_in():
    scene = rich_scene()
    bundle = bundles.Bundle(*scene_bundles.pack_scene(scene))
    manifest = bundles.Manifest.read(bundle.manifest().text)
    found = scene_bundles.unpack_scene(manifest.header, bundle.arrays)
    for mesh, other in zip(scene.meshes, found.meshes, strict=True):
        assert mesh.name == other.name
        for name in ("vertices", "faces", "normals", "colors", "texcoords", "material_ids"):
            one, two = getattr(mesh, name), getattr(other, name)
            assert (one is None) == (two is None)
            if one is not None:
                assert_same_bits(one, two)
    for material, other in zip(scene.materials, found.materials, strict=True):
        plain = {**vars(material), "textures": None}
        assert plain == {**vars(other), "textures": None}
        assert list(material.textures) == list(other.textures)
    picture = found.materials[0].textures["diffuse"]
    assert picture is found.materials[0].textures["opacity"]
    assert picture is found.materials[2].textures["diffuse"]
    assert_same_bits(picture.pixels(), scene.materials[0].textures["diffuse"].pixels())
    assert (picture.name, picture.wrap) == ("p", ("mirror", "clamp"))
    assert picture.transform == (1, 0, 0.5, 0, 2, 1 / 3)
    with pytest.raises(rs.FileFormatError):
        found.materials[2].textures["bump"].pixels()
    assert found.lights[:2] == scene.lights[:2]
    assert vars(found.lights[3]) == vars(scene.lights[3])
    assert found.lights[4] == scene.lights[4]
    image, other = scene.lights[2], found.lights[2]
    assert (image.radiance, image.up, image.rotation) == (other.radiance, other.up, other.rotation)
    assert_same_bits(image.image, other.image)
    assert found.background == scene.background
    assert_same_bits(found.up, scene.up)


def test_a_bundle_is_named_by_its_content():
    def name(numbers, header="x"):
        return bundles.Bundle({"a": header}, {"n": np.array(numbers)}).manifest().digest

    assert name([1.0, 2.0]) == name([1.0, 2.0])
    others = [name([1.0, 2.5]), name([1, 2]), name([[1.0, 2.0]]), name([1.0, 2.0], "y")]
    assert len({name([1.0, 2.0]), *others}) == 5


def test_an_array_is_named_by_its_numbers_its_shape_and_its_dtype():
    zeros = [np.zeros(6), np.zeros((2, 3)), np.zeros((3, 2)), np.zeros(6, np.int64)]
    assert len({bundles.digest_of(array) for array in zeros}) == 4
    assert bundles.digest_of(np.zeros((3, 2))) == bundles.digest_of(np.zeros((2, 3)).T)


@pytest.mark.parametrize(
    "change",
    [
        {"format": "another"},
        {"arrays": {"n": ["00", "|O", [2]]}},
        {"arrays": {"n": ["00", "<f4"]}},
        {"arrays": 3},
        {"raystream": "0.0.1"},
        {"version": 99},
    ],
)
def test_invalid_bundles_are_rejected(change):
    text = bundles.Bundle({}, {"n": np.zeros(2)}).manifest().text
    with pytest.raises(ClusterError, match=r"not a raystream bundle|same version on all"):
        bundles.Manifest.read(json.dumps({**json.loads(text), **change}))
    with pytest.raises(ClusterError, match="not a raystream bundle"):
        bundles.Manifest.read(text[:-5])


def test_only_the_folder_itself_is_mapped(tmp_path):
    own = folder.SharedFolder()
    numbers = np.arange(12.0).reshape(3, 4)
    bundle = bundles.Bundle({}, {"n": numbers})
    place = bundle.manifest().arrays["n"]
    own.add(place.digest, numbers)
    where = {"machine": folder.machine_name(), "path": own.path, "token": own.token}
    mapped = folder.map_array(where, place)
    assert_same_bits(mapped, numbers)
    mapped[0] = 7.0  # a private copy from now on
    assert_same_bits(folder.map_array(where, place), numbers)
    assert folder.map_array({**where, "token": "another"}, place) is None
    assert folder.map_array({**where, "machine": "another"}, place) is None
    assert folder.map_array({**where, "path": str(tmp_path)}, place) is None
    wrong = bundles.ArrayRef(place.digest, place.dtype, (4, 3))
    assert folder.map_array(where, wrong) is None
    np.save(Path(own.path) / "00.npy", np.array([{}], object), allow_pickle=True)
    assert folder.map_array(where, bundles.ArrayRef("00", "|O", (1,))) is None
    assert Path(own.path).stat().st_mode & 0o077 == 0
    own.close()
    assert not Path(where["path"]).exists()
    assert folder.map_array(where, place) is None


def arrays_held(dask_scheduler):
    return len(dask_scheduler.plugins["raystream-store"]._arrays)


@pytest.mark.skipif(sys.platform != "linux", reason="looks at Linux's list of maps")
def test_workers_of_this_machine_map_one_file(client, room):
    own = uploader.uploader_of(client)
    with rs.cluster.Tracer(room, client, "kdtree") as tracer:
        tracer.first_hit(np.zeros((40, 3)), np.ones((40, 3))).compute()
        path = own.where["path"]
        # A function without a name travels as a whole: workers cannot import this file.
        seen = client.run(lambda: Path("/proc/self/maps").read_text(encoding="ascii").count(path))
        assert any(seen.values())
        assert client.run_on_scheduler(arrays_held) > 0
    assert client.run_on_scheduler(arrays_held) == 0
    assert os.listdir(path) == ["token"]


def test_arrays_go_over_the_wire_where_no_file_is_shared(cluster, room, monkeypatch):
    from distributed import Client

    def full(*_, **__):
        raise OSError("no space")

    monkeypatch.setattr(tempfile, "mkdtemp", full)
    monkeypatch.setattr(scheduler_store, "BLOCK_BYTES", 1000)
    monkeypatch.setattr(uploader, "BLOCK_BYTES", 700)
    directions = np.random.default_rng(1).normal(size=(50, 3))
    # Another structure than elsewhere: workers may still have that one's arrays.
    local = rs.Tracer(room, max_leaf_size=2)
    with Client(cluster, set_as_default=False) as client:
        with rs.cluster.Tracer(local, client) as tracer:
            assert uploader.uploader_of(client).where["path"] == ""
            hits = tracer.first_hit(room.camera.eye, directions).compute(scheduler=client)
            assert_same_bits(hits.t, local.first_hit(room.camera.eye, directions).t)
            held = client.run_on_scheduler(arrays_held)
        kept = rs.cluster.Tracer(local, client)
        assert client.run_on_scheduler(arrays_held) == held > 0
        del kept
    with Client(cluster, set_as_default=False) as client:  # the other one left
        assert client.run_on_scheduler(arrays_held) == 0

"""Ray files of scenes with instances: the tracer's bits, with the instance of each hit."""

from __future__ import annotations

import numpy as np
import pytest

from extras import need

need("zarr")

import raystream as rs
from conftest import assert_same_bits
from instanced import random_transforms
from meshes import cube, icosphere
from ray_stores import read_store, write_store
from raystream.core.errors import FileFormatError, RaystreamError
from raystream.ray_files import block_query


@pytest.fixture(scope="module")
def scene():
    objects = [rs.Scene.from_arrays(*mesh) for mesh in (cube(), icosphere(1))]
    transforms = random_transforms(np.random.default_rng(1), 20, 4.0)
    return rs.Scene.instances(objects, transforms, np.arange(20) % 2)


@pytest.fixture
def rays(rng):
    origins = rng.uniform(-8.0, 8.0, (1000, 3))
    return {"origins": origins, "directions": rng.uniform(-4.0, 4.0, (1000, 3)) - origins}


@pytest.mark.parametrize("query", ["first_hit", "any_hit", "count_hits", "multi_hit"])
def test_hits_are_the_tracers(query, scene, rays, tmp_path, monkeypatch):
    monkeypatch.setattr(block_query, "HITS_PER_RAY", 1)
    tracer = rs.Tracer(scene)
    store = write_store(tmp_path / "rays.zarr", rays, (300,))
    rs.query_zarr(tracer, store, tmp_path / "hits.zarr", query, block_rays=200)
    found = read_store(tmp_path / "hits.zarr")
    expected = getattr(tracer, query)(**rays)
    reports = query in ("first_hit", "multi_hit")
    assert ("instance_id" in found) == reports
    for name, column in found.items():
        is_array = isinstance(expected, np.ndarray)
        assert_same_bits(column, expected if is_array else getattr(expected, name))
    if reports:
        assert len(np.unique(found["instance_id"])) > 15


def test_runs_resume_where_the_instances_are_the_same(scene, rays, tmp_path):
    store = write_store(tmp_path / "rays.zarr", rays, (300,))
    output = tmp_path / "hits.zarr"

    def stop(done, total):
        if done > 400:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        rs.query_zarr(rs.Tracer(scene), store, output, block_rays=200, progress=stop)
    moved = scene.with_transforms(scene.placements.transforms + [0.0, 0.0, 0.0, 1e-9])
    with pytest.raises(FileFormatError, match="different: the scene"):
        rs.query_zarr(rs.Tracer(moved), store, output, block_rays=200, resume=True)
    report = rs.query_zarr(rs.Tracer(scene), store, output, block_rays=200, resume=True)
    assert report.rays_before >= 200
    expected = rs.Tracer(scene).first_hit(**rays)
    assert_same_bits(read_store(output)["instance_id"], expected.instance_id)
    # The columns of another scene replace them.
    plain = rs.Tracer(rs.Scene.from_arrays(*cube()))
    rs.query_zarr(plain, store, output)
    assert "instance_id" not in read_store(output)


def test_runs_resume_where_the_faces_are_the_same(rays, tmp_path):
    store, output = write_store(tmp_path / "rays.zarr", rays, (300,)), tmp_path / "hits.zarr"

    def stop(done, total):
        if done > 400:
            raise KeyboardInterrupt

    vertices, faces = cube()
    quads = rs.Scene([rs.Mesh(vertices, faces, face_ids=np.arange(12) // 2)])
    with pytest.raises(KeyboardInterrupt):
        rs.query_zarr(rs.Tracer(quads), store, output, block_rays=200, progress=stop)
    triangles = rs.Tracer(rs.Scene([rs.Mesh(vertices, faces)]))
    alone = rs.Tracer.of_structure(triangles.structure)
    for other in (triangles, alone):
        with pytest.raises(FileFormatError, match="different: the scene"):
            rs.query_zarr(other, store, output, block_rays=200, resume=True)
    rs.query_zarr(rs.Tracer(quads), store, output, block_rays=200, resume=True)
    found = read_store(output)
    assert_same_bits(found["face_id"], np.where(found["prim_id"] < 0, -1, found["prim_id"] // 2))


def test_worlds_are_refused(rays, tmp_path):
    one = rs.Scene.from_arrays(*cube())
    tracer = rs.Tracer(rs.Scene.instances(one, [np.eye(3, 4)] * 2, worlds=[0, 1]))
    store = write_store(tmp_path / "rays.zarr", rays)
    with pytest.raises(RaystreamError, match=r"query_zarr: .* whose instances are in worlds"):
        rs.query_zarr(tracer, store, tmp_path / "hits.zarr")

"""Queries of rays in Zarr stores give a tracer's bits."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from extras import need

need("zarr")

import raystream as rs
from ray_stores import (
    OPTIONS,
    assert_tracers,
    cornell_rays,
    read_store,
    write_store,
)
from raystream.ray_files import block_query

#: Leading shape, chunk, Zarr's format, and rays of a block.
STORES = {
    "one block": ((1000,), (300,), 3, 5000),
    "blocks across chunks": ((1000,), (300,), 3, 256),
    "parts of a chunk": ((1000,), (1000,), 2, 100),
    "a grid": ((9, 11, 13), (3, 4, 5), 2, 500),
    "rows of a grid": ((3, 400), (2, 150), 3, 200),
    "a single ray": ((), (), 3, 10),
    "no rays": ((0,), (1,), 3, 10),
}


#: Every query on every store is for .ci/nightly.
QUICK = {
    ("first_hit", "parts of a chunk"),
    ("multi_hit", "blocks across chunks"),
    ("count_hits", "a grid"),
    ("any_hit", "rows of a grid"),
    ("multi_hit", "a grid"),
    ("multi_hit", "a single ray"),
    ("multi_hit", "no rays"),
}
CASES = [
    pytest.param(*case, marks=[pytest.mark.exhaustive] * (case not in QUICK))
    for case in itertools.product(OPTIONS, STORES)
]


@pytest.mark.parametrize(("query", "kind"), CASES)
def test_hits_are_the_tracers(tracer, tmp_path, kind, query):
    shape, chunk, zarr_format, block_rays = STORES[kind]
    rays = cornell_rays(shape)
    store = write_store(tmp_path / "rays.zarr", rays, chunk, zarr_format)
    calls = []
    report = rs.query_zarr(
        tracer,
        store,
        tmp_path / "hits.zarr",
        query,
        block_rays=block_rays,
        progress=lambda *counts: calls.append(counts),
        **OPTIONS[query],
    )
    found = read_store(tmp_path / "hits.zarr")
    assert_tracers(found, tracer, query, rays, OPTIONS[query])
    count = int(np.prod(shape))
    assert (report.rays, report.rays_before) == (count, 0)
    assert calls[0] == (0, count)
    assert calls == sorted(calls)
    if "status" in found:
        assert report.invalid_rays == np.count_nonzero(found["status"])
    else:
        assert report.invalid_rays is None
    counts = tracer.count_hits(**rays, **OPTIONS[query])
    assert report.rays_hit == np.count_nonzero(counts)
    if query in ("multi_hit", "count_hits"):
        assert report.hits == counts.sum()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["hits.zarr", "rays.zarr"]


def test_arrays_broadcast(tracer, tmp_path):
    """One origin a row, one direction a column; limits of their own shapes."""
    rng = np.random.default_rng(3)
    rays = {
        "origins": np.array([278.0, 273.0, -800.0]) + rng.normal(0, 9, (30, 1, 3)),
        "directions": rng.normal((0, 0, 3), 1, (40, 3)).astype(np.float32),
        "t_min": np.array(250, np.int32),
        "t_max": rng.uniform(300, 2000, (30, 40)),
    }
    store = write_store(tmp_path / "rays.zarr", rays, (7, 9))
    rs.query_zarr(tracer, store, tmp_path / "h.zarr", "multi_hit", block_rays=200)
    assert_tracers(read_store(tmp_path / "h.zarr"), tracer, "multi_hit", rays, {})


@pytest.mark.parametrize("max_hits", [1, 3, None])
def test_all_hits_come_in_parts_that_fit(tracer, tmp_path, monkeypatch, max_hits):
    """As few as one ray at a time, where its hits alone are more than there is room for."""
    monkeypatch.setattr(block_query, "HITS_PER_RAY", 1)
    rays = cornell_rays((300,))
    rays["t_max"] = np.where(np.arange(300) < 150, 1.0, np.inf)  # nothing in the first half
    store = write_store(tmp_path / "rays.zarr", rays, (128,))
    rs.query_zarr(
        tracer, store, tmp_path / "h.zarr", "multi_hit", max_hits=max_hits, block_rays=200
    )
    found = read_store(tmp_path / "h.zarr")
    assert_tracers(found, tracer, "multi_hit", rays, {"max_hits": max_hits})


def test_rows_fill_many_chunks(tracer, tmp_path, monkeypatch):
    monkeypatch.setattr("raystream.ray_files.hit_store.CHUNK_ROWS", 37)
    rays = cornell_rays((296,))  # the splits of the last ray begin a chunk
    store = write_store(tmp_path / "rays.zarr", rays)
    rs.query_zarr(tracer, store, tmp_path / "h.zarr", "multi_hit", block_rays=50)
    assert_tracers(read_store(tmp_path / "h.zarr"), tracer, "multi_hit", rays, {})


@pytest.mark.parametrize("kind", ["shards", "uncompressed", "gzip", "zip file"])
def test_ways_to_store_rays(tracer, tmp_path, kind):
    import zarr

    rays = cornell_rays((300,))
    options = {
        "shards": {"shards": None},
        "uncompressed": {"compressors": None},
        "gzip": {"compressors": zarr.codecs.GzipCodec()},
    }.get(kind, {})
    store = tmp_path / "rays.zarr"
    if kind == "shards":
        group = zarr.create_group(store)
        for name, values in rays.items():
            array = group.create_array(
                name, shape=values.shape, dtype=values.dtype, chunks=(50, 3), shards=(150, 3)
            )
            array[...] = values
    elif kind == "zip file":
        store = tmp_path / "rays.zarr.zip"
        with zarr.storage.ZipStore(store, mode="w") as archive:
            write_store(archive, rays, (100,))
    else:
        write_store(store, rays, (100,), **options)
    rs.query_zarr(tracer, store, tmp_path / "h.zarr", block_rays=120)
    assert_tracers(read_store(tmp_path / "h.zarr"), tracer, "first_hit", rays, {})


def test_chunks_that_are_not_there_have_the_fill_value(tracer, tmp_path):
    rays = cornell_rays((300,))
    store = write_store(tmp_path / "rays.zarr", rays, (100,), fill_value=float("nan"))
    (store / "directions" / "c" / "1" / "0").unlink()
    report = rs.query_zarr(tracer, store, tmp_path / "h.zarr", block_rays=150)
    rays["directions"][100:200] = np.nan
    assert_tracers(read_store(tmp_path / "h.zarr"), tracer, "first_hit", rays, {})
    assert report.invalid_rays > 100


def test_attributes_say_what_was_asked(tracer, tmp_path):
    import zarr

    store = write_store(tmp_path / "rays.zarr", cornell_rays((30,)))
    rs.query_zarr(tracer, store, tmp_path / "h.zarr", "multi_hit", max_hits=2)
    about = zarr.open_group(tmp_path / "h.zarr", mode="r").attrs["raystream"]
    assert about["is_complete"] is True
    asked = about["identity"]
    assert asked["query"] == "multi_hit"
    assert asked["options"] == {"crossings": "triangles", "max_hits": 2}
    assert (asked["structure"], asked["device"]) == ("bvh", "cpu")
    assert asked["version"] == rs.__version__
    assert len(asked["scene_digest"]) == len(asked["ray_digest"]) == 64
    assert about["counts"]["rays"] == 30


@pytest.mark.parametrize(
    ("options", "named"),
    [
        ({"query": "first"}, "query"),
        ({"block_rays": 0}, "block_rays"),
        ({"max_hits": 3}, "max_hits"),
        ({"crossings": "surfaces"}, "crossings"),
        ({"query": "multi_hit", "max_hits": -1}, "max_hits"),
        ({"query": "count_hits", "crossings": "edges"}, "crossings"),
    ],
)
def test_bad_arguments_are_refused(tracer, tmp_path, options, named):
    store = write_store(tmp_path / "rays.zarr", cornell_rays((3,)))
    with pytest.raises(ValueError, match=f"^{named}: "):
        rs.query_zarr(tracer, store, tmp_path / "h.zarr", **options)
    assert not (tmp_path / "h.zarr").exists()


def test_without_zarr_the_extra_is_named(tracer, tmp_path, monkeypatch):
    store = write_store(tmp_path / "rays.zarr", cornell_rays((3,)))
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(rs.RaystreamError, match=r"pip install 'raystream\[zarr\]'"):
        rs.query_zarr(tracer, store, tmp_path / "h.zarr")

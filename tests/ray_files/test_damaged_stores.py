"""Stores that are damaged or hold no rays: one clear error each, and nothing unpickled."""

from __future__ import annotations

import json
import zipfile
from pathlib import Path

import numpy as np
import pytest

from extras import need

need("zarr")

import numcodecs
import zarr

import raystream as rs
from ray_stores import cornell_rays, write_store
from raystream.ray_files import ray_store
from raystream.ray_files.ray_store import RayStore

ZEROS = np.zeros((4, 3))


@pytest.fixture
def store(tmp_path) -> Path:
    return write_store(tmp_path / "rays.zarr", cornell_rays((20,)), (10,))


@pytest.fixture
def old_store(tmp_path) -> Path:
    return write_store(tmp_path / "old.zarr", cornell_rays((20,)), (10,), zarr_format=2)


def refusal(path: Path) -> str:
    with pytest.raises(rs.FileFormatError) as caught:
        RayStore(path)
    assert "\n" not in str(caught.value)
    assert str(caught.value).startswith(f"{path}: ")
    return str(caught.value)


def edit(file: Path, **changes) -> None:
    file.write_text(json.dumps({**json.loads(file.read_text()), **changes}))


BAD_RAYS = {
    "no directions": ({"origins": ZEROS}, "array 'directions' is missing"),
    "no arrays": ({}, "array 'origins' is missing"),
    "another array": (
        {"origins": ZEROS, "directions": ZEROS, "tmax": np.ones(4)},
        "holds 'tmax'; expected origins, directions, t_min, t_max",
    ),
    "other shapes": ({"origins": ZEROS, "directions": np.zeros((3, 3))}, "do not broadcast"),
    "no vectors": ({"origins": ZEROS[:, :2], "directions": ZEROS}, "expected shape (..., 3)"),
    "a number": ({"origins": np.array(1.0), "directions": ZEROS}, "expected shape (..., 3)"),
    "wrong t_max": ({"origins": ZEROS, "directions": ZEROS, "t_max": np.ones(3)}, "'t_max'"),
    "wide t_max": ({"origins": ZEROS, "directions": ZEROS, "t_max": np.ones((2, 4))}, "'t_max'"),
    "booleans": ({"origins": ZEROS, "directions": ZEROS > 0}, "bool; expected numbers"),
    "complex": ({"origins": ZEROS, "directions": ZEROS * 1j}, "complex128; expected numbers"),
    "times": ({"origins": ZEROS, "directions": ZEROS.astype("M8[s]")}, "expected numbers"),
}


@pytest.mark.parametrize("kind", BAD_RAYS)
def test_arrays_that_are_not_those_of_rays(tmp_path, kind):
    arrays, named = BAD_RAYS[kind]
    assert named in refusal(write_store(tmp_path / "rays.zarr", arrays, zarr_format=2))


@pytest.mark.parametrize("kind", ["nothing", "empty folder", "other folder", "text", "half a zip"])
def test_no_store(tmp_path, store, kind):
    path = tmp_path / "bad.zarr"
    if kind == "text":
        path.write_text("no store")
    elif kind == "half a zip":
        with zipfile.ZipFile(path, "w") as archive:
            archive.write(store / "zarr.json", "zarr.json")
        path.write_bytes(path.read_bytes()[:-10])
    elif kind != "nothing":
        path.mkdir()
        if kind == "other folder":
            (path / "origins").mkdir()
            (path / "notes.txt").write_text("mine")
    expected = {"nothing": "no such", "text": "zip", "half a zip": "zip"}
    assert expected.get(kind, "is not a Zarr store") in refusal(path)


def test_array_instead_of_a_group(tmp_path):
    zarr.create_array(tmp_path / "rays.zarr", shape=(4, 3), dtype="float32")
    refusal(tmp_path / "rays.zarr")


class Bomb:
    """Unpickling it would leave a file."""

    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return Path.touch, (self.path,)


PICKLE, TEXT = {"id": "pickle", "protocol": 5}, {"id": "vlen-utf8"}


@pytest.mark.parametrize("dtype", ["<f4", "|O"])
@pytest.mark.parametrize(
    "codecs",
    [
        {"compressor": PICKLE, "filters": None},
        {"compressor": None, "filters": [PICKLE]},
        {"compressor": PICKLE, "filters": [TEXT]},
        {"compressor": None, "filters": [TEXT, PICKLE]},
    ],
    ids=str,
)
def test_nothing_is_unpickled(tmp_path, old_store, codecs, dtype):
    """Zarr knows pickles as objects alone, and arrays of rays are numbers."""
    import pickle

    edit(old_store / "origins" / ".zarray", dtype=dtype, fill_value=None, **codecs)
    for chunk in ("0.0", "1.0"):
        (old_store / "origins" / chunk).write_bytes(pickle.dumps(Bomb(tmp_path / "gone off")))
    refusal(old_store)
    assert not (tmp_path / "gone off").exists()


@pytest.mark.parametrize(
    "changes",
    [
        {"shape": [-20, 3]},
        {"shape": [2**62, 3]},
        {"shape": []},
        {"shape": [20.5, 3]},
        {"data_type": "string"},
        {"codecs": []},
        {"chunk_grid": {"name": "regular", "configuration": {"chunk_shape": [0, 3]}}},
        {"chunk_grid": {"name": "regular", "configuration": {"chunk_shape": [2**40, 3]}}},
        {"zarr_format": 9},
        {"node_type": "group"},
    ],
    ids=str,
)
def test_damaged_description(store, changes):
    """Both arrays alike: where one alone is damaged, shapes disagree anyway."""
    for name in ("origins", "directions"):
        edit(store / name / "zarr.json", **changes)
    refusal(store)


@pytest.mark.parametrize("content", [b"", b"{", b"[]", b"\xff\xfe"])
@pytest.mark.parametrize("file", ["zarr.json", "origins/zarr.json"])
def test_description_that_is_none(store, file, content):
    (store / file).write_bytes(content)
    refusal(store)


def test_huge_chunk_is_refused_before_it_is_read(store):
    for name in ("origins", "directions"):
        edit(
            store / name / "zarr.json",
            shape=[2**30, 3],
            chunk_grid={"name": "regular", "configuration": {"chunk_shape": [2**28, 3]}},
        )
    assert "chunks of 3,221 MB" in refusal(store)


def test_tiny_chunks_make_small_blocks(tmp_path, monkeypatch):
    monkeypatch.setattr(ray_store, "MAX_CHUNKS", 8)
    store = RayStore(write_store(tmp_path / "rays.zarr", cornell_rays((100,)), (2,)))
    assert store.divide(1000).lengths == (16,)


@pytest.mark.parametrize("content", ["half", b"no chunk", b""])
@pytest.mark.parametrize(
    ("zarr_format", "codec"), [(2, None), (2, "blosc"), (3, None), (3, "blosc"), (3, "zstd")]
)
def test_damaged_chunk_is_one_error_and_what_is_done_is_kept(
    tracer, tmp_path, zarr_format, codec, content
):
    rays = cornell_rays((400,))
    compressors = {
        (2, "blosc"): numcodecs.Blosc(),
        (3, "blosc"): zarr.codecs.BloscCodec(),
        (3, "zstd"): zarr.codecs.ZstdCodec(),
    }.get((zarr_format, codec))
    store = write_store(tmp_path / "rays.zarr", rays, (100,), zarr_format, compressors=compressors)
    chunk = store / ("directions/c/2/0" if zarr_format == 3 else "directions/2.0")
    whole = chunk.read_bytes()
    output = tmp_path / "hits.zarr"

    def ask(resume):
        return rs.query_zarr(tracer, store, output, block_rays=100, resume=resume)

    def damage(done, total):
        if done == 100:  # the next block is being read, the one after it is not
            chunk.write_bytes(whole[: len(whole) // 2] if content == "half" else content)

    with pytest.raises(rs.FileFormatError, match=r"rays\.zarr: array 'directions' cannot be read"):
        rs.query_zarr(tracer, store, output, block_rays=100, progress=damage)
    chunk.write_bytes(whole)
    assert ask(resume=True).rays_before == 200


@pytest.mark.parametrize("output", ["rays.zarr", "rays.zarr/hits.zarr", "."])
def test_hits_are_not_written_into_the_rays(tracer, tmp_path, store, output):
    with pytest.raises(rs.FileFormatError, match="must be separate stores"):
        rs.query_zarr(tracer, store, tmp_path / output)
    assert RayStore(store).shape == (20,)

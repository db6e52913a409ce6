"""Interrupted queries, resumed, give the same bytes."""

from __future__ import annotations

import itertools
import json
import shutil

import numpy as np
import pytest

from extras import need

need("zarr")

import zarr

import raystream as rs
from ray_stores import OPTIONS, assert_tracers, content_of, cornell_rays, read_store, write_store
from raystream.ray_files import StoreWriteError, journal_path
from raystream.ray_files.durable import locked

SHAPE, CHUNK, BLOCK = (20, 25), (4, 25), 100
ROWS = 130


@pytest.fixture
def rays():
    return cornell_rays(SHAPE)


@pytest.fixture(autouse=True)
def few_rows_in_a_chunk(monkeypatch):
    monkeypatch.setattr("raystream.ray_files.hit_store.CHUNK_ROWS", ROWS)


@pytest.fixture
def ask(tracer, tmp_path, rays):
    store = write_store(tmp_path / "rays.zarr", rays, CHUNK)

    def call(query="first_hit", output="hits.zarr", tracer=tracer, **options):
        chosen = {"block_rays": BLOCK, **OPTIONS[query], **options}
        return rs.query_zarr(tracer, store, tmp_path / output, query, **chosen)

    return call


class Dead(BaseException):
    """Nothing after it has any effect, as after kill -9."""


def die_at(monkeypatch, number: int) -> list[int]:
    """Let the given write of a file be the last that works, with all of a process's writes."""
    from raystream.ray_files import journal

    writes = [0]

    def count() -> None:
        writes[0] += 1
        if writes[0] > number:
            raise Dead

    put, write = zarr.storage.LocalStore.set, journal.write_durably
    delete = zarr.storage.LocalStore.delete

    async def counted_set(self, *arguments, **named):
        count()
        await put(self, *arguments, **named)

    async def counted_delete(self, *arguments, **named):
        count()
        await delete(self, *arguments, **named)

    def counted_write(*arguments):
        count()
        write(*arguments)

    monkeypatch.setattr(zarr.storage.LocalStore, "set", counted_set)
    monkeypatch.setattr(zarr.storage.LocalStore, "delete", counted_delete)
    monkeypatch.setattr(journal, "write_durably", counted_write)
    return writes


#: Moments, in twentieths of the way; and beyond, each a write further. All are for .ci/nightly.
QUICK = {("first_hit", 9), ("multi_hit", 5), ("multi_hit", 13), ("multi_hit", 19)}
MOMENTS = [
    pytest.param(*case, marks=[pytest.mark.exhaustive] * (case not in QUICK))
    for case in itertools.product(OPTIONS, range(40))
]


@pytest.mark.parametrize(("query", "moment"), MOMENTS)
def test_query_that_died_goes_on_to_the_same_bytes(
    ask, tracer, rays, tmp_path, monkeypatch, query, moment
):
    with monkeypatch.context() as patch:
        writes = die_at(patch, 1_000_000)
        ask(query, "whole.zarr")
    whole = content_of(tmp_path / "whole.zarr")
    with monkeypatch.context() as patch:
        die_at(patch, min(writes[0] * (moment % 20) // 20 + moment // 20, writes[0] - 1))
        with pytest.raises(Dead):
            ask(query)
    record = journal_path(tmp_path / "hits.zarr")
    done = json.loads(record.read_text())["done"]["rays"] if record.exists() else 0
    report = ask(query, resume=True)
    assert report.rays_before == done <= report.rays
    assert content_of(tmp_path / "hits.zarr") == whole
    assert_tracers(read_store(tmp_path / "hits.zarr"), tracer, query, rays, OPTIONS[query])
    assert not record.exists()
    if moment in range(13, 20):
        assert done


def break_off(ask, query="first_hit", rays_done=200, **options) -> None:
    def stop(done, total):
        if done > rays_done:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        ask(query, progress=stop, **options)


@pytest.mark.parametrize("query", ["any_hit", "multi_hit"])
def test_ctrl_c_keeps_what_is_done(ask, tmp_path, query):
    whole = ask(query, "whole.zarr")
    break_off(ask, query)
    calls = []
    report = ask(query, resume=True, progress=lambda *counts: calls.append(counts))
    assert report.rays_before == calls[0][0] == 200
    for name in ("rays", "rays_hit", "hits", "invalid_rays"):
        assert getattr(report, name) == getattr(whole, name)
    assert content_of(tmp_path / "hits.zarr") == content_of(tmp_path / "whole.zarr")


def test_resuming_begins_where_nothing_was_begun_and_ends_where_all_is_done(ask, tmp_path):
    first = ask(resume=True)
    assert first.rays_before == 0
    before = content_of(tmp_path / "hits.zarr")
    again = ask(resume=True)
    assert again.rays_before == again.rays == 500
    assert (again.rays_hit, again.invalid_rays) == (first.rays_hit, first.invalid_rays)
    assert content_of(tmp_path / "hits.zarr") == before


def test_without_resume_complete_hits_are_replaced_and_others_are_not(ask, tmp_path):
    ask("multi_hit")
    assert ask("first_hit").rays_before == 0
    assert not (tmp_path / "hits.zarr" / "ray_splits").exists()
    break_off(ask, "first_hit")
    before = content_of(tmp_path / "hits.zarr")
    with pytest.raises(rs.FileFormatError, match="interrupted query; pass resume"):
        ask("first_hit")
    assert content_of(tmp_path / "hits.zarr") == before


@pytest.mark.parametrize(
    ("difference", "is_complete"),
    [
        ("query", False),
        ("options", True),
        ("the scene", False),
        ("the rays", True),
        ("block_rays", False),
        ("structure", True),
    ],
)
def test_another_query_is_rejected(ask, tmp_path, rays, difference, is_complete):
    if is_complete:
        ask("count_hits")
    else:
        break_off(ask, "count_hits")
    before = content_of(tmp_path / "hits.zarr")
    changes = {
        "query": {"query": "any_hit"},
        "options": {"crossings": "triangles"},
        "the scene": {"tracer": rs.Tracer(rs.load("spheres", triangles=100))},
        "structure": {"tracer": rs.Tracer(rs.load("cornell"), "brute")},
        "block_rays": {"block_rays": 400},
        "the rays": {},
    }[difference]
    if difference == "the rays":
        rays["directions"][-1, -1] += 1.0
        shutil.rmtree(tmp_path / "rays.zarr")
        write_store(tmp_path / "rays.zarr", rays, CHUNK)
    different = "options, query" if difference == "query" else difference
    with pytest.raises(
        rs.FileFormatError, match=rf"belongs to another query \(different: {different}\);"
    ):
        ask(**{"query": "count_hits", **changes}, resume=True)
    assert content_of(tmp_path / "hits.zarr") == before


@pytest.mark.parametrize(
    "content",
    [b"", b"{", b"[]", b'{"format": "raystream query progress"}', b"[" * 100_000, "negative"],
)
def test_damaged_record_is_refused(ask, tmp_path, content):
    break_off(ask)
    record = journal_path(tmp_path / "hits.zarr")
    if content == "negative":
        content = record.read_bytes().replace(b'"rays": 200', b'"rays": -200')
    record.write_bytes(content)
    with pytest.raises(rs.FileFormatError, match="delete it and the hits") as caught:
        ask(resume=True)
    assert str(caught.value).startswith(str(record))


def test_damaged_hits_are_not_resumed(ask, tmp_path):
    break_off(ask, "multi_hit")
    (tmp_path / "hits.zarr" / "t" / "zarr.json").write_text("{}")
    with pytest.raises(rs.FileFormatError, match=r"hits\.zarr: cannot be resumed"):
        ask("multi_hit", resume=True)


def test_lost_record_is_noticed(ask, tmp_path):
    break_off(ask)
    journal_path(tmp_path / "hits.zarr").unlink()
    for resume in (False, True):
        with pytest.raises(rs.FileFormatError, match="delete the folder"):
            ask(resume=resume)


def test_folder_of_something_else_is_left_alone(ask, tmp_path):
    ask()
    mine = tmp_path / "hits.zarr" / "notes.txt"
    mine.write_text("mine")
    with pytest.raises(rs.FileFormatError, match="holds other files besides hits"):
        ask()
    other = tmp_path / "other.zarr"
    other.mkdir()
    (other / "zarr.json").write_text("{}")
    for resume in (False, True):
        with pytest.raises(rs.FileFormatError, match="holds files other than hits"):
            ask(output="other.zarr", resume=resume)
    assert mine.exists()
    assert (other / "zarr.json").exists()


def test_full_disk_keeps_what_is_done(ask, tmp_path, monkeypatch):
    ask(output="whole.zarr")
    put = zarr.storage.LocalStore.set

    async def fill_up(self, key, *arguments, **named):
        if key.startswith("v/c/3"):
            raise OSError(28, "No space left on device")
        await put(self, key, *arguments, **named)

    with monkeypatch.context() as patch:
        patch.setattr(zarr.storage.LocalStore, "set", fill_up)
        with pytest.raises(StoreWriteError, match="No space left on device"):
            ask()
    assert ask(resume=True).rays_before == 300
    assert content_of(tmp_path / "hits.zarr") == content_of(tmp_path / "whole.zarr")


def test_unwritten_hits_are_none(ask, tmp_path):
    """Of a store that is not complete: numbers that no ray has."""
    break_off(ask)
    found = read_store(tmp_path / "hits.zarr")
    assert (found["status"].ravel()[200:] == 255).all()
    assert (found["prim_id"].ravel()[200:] == -2).all()
    assert np.isnan(found["t"].ravel()[200:]).all()
    assert (found["status"].ravel()[:200] < 2).all()


def test_two_processes_do_not_write_into_each_others_hits(ask, tmp_path):
    pytest.importorskip("fcntl")
    break_off(ask)
    with locked(tmp_path / "hits.zarr") as is_mine:
        assert is_mine
        with pytest.raises(rs.FileFormatError, match="another process is writing"):
            ask(resume=True)
    assert ask(resume=True).rays_before == 200

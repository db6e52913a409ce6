"""Visibility in Zarr groups: the same matrices, interrupted, and larger than the memory used."""

from __future__ import annotations

import json
import tracemalloc

import numpy as np
import pytest

import raystream as rs
from extras import need
from meshes import soup
from raystream.core.errors import FileFormatError
from raystream.line_of_sight import resumable_array, visibility

need("zarr")


@pytest.fixture(scope="module")
def tracer():
    return rs.Tracer(rs.Scene.from_arrays(*soup(60)))


@pytest.fixture
def points(rng):
    return rng.random((70, 3)), rng.random((90, 3))


FORMS = ("dense", "bits", "sparse")


def as_dense(found, shape):
    """The matrix of any form."""
    if isinstance(found, visibility.SparseVisibility):
        return found.dense()
    array = np.asarray(found)
    return array if array.dtype == bool else np.unpackbits(array, axis=1, count=shape[1]) > 0


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("is_half", [False, True])
@pytest.mark.parametrize("most", [64, 600, 1 << 18])
def test_groups_hold_the_same_matrix(form, is_half, most, tracer, points, tmp_path, monkeypatch):
    monkeypatch.setattr(visibility, "MOST_TILE", most)
    a, b = points
    pair = (a,) if is_half else (a, b)
    expected = rs.visibility(tracer, *pair)
    steps = []
    found = rs.visibility(
        tracer,
        *pair,
        form=form,
        out=tmp_path / "seen.zarr",
        progress=lambda done, total: steps.append(done / total),
    )
    np.testing.assert_array_equal(as_dense(found, expected.shape), expected)
    assert steps == sorted(set(steps))
    assert steps[-1] == 1.0
    import zarr

    group = zarr.open_group(tmp_path / "seen.zarr", mode="r")
    assert group.attrs["raystream"]["shape"] == list(expected.shape)
    if form == "sparse":
        assert set(group) == {"indptr", "indices"}
        assert group["indptr"].dtype == np.int64
        assert group["indptr"][-1] == np.count_nonzero(expected)
        plain = rs.visibility(tracer, *pair, form="sparse")
        np.testing.assert_array_equal(group["indices"][...], plain.indices)
        np.testing.assert_array_equal(group["indptr"][...], plain.indptr)
    else:
        assert found.read_only
        assert set(group) == {"visible"}


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("is_half", [False, True])
def test_interrupted_groups_resume(form, is_half, tracer, points, tmp_path, monkeypatch):
    monkeypatch.setattr(visibility, "MOST_TILE", 600)
    monkeypatch.setattr(resumable_array, "_INTERVAL", 0.0)
    a, b = points
    pair = (a,) if is_half else (a, b)
    expected = rs.visibility(tracer, *pair)
    path, traced = tmp_path / "seen.zarr", []

    def stop_after(limit):
        def progress(done, total):
            traced.append(done)
            if done >= limit * total:
                raise KeyboardInterrupt

        return progress

    for limit in (0.0, 0.3, 0.6):
        with pytest.raises(KeyboardInterrupt):
            rs.visibility(tracer, *pair, form=form, out=path, progress=stop_after(limit))
    found = rs.visibility(
        tracer, *pair, form=form, out=path, progress=lambda done, _: traced.append(done)
    )
    assert traced == sorted(set(traced))  # no tile is traced twice
    np.testing.assert_array_equal(as_dense(found, expected.shape), expected)
    monkeypatch.setattr(rs.Tracer, "any_hit", lambda *_, **__: pytest.fail("traced again"))
    again = rs.visibility(tracer, *pair, form=form, out=path)
    np.testing.assert_array_equal(as_dense(again, expected.shape), expected)


def test_killed_in_the_middle_of_a_band(tracer, points, tmp_path, monkeypatch):
    """What was written after the last record is written again."""
    monkeypatch.setattr(visibility, "MOST_TILE", 90)
    monkeypatch.setattr(resumable_array, "_INTERVAL", 0.0)
    path = tmp_path / "seen.zarr"
    journal = tmp_path / "seen.zarr.progress.json"
    before = []

    def stop(done, total):
        if done > 0.2 * total and not before:
            before.append(journal.read_text())
        if done > 0.4 * total:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        rs.visibility(tracer, *points, form="sparse", out=path, progress=stop)
    journal.write_text(before[0])  # as if the machine had failed before the later records
    found = rs.visibility(tracer, *points, form="sparse", out=path)
    np.testing.assert_array_equal(found.dense(), rs.visibility(tracer, *points))


def test_memory_is_that_of_a_block(tracer, rng, tmp_path, monkeypatch):
    """A matrix of 9 million pairs that all see each other, by blocks of 16,384 rays."""
    monkeypatch.setattr(visibility, "MOST_TILE", 1 << 14)
    points = rng.random((3000, 3)) + 10.0
    rs.visibility(tracer, points[:50], points, form="sparse", out=tmp_path / "warm.zarr")
    tracemalloc.start()
    try:
        found = rs.visibility(tracer, points, points, form="sparse", out=tmp_path / "seen.zarr")
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert found.indices.shape == (9_000_000,)  # 72 MB
    assert peak < 50e6


def test_memory_is_known_beforehand(tracer, rng, tmp_path):
    points = rng.random((1000, 3))
    path = tmp_path / "seen.zarr"
    with pytest.raises(MemoryError, match="for a block of rays, and max_memory allows"):
        rs.visibility(tracer, points, form="sparse", out=path, max_memory=100_000)
    assert not path.exists()
    rs.visibility(tracer, points, form="sparse", out=path, max_memory=100_000_000)


def test_groups_are_not_mixed(tracer, points, tmp_path):
    a, b = points
    path = tmp_path / "seen.zarr"
    rs.visibility(tracer, a, b, out=path)
    other = rs.Tracer(rs.Scene.from_arrays(*soup(60, seed=1)))
    for one, pair, options, named in (
        (tracer, (a + 1e-9, b), {}, "the points"),
        (other, (a, b), {}, "the scene"),
        (tracer, (a, b), {"form": "bits"}, "form"),
        (tracer, (a, b), {"form": "sparse"}, "block, form"),
    ):
        with pytest.raises(FileFormatError, match=rf"another query \(different: {named}\)"):
            rs.visibility(one, *pair, out=path, **options)
    foreign = tmp_path / "mine.zarr"
    foreign.mkdir()
    (foreign / "notes.txt").write_text("mine")
    with pytest.raises(FileFormatError, match="exists, but not its journal"):
        rs.visibility(tracer, a, b, out=foreign)
    assert (foreign / "notes.txt").read_text() == "mine"
    file = tmp_path / "file.zarr"
    file.write_text("mine")
    with pytest.raises(FileFormatError, match="is a file"):
        rs.visibility(tracer, a, b, out=file)
    (path / "visible" / "zarr.json").write_text("{}")
    with pytest.raises(FileFormatError, match="is damaged"):
        rs.visibility(tracer, a, b, out=path)
    metadata = json.loads((foreign.parent / "seen.zarr.progress.json").read_text())
    assert metadata["done"]["rays"] == len(a) * len(b)


def test_groups_with_other_files_are_left_alone(tracer, points, tmp_path):
    """Even where a journal marks the folder as replaceable."""
    path = tmp_path / "seen.zarr"

    def stop(*_):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        rs.visibility(tracer, *points, out=path, progress=stop)
    journal = path.with_name("seen.zarr.progress.json")
    content = json.loads(journal.read_text())
    content["done"]["rays"] = 0
    journal.write_text(json.dumps(content))
    (path / "notes.txt").write_text("mine")
    with pytest.raises(FileFormatError, match=r"holds other files, such as 'notes.txt'"):
        rs.visibility(tracer, *points, out=path)
    assert (path / "notes.txt").read_text() == "mine"


def test_a_group_has_one_writer(tracer, points, tmp_path):
    path = tmp_path / "seen.zarr"

    def write_again(*_):
        rs.visibility(tracer, *points, out=path)

    with pytest.raises(FileFormatError, match="another process"):
        rs.visibility(tracer, *points, out=path, progress=write_again)


@pytest.mark.parametrize("form", FORMS)
def test_no_points(form, tracer, points, tmp_path):
    for name, pair, shape in (("a", ([], points[1]), (0, 90)), ("b", (points[0], []), (70, 0))):
        path = tmp_path / f"{name}.zarr"
        for _ in range(2):
            found = rs.visibility(tracer, *pair, form=form, out=path)
            if form == "sparse":
                assert found.dense().shape == shape
                assert np.asarray(found.indptr).tolist() == [0] * (shape[0] + 1)
            else:
                assert found.shape[0] == shape[0]

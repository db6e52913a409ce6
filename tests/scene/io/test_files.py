"""Bounded reading: errors in a file are one line that names it."""

from __future__ import annotations

import gzip
from pathlib import Path

import pytest

from raystream.core.errors import FileFormatError
from raystream.scene.io import files
from raystream.scene.io.files import find_sibling, model_suffix, read_model_bytes


@pytest.mark.parametrize(
    ("name", "suffix"),
    [("a.obj", ".obj"), ("A.OBJ.GZ", ".obj"), ("a.b.Ply", ".ply"), ("a", ""), ("a.gz", "")],
)
def test_suffix(name: str, suffix: str) -> None:
    assert model_suffix(Path("d.x") / name) == suffix


@pytest.mark.parametrize(
    ("name", "content", "reason"),
    [
        ("absent.obj", None, "no such file"),
        ("empty.obj", b"", "is empty"),
        ("empty.obj.gz", gzip.compress(b"", mtime=0), "is empty"),
        ("short.obj.gz", gzip.compress(b"v 0 0 0\n" * 99, mtime=0)[:-9], "truncated"),
        ("bad.obj.gz", b"not packed at all", "not valid gzip"),
        ("tail.obj.gz", gzip.compress(b"abc", mtime=0) + b"rubbish", "not valid gzip"),
        ("x" * 300 + ".obj", None, "cannot be read"),
    ],
)
def test_unusable_files(tmp_path: Path, name: str, content: bytes | None, reason: str) -> None:
    path = tmp_path / name
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(FileFormatError, match=reason) as caught:
        read_model_bytes(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert "\n" not in str(caught.value)


def test_directory(tmp_path: Path) -> None:
    with pytest.raises(FileFormatError, match="is a folder"):
        read_model_bytes(tmp_path)


def test_gzip_members_and_padding(tmp_path: Path) -> None:
    path = tmp_path / "a.ply.gz"
    path.write_bytes(gzip.compress(b"one ", mtime=0) + gzip.compress(b"two", mtime=0) + b"\0" * 64)
    assert read_model_bytes(path) == b"one two"


def test_bomb_stops_at_the_ratio(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(files, "SMALL_FILE_BYTES", 1 << 20)
    monkeypatch.setattr(files, "_UNPACK_STEP", 1 << 18)
    path = tmp_path / "bomb.obj.gz"
    path.write_bytes(gzip.compress(b"\0" * (16 << 20)))
    with pytest.raises(FileFormatError, match="too large"):
        read_model_bytes(path)


@pytest.mark.parametrize("name", ["a.obj", "a.obj.gz"])
def test_limit_from_the_environment(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    path = tmp_path / name
    path.write_bytes(gzip.compress(b"v" * 200, mtime=0) if name.endswith("gz") else b"v" * 200)
    assert len(read_model_bytes(path)) == 200
    monkeypatch.setenv("RAYSTREAM_MAX_FILE_BYTES", "100")
    with pytest.raises(FileFormatError, match="RAYSTREAM_MAX_FILE_BYTES"):
        read_model_bytes(path)


def test_siblings(tmp_path: Path) -> None:
    folder = tmp_path / "model"
    (folder / "Maps").mkdir(parents=True)
    (folder / "Maps" / "Wood.PNG").touch()
    (folder / "Brick.JPG").touch()
    (tmp_path / "secret.txt").touch()
    model = folder / "a.obj"
    assert find_sibling(model, "brick.jpg") == folder / "Brick.JPG"
    assert find_sibling(model, "maps/wood.png") == folder / "Maps" / "Wood.PNG"
    assert find_sibling(model, "maps\\wood.png") == folder / "Maps" / "Wood.PNG"
    assert find_sibling(model, "C:\\somewhere\\brick.jpg") == folder / "Brick.JPG"
    assert find_sibling(model, "/usr/share/BRICK.jpg") == folder / "Brick.JPG"
    for name in (
        "../secret.txt",
        str(tmp_path / "secret.txt"),
        "",
        ".",
        "..",
        "Maps",
        "a\0b",
        "http://example.org/Brick.JPG",
        "x" * 5000,
    ):
        assert find_sibling(model, name) is None, name

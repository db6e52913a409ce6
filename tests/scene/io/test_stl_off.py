"""STL and OFF."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from raystream.core.errors import FileFormatError, RaystreamWarning
from raystream.scene.io.off import read_off
from raystream.scene.io.stl import read_stl
from raystream.scene.mesh import Mesh
from scene.io import tiny


def stl(tmp_path: Path, content: bytes) -> Mesh:
    path = tmp_path / "a.stl"
    path.write_bytes(content)
    (mesh,) = read_stl(path).meshes
    return mesh


def off(tmp_path: Path, content: bytes) -> Mesh:
    path = tmp_path / "a.off"
    path.write_bytes(content)
    (mesh,) = read_off(path).meshes
    return mesh


def test_binary_stl_that_begins_with_solid(tmp_path: Path) -> None:
    mesh = stl(tmp_path, tiny.stl_binary())
    np.testing.assert_array_equal(mesh.vertices[mesh.faces], tiny.TETRAHEDRON[tiny.SIDES])


def test_binary_stl_with_bytes_after_it(tmp_path: Path) -> None:
    assert stl(tmp_path, tiny.stl_binary() + b"more").triangle_count == 4


@pytest.mark.parametrize(
    "change",
    [
        lambda t: t,
        bytes.upper,
        lambda t: t.replace(b"\n", b"\r\n"),
        lambda t: t.replace(b"\n", b"\r"),
        lambda t: b"\xef\xbb\xbf" + t,
        lambda t: t.replace(b"solid tiny", b"solid a vertex model"),
        lambda t: b"solid vertex facet normal" + t.partition(b"facet normal")[2],
    ],
)
def test_text_stl(tmp_path: Path, change: object) -> None:
    assert callable(change)
    mesh = stl(tmp_path, change(tiny.STL_TEXT * 2))
    assert mesh.vertices[mesh.faces].tolist() == [[[0, 0, 0], [1, 0, 0], [0, 1, 0]]] * 2


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (b"rubbish", "not an STL"),
        (tiny.stl_binary()[:-1], "truncated"),
        (b"\0" * 80 + b"\xff\xff\xff\xff" + b"\0" * 99, "4,294,967,295 triangles"),
        (b"\0" * 999, "declared count of no triangles"),
        (b"solid cut", "truncated"),
        (tiny.STL_TEXT.replace(b"  vertex 1 0 0\n", b""), "truncated"),
        (tiny.STL_TEXT[: tiny.STL_TEXT.rindex(b"1e0")], "truncated"),
        (tiny.STL_TEXT.replace(b"vertex 1 0 0", b"vertex 1 0 zero"), "not three numbers"),
        (tiny.STL_TEXT.replace(b"vertex 1 0 0", b"vertex 1 0"), "not three numbers"),
    ],
)
def test_unusable_stl(tmp_path: Path, content: bytes, reason: str) -> None:
    with pytest.raises(FileFormatError, match=reason):
        stl(tmp_path, content)


@pytest.mark.parametrize(
    "content",
    [
        tiny.OFF,
        tiny.OFF.replace(b"OFF\n", b"OFF "),
        tiny.OFF.replace(b"OFF\n", b""),
        b"# comment\n\n" + tiny.OFF.replace(b"\n", b" # more\r\n\r\n"),
        tiny.OFF.replace(b"3 1 2 3", b"3 1 2 3 255 0 0"),
    ],
)
def test_off(tmp_path: Path, content: bytes) -> None:
    mesh = off(tmp_path, content)
    np.testing.assert_array_equal(mesh.vertices, tiny.TETRAHEDRON)
    np.testing.assert_array_equal(mesh.faces, tiny.SIDES)


def test_off_polygons_keep_the_order(tmp_path: Path) -> None:
    head = b"OFF 5 4 0\n0 0 0\n1 0 0\n1 1 0\n0 1 0\n.5 2 0\n"
    mesh = off(tmp_path, head + b"3 0 1 2\n5 0 1 2 4 3\n3 0 1 3\n2 0 1\n")
    assert mesh.faces.tolist() == [[0, 1, 2], [0, 1, 2], [0, 2, 4], [0, 4, 3], [0, 1, 3]]


def test_off_normals_and_colors(tmp_path: Path) -> None:
    rows = b"0 0 0 0 0 1 255 0 128 255\n1 0 0 0 0 1 0 0 0 255\n0 1 0 0 0 1 9 9 9 255\n3 0 1 2\n"
    mesh = off(tmp_path, b"CNOFF\n3 1 0\n" + rows)
    assert mesh.normals is not None
    assert mesh.colors is not None
    assert mesh.normals.tolist() == [[0, 0, 1]] * 3
    np.testing.assert_allclose(mesh.colors[0], [1, 0, 0.2158605], atol=1e-6)
    mesh = off(tmp_path, b"COFF\n3 1 0\n0 0 0 1 0 .5 1\n1 0 0 0 0 0 1\n0 1 0 0 0 0 1\n3 0 1 2\n")
    assert mesh.colors is not None
    np.testing.assert_allclose(mesh.colors[0], [1, 0, 0.21404], atol=1e-5)


def test_off_bad_indices(tmp_path: Path) -> None:
    with pytest.warns(RaystreamWarning, match="dropped: 1 triangles"):
        mesh = off(tmp_path, tiny.OFF.replace(b"3 1 2 3", b"3 1 2 4"))
    assert mesh.triangle_count == 3


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (b"OFFAL", "not an OFF"),
        (b"OFF\n", "lacks the numbers of vertices"),
        (b"OFF\nx y\n", "lacks the numbers of vertices"),
        (b"OFF BINARY\n" + b"\0" * 50, "binary OFF"),
        (b"4OFF\n1 1 0\n", "not supported"),
        (b"OFF\n99999999999 99999999999 0\n0 0 0\n", "truncated"),
        (tiny.OFF[:-9], "truncated"),
        (tiny.OFF.replace(b"1 0 0", b"1 0"), "expected 3 numbers"),
        (tiny.OFF.replace(b"1 0 0", b"1 zero 0"), "not a number"),
        (tiny.OFF.replace(b"3 1 2 3", b"4 1 2 3"), "fewer corners"),
        (tiny.OFF.replace(b"3 1 2 3", b"nan 1 2 3"), "fewer corners"),
    ],
)
def test_unusable_off(tmp_path: Path, content: bytes, reason: str) -> None:
    with pytest.raises(FileFormatError, match=reason):
        off(tmp_path, content)

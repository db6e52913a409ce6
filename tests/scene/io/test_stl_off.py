"""STL and OFF."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from raystream.core.errors import FileFormatError, RaystreamWarning
from raystream.scene.io import stl as stl_module
from raystream.scene.io.off import read_off
from raystream.scene.io.stl import read_stl
from raystream.scene.mesh import Mesh
from raystream.scene.scene import Scene
from scene.io import tiny


def stl_scene(tmp_path: Path, content: bytes) -> Scene:
    path = tmp_path / "a.stl"
    path.write_bytes(content)
    return read_stl(path)


def stl(tmp_path: Path, content: bytes) -> Mesh:
    (mesh,) = stl_scene(tmp_path, content).meshes
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
    meshes = stl_scene(tmp_path, change(tiny.STL_TEXT * 2)).meshes
    assert len(meshes) == 2
    for mesh in meshes:
        assert mesh.vertices[mesh.faces].tolist() == [[[0, 0, 0], [1, 0, 0], [0, 1, 0]]]


@pytest.mark.parametrize(
    "change",
    [
        lambda t: t,
        lambda t: t.replace(b"\n", b" "),
        lambda t: t.replace(b" ", b"\n\t").replace(b"solid\n\t", b"solid "),
        lambda t: t.replace(b"endfacet", b"end facet").replace(b"endloop", b"end loop"),
        lambda t: t.replace(b"endsolid", b"end solid"),
        lambda t: t.replace(b" outer loop", b" color 1 0 0\n outer loop"),
        lambda t: t.replace(b"normal 0 0 1", b"normal"),
        lambda t: t.replace(b"  vertex 1 0 0", b"  vertex 1 0 0 0.5"),
        lambda t: t.replace(b"endsolid tiny", b"endsolid"),
        lambda t: t.rstrip() + b"\x1a",
    ],
)
def test_layouts_of_text_stl(tmp_path: Path, change: Callable[[bytes], bytes]) -> None:
    mesh = stl(tmp_path, change(tiny.STL_TEXT))
    assert mesh.vertices[mesh.faces].tolist() == [[[0, 0, 0], [1, 0, 0], [0, 1, 0]]]


def solids(*names: str) -> bytes:
    """A triangle for each name, each at another height."""
    content = b""
    for height, name in enumerate(names):
        part = tiny.STL_TEXT.replace(b"0 0 0\n", b"0 0 %d\n" % height)
        content += part.replace(b"tiny", name.encode())
    return content


@pytest.mark.parametrize(
    ("names", "wanted"),
    [
        (["hull"], ["hull"]),
        (["Hull", "the  engine"], ["Hull", "the engine"]),
        (["wheel", "axle", "wheel", "wheel"], ["wheel", "axle", "wheel_2", "wheel_3"]),
        (["", "Tür", ""], ["part", "Tür", "part_2"]),
        (["solid", "endsolid x", "vertex 1 2"], ["solid", "endsolid x", "vertex 1 2"]),
    ],
)
def test_solids_are_meshes(tmp_path: Path, names: list[str], wanted: list[str]) -> None:
    scene = stl_scene(tmp_path, solids(*names))
    assert [mesh.name for mesh in scene.meshes] == wanted
    assert [mesh.vertices[0, 2] for mesh in scene.meshes] == list(range(len(names)))


def test_solids_without_facets_are_left_out(tmp_path: Path) -> None:
    empty = b"solid nothing\nendsolid nothing\n"
    scene = stl_scene(tmp_path, empty + tiny.STL_TEXT + empty)
    assert [mesh.name for mesh in scene.meshes] == ["tiny"]
    assert stl(tmp_path, empty * 2).triangle_count == 0


def test_too_many_solids_are_one_mesh(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stl_module, "MAX_PARTS", 2)
    assert len(stl_scene(tmp_path, solids("a", "b")).meshes) == 2
    with pytest.warns(RaystreamWarning, match="its 3 solids are more than 2: one mesh"):
        assert stl(tmp_path, solids("a", "b", "c")).vertices[::3, 2].tolist() == [0, 1, 2]


@pytest.mark.parametrize("end", [b"\n", b"\r\n"])
@pytest.mark.parametrize("names", [["tiny"], ["hull", "engine"]])
def test_a_text_stl_that_is_cut_is_an_error(tmp_path: Path, names: list[str], end: bytes) -> None:
    content = solids(*names).replace(b"1 0 0", b"1.25 0 0").replace(b"\n", end)
    ends = [content.index(b"endsolid " + name.encode()) + len("endsolid") for name in names]
    for cut in range(1, len(content)):
        between = [first for first in ends if first <= cut <= content.index(end, first) + len(end)]
        if between:  # only a name, or whole solids, are missing
            scene = stl_scene(tmp_path, content[:cut])
            assert scene.triangle_count == 1 + ends.index(between[0])
        else:
            with pytest.raises(FileFormatError, match=r"truncated|not an STL|is damaged"):
                stl_scene(tmp_path, content[:cut])


def test_a_binary_stl_that_is_cut_is_an_error(tmp_path: Path) -> None:
    content = tiny.stl_binary()
    for cut in range(1, len(content)):
        with pytest.raises(FileFormatError):
            stl(tmp_path, content[:cut])


def counted(count: int) -> bytes:
    """Four triangles under a header that claims another number."""
    content = tiny.stl_binary()
    return content[:80] + count.to_bytes(4, "little") + content[84:]


def with_corners(*counts: int) -> bytes:
    """Facets with these numbers of corners."""
    head, facet, foot = b"solid tiny\n", b"facet normal 0 0 1\nouter loop\n", b"endsolid\n"
    ends = b"endloop\nendfacet\n"
    return head + b"".join([facet + b"vertex 1 2 3\n" * n + ends for n in counts]) + foot


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
        (counted(3), "is damaged: data for 1 triangles after a declared count of 3 triangles"),
        (counted(1), "is damaged: data for 3 triangles after a declared count of 1 triangles"),
        (counted(2) + b"more", "data for 2 triangles"),
        (counted(5), "truncated or not STL: 5 triangles need 334 bytes, but it has 284"),
        (with_corners(2, 4), "facet 1 of solid 'tiny' has 2 corners, not 3"),
        (with_corners(3, 4, 2), "facet 2 of solid 'tiny' has 4 corners, not 3"),
        (with_corners(3, 3, 0), "facet 3 of solid 'tiny' has 0 corners, not 3"),
        (with_corners(3, 6), "facet 2 of solid 'tiny' has 6 corners, not 3"),
        (tiny.STL_TEXT.replace(b"endfacet\n", b""), "facet 1 of solid 'tiny' has no end"),
        (tiny.STL_TEXT.replace(b"facet normal 0 0 1\n", b""), "facet 1 of solid 'tiny'"),
        (tiny.STL_TEXT.partition(b"endsolid")[0], "solid 'tiny' has no 'endsolid'"),
        (tiny.STL_TEXT.partition(b"endsolid")[0] + tiny.STL_TEXT, "do not alternate after"),
        (tiny.STL_TEXT + b"sol", '"sol" outside of a solid'),
        (tiny.STL_TEXT + tiny.STL_TEXT.partition(b"\n")[2], "do not alternate after"),
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
        b"  " + tiny.OFF,
        b"\t \n \r\n" + tiny.OFF,
        b"\xef\xbb\xbf \t" + tiny.OFF,
        b"\t  OFF4 4 6 # or not\n" + tiny.OFF.partition(b"4 4 0\n")[2],
        tiny.OFF.replace(b"0 0 0\n", b"0 0 0 ").replace(b"0 1 0\n", b"0 1 0 "),
        tiny.OFF.replace(b"0 0 0\n", b"0 0 0 ").replace(b"0 1 0\n", b"0 1 0\t\t"),
        b"OFF\n4 4 0\n0 0 0 1 0 0 0 1 0 0 0 1\n3 0 2 1 3 0 1 3\n3 0 3 2 3 1 2 3",
        b"OFF\n4 4 0\n0 0\n0 1\n0 0\n0 1 0 0 0 1\n3 0 2 1 3 0 1\n3 3 0 3 2 3 1 2 3\n",
        tiny.OFF.replace(b"3 0 1 3", b"3 0\n1 3"),
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


def test_off_colors_of_several_vertices_on_a_line(tmp_path: Path) -> None:
    for color in (b"1 0 .5", b"1 0 .5 1"):
        rows = b"0 0 0 %b 1 0 0 %b\n0 1 0 %b\n3 0 1 2\n" % (color, color, color)
        mesh = off(tmp_path, b"COFF\n3 1 0\n" + rows)
        assert mesh.vertices.tolist() == [[0, 0, 0], [1, 0, 0], [0, 1, 0]]
        assert mesh.colors is not None
        np.testing.assert_allclose(mesh.colors, [[1, 0, 0.21404]] * 3, atol=1e-5)


@pytest.mark.parametrize(
    "content",
    [tiny.OFF, b"OFF 4 4 0\n0 0 0 1 0 0\n0 1 0 0 0 1\n3 0 2 1 3 0 1 3\n3 0 3 2 3 1 2 3\n"],
)
def test_an_off_that_is_cut_is_an_error(tmp_path: Path, content: bytes) -> None:
    for cut in range(1, len(content) - 1):
        with pytest.raises(FileFormatError):
            off(tmp_path, content[:cut])


@pytest.mark.parametrize("content", [tiny.OFF + b"3 0 1 2\n", tiny.OFF.replace(b"4 4 0", b"4 3 0")])
def test_off_with_more_lines_than_declared(tmp_path: Path, content: bytes) -> None:
    with pytest.warns(RaystreamWarning, match="dropped: 1 lines that the header does not declare"):
        mesh = off(tmp_path, content)
    np.testing.assert_array_equal(mesh.faces, tiny.SIDES[: mesh.triangle_count])


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
        (tiny.OFF.replace(b"0 0 0\n1 0 0\n", b"0 0 0 1 0\n"), "lines"),
        (b"OFF 4 4 0\n0 0 0 1 0 0\n0 1 0 0 0 1\n3 0 2 1 3 0 1 3\n", "lines"),
        (b"OFF 2 99 0\n0 0 0 1 0 0\n3 0 0 1 3 0 0 1\n", "lines"),
    ],
)
def test_unusable_off(tmp_path: Path, content: bytes, reason: str) -> None:
    with pytest.raises(FileFormatError, match=reason):
        off(tmp_path, content)

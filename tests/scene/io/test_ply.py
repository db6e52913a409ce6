"""PLY, text and binary."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest

from raystream.core.errors import FileFormatError, RaystreamWarning
from raystream.scene.io.ply import read_ply
from raystream.scene.mesh import Mesh
from scene.io import tiny


def read(tmp_path: Path, content: bytes) -> Mesh:
    path = tmp_path / "a.ply"
    path.write_bytes(content)
    (mesh,) = read_ply(path).meshes
    return mesh


def header(*lines: str, encoding: str = "ascii") -> bytes:
    return "\n".join(["ply", f"format {encoding} 1.0", *lines, "end_header\n"]).encode()


XYZ = ("property float x", "property float y", "property float z")
SQUARE = b"0 0 0\n1 0 0\n1 1 0\n0 1 0\n.5 2 0\n"


@pytest.mark.parametrize("content", [tiny.ply_text(), tiny.ply_binary("<"), tiny.ply_binary(">")])
def test_encodings_agree(tmp_path: Path, content: bytes) -> None:
    mesh = read(tmp_path, content)
    np.testing.assert_array_equal(mesh.vertices, tiny.TETRAHEDRON)
    np.testing.assert_array_equal(mesh.faces, tiny.SIDES)
    assert mesh.vertices.dtype == np.float32


@pytest.mark.parametrize("end", [b"\r\n", b"\r"])
def test_line_ends(tmp_path: Path, end: bytes) -> None:
    mesh = read(tmp_path, tiny.ply_text().replace(b"\n", end))
    np.testing.assert_array_equal(mesh.faces, tiny.SIDES)


FANS = [[0, 1, 2], [0, 1, 2], [0, 2, 4], [0, 4, 3], [0, 1, 3], [1, 2, 3], [1, 3, 0]]


def test_polygons_keep_the_order(tmp_path: Path) -> None:
    head = header(
        "element vertex 5", *XYZ, "element face 4", "property list uchar int vertex_index"
    )
    mesh = read(tmp_path, head + SQUARE + b"3 0 1 2\n5 0 1 2 4 3\n3 0 1 3\n4 1 2 3 0\n")
    assert mesh.faces.tolist() == FANS


@pytest.mark.parametrize("order", ["<", ">"])
def test_binary_polygons_among_other_properties(tmp_path: Path, order: str) -> None:
    head = header(
        "element vertex 5",
        *(line.replace("float", "double") for line in XYZ),
        "element face 4",
        "property uchar flag",
        "property list ushort uint vertex_indices",
        "property list char float texcoord",
        "element extra 2",
        "property list uchar short junk",
        encoding="binary_little_endian" if order == "<" else "binary_big_endian",
    )
    points = np.array([float(x) for x in SQUARE.split()])
    content = head + points.astype(f"{order}f8").tobytes()
    for polygon in ([0, 1, 2], [0, 1, 2, 4, 3], [0, 1, 3], [1, 2, 3, 0]):
        count = len(polygon)
        content += struct.pack(f"{order}BH{count}I", 7, count, *polygon)
        content += struct.pack(f"{order}b2f", 2, 0.5, 0.5)
    content += struct.pack(f"{order}BhB", 1, 5, 0)
    mesh = read(tmp_path, content)
    assert mesh.faces.tolist() == FANS
    assert mesh.vertices.dtype == np.float64


def test_attributes(tmp_path: Path) -> None:
    head = header(
        "element vertex 3",
        *XYZ,
        "property float nx",
        "property float ny",
        "property float nz",
        "property uchar red",
        "property uchar green",
        "property uchar blue",
        "property float s",
        "property float t",
        "element face 1",
        "property list uchar int vertex_indices",
    )
    rows = b"0 0 0 0 0 1 255 0 128 0 0\n1 0 0 0 0 1 0 0 0 1 0\n0 1 0 0 0 1 255 255 255 0 1\n"
    mesh = read(tmp_path, head + rows + b"3 0 1 2\n")
    assert mesh.normals is not None
    assert mesh.texcoords is not None
    assert mesh.colors is not None
    assert mesh.normals.tolist() == [[0, 0, 1]] * 3
    assert mesh.texcoords.tolist() == [[0, 0], [1, 0], [0, 1]]
    np.testing.assert_allclose(mesh.colors[0], [1, 0, 0.2158605], atol=1e-6)


def test_strips_turn_every_other_triangle(tmp_path: Path) -> None:
    head = header(
        "element vertex 5", *XYZ, "element tristrips 1", "property list int int vertex_indices"
    )
    mesh = read(tmp_path, head + SQUARE + b"9 0 1 2 3 4 -1 0 1 2\n")
    assert mesh.faces.tolist() == [[0, 1, 2], [2, 1, 3], [2, 3, 4], [0, 1, 2]]


def test_bad_indices(tmp_path: Path) -> None:
    head = header(
        "element vertex 5", *XYZ, "element face 4", "property list uchar int vertex_indices"
    )
    with pytest.warns(RaystreamWarning, match="dropped: 3 triangles"):
        mesh = read(tmp_path, head + SQUARE + b"3 0 1 2\n3 0 1 5\n3 0 -1 2\n3 0 1.5 nan\n")
    assert mesh.faces.tolist() == [[0, 1, 2]]
    with pytest.raises(FileFormatError, match="all 4 triangles"):
        read(tmp_path, head + SQUARE + b"3 0 1 9\n" * 4)


@pytest.mark.parametrize(
    "line",
    [
        b"Created by Blender3D 247 - www.blender.org, source file: ",
        b"Created by ply2vert",
        b"author: someone",
        b"element-wise model of a vertex",
    ],
)
def test_lines_without_the_word_comment(tmp_path: Path, line: bytes) -> None:
    for content in (tiny.ply_text(), tiny.ply_binary()):
        mesh = read(tmp_path, content.replace(b"comment tiny", line))
        np.testing.assert_array_equal(mesh.faces, tiny.SIDES)


def with_more(rows: bytes, more: bytes) -> bytes:
    return rows.replace(b"\n", more + b"\n")


LIST = "property list uchar int vertex_indices"
SOLID = header("element vertex 5", *XYZ, "element face 3", LIST)
POLYGONS = b"3 0 1 2\n5 0 1 2 4 3\n3 0 1 3\n"


@pytest.mark.parametrize(
    ("content", "dropped"),
    [
        (SOLID + with_more(SQUARE, b" 0 0 1") + POLYGONS, 15),
        (SOLID + SQUARE + with_more(POLYGONS, b" 255 0"), 6),
        (SOLID + with_more(SQUARE, b" 7") + with_more(POLYGONS, b" 7") + b"\n\n", 8),
        (SOLID + SQUARE.replace(b"1 1 0", b"1 1 0 9") + POLYGONS, 1),
        (SOLID + SQUARE + POLYGONS.replace(b"4 3\n", b"4 3 8 8\r\n\n"), 2),
        (SOLID + SQUARE + POLYGONS + b"3 0 1 2\n", 4),
    ],
)
def test_text_rows_with_more_numbers_than_declared(
    tmp_path: Path, content: bytes, dropped: int
) -> None:
    with pytest.warns(RaystreamWarning, match=f"dropped: {dropped} numbers that the header does"):
        mesh = read(tmp_path, content)
    assert mesh.faces.tolist() == FANS[:5]
    assert mesh.vertices.tolist() == [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0.5, 2, 0]]


def test_points_with_more_numbers_than_declared(tmp_path: Path) -> None:
    head = header("element vertex 5", *XYZ)
    with pytest.warns(RaystreamWarning, match="dropped: 5 numbers"):
        mesh = read(tmp_path, head + with_more(SQUARE, b" 3"))
    assert mesh.vertices[:, 2].tolist() == [0] * 5
    with pytest.raises(FileFormatError, match="rows have more numbers than the header declares"):
        read(tmp_path, head + with_more(SQUARE, b" 3")[:-9])


@pytest.mark.parametrize("count", [0, 1, 3])
@pytest.mark.parametrize("order", ["<", ">"])
def test_binary_with_more_faces_than_declared(tmp_path: Path, order: str, count: int) -> None:
    content = tiny.ply_binary(order)
    content = content.replace(b"element face 4", b"element face %d" % count)
    with pytest.warns(RaystreamWarning, match=f"dropped: {13 * (4 - count)} bytes that the header"):
        mesh = read(tmp_path, content)
    np.testing.assert_array_equal(mesh.faces, tiny.SIDES[:count])


def test_rows_need_not_be_lines(tmp_path: Path) -> None:
    for content in (SQUARE.replace(b"\n", b" ") + POLYGONS, SQUARE + POLYGONS.replace(b" ", b"\n")):
        assert read(tmp_path, SOLID + content).faces.tolist() == FANS[:5]


@pytest.mark.parametrize("content", [SOLID + SQUARE + POLYGONS, tiny.ply_binary()])
def test_a_ply_that_is_cut_is_an_error(tmp_path: Path, content: bytes) -> None:
    for cut in range(len(content) - 1):
        with pytest.raises(FileFormatError):
            read(tmp_path, content[:cut])


FACE = ("element face 1", "property list uchar int vertex_indices")
HUGE = "999999999999999"


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (b"plyx", "not a PLY file"),
        (b"solid x", "not a PLY file"),
        (b"ply\nformat ascii 1.0\n", "no end_header"),
        (header("element vertex -1", *XYZ), "element vertex -1"),
        (header("element vertex 1", "property quad x"), "property quad x"),
        (header("property float x"), "property float x"),
        (header("element vertex 1", *XYZ, encoding="middle_endian"), "middle_endian"),
        (b"ply\nelement vertex 1\nend_header\n", "no format"),
        (header("element vertex 5", *XYZ, *FACE) + SQUARE[:20], "truncated"),
        (header(f"element vertex {HUGE}", *XYZ, *FACE) + SQUARE, "truncated"),
        (
            header(f"element vertex {HUGE}", *XYZ, encoding="binary_little_endian") + SQUARE,
            "truncated",
        ),
        (header("element vertex 5", *XYZ, *FACE) + SQUARE + b"3 0 1", "truncated"),
        (header("element vertex 5", *XYZ, *FACE) + SQUARE + b"-3 0 1 2", "invalid list length"),
        (header("element vertex 5", *XYZ, *FACE) + SQUARE + b"1e300 0 1 2", "invalid list length"),
        (header("element vertex 5", *XYZ, *FACE) + SQUARE + b"3 0 one 2", "not a number"),
        (
            header("element vertex 5", *XYZ, FACE[0], "property list uchar int corners")
            + SQUARE
            + b"3 0 1 2\n",
            "no list vertex_indices",
        ),
        (
            header("element vertex 1", "property float x", *FACE) + b"1 3 0 0 0",
            "no vertices with x",
        ),
        (tiny.ply_binary()[:-1], "truncated"),
    ],
)
def test_unusable_files(tmp_path: Path, content: bytes, reason: str) -> None:
    with pytest.raises(FileFormatError, match=reason):
        read(tmp_path, content)


@pytest.mark.parametrize("faces", [(), ("element face 0", FACE[1])])
def test_point_clouds_are_empty(tmp_path: Path, faces: tuple[str, ...]) -> None:
    for points in (SQUARE, b""):
        count = f"element vertex {len(points.splitlines())}"
        mesh = read(tmp_path, header(count, *XYZ, *faces) + points)
        assert (len(mesh.vertices), mesh.triangle_count) == (len(points.splitlines()), 0)
    mesh = read(tmp_path, header(f"element foo {HUGE}", "element vertex 5", *XYZ) + SQUARE)
    assert mesh.triangle_count == 0


@pytest.mark.parametrize("order", ["", "<", ">"])
def test_vertices_may_have_lists_of_any_length(tmp_path: Path, order: str) -> None:
    encodings = {"<": "binary_little_endian", ">": "binary_big_endian", "": "ascii"}
    layout = ("property list uchar int near", *XYZ, "property uchar red")
    layout += ("property uchar green", "property uchar blue")
    head = header("element vertex 3", *layout, *FACE, encoding=encodings[order])
    rows = [([7], 0, 0, 0), ([], 1, 0, 0), ([8, 9], 0, 1, 0)]
    if order:
        body = b"".join(
            struct.pack(f"{order}B{len(near)}i3f3B", len(near), *near, *point, 255, 0, 0)
            for near, *point in rows
        )
        body += struct.pack(f"{order}B3i", 3, 0, 1, 2)
    else:
        lines = [[len(near), *near, *point, 255, 0, 0] for near, *point in rows]
        body = "\n".join(" ".join(map(str, line)) for line in [*lines, [3, 0, 1, 2]]).encode()
    mesh = read(tmp_path, head + body)
    assert mesh.vertices.tolist() == [[0, 0, 0], [1, 0, 0], [0, 1, 0]]
    assert mesh.faces.tolist() == [[0, 1, 2]]
    assert mesh.colors is not None
    assert mesh.colors.tolist() == [[1, 0, 0]] * 3


def test_headers_as_programs_write_them(tmp_path: Path) -> None:
    text = tiny.ply_text()
    for content in (
        b"\xef\xbb\xbf" + text,
        text.replace(b"comment tiny", b"comment no end_header yet\nobj_info 1 2"),
        text.replace(b"end_header\n", b"end_header  \n"),
    ):
        np.testing.assert_array_equal(read(tmp_path, content).faces, tiny.SIDES)


def test_binary_values_that_look_like_a_line_end(tmp_path: Path) -> None:
    """After lines that end in CR, a first byte of 10 is a value."""
    head = header(
        "element vertex 3",
        "property uchar flag",
        *XYZ,
        *FACE,
        encoding="binary_little_endian",
    )
    points = ((0, 0, 0), (1, 0, 0), (0, 1, 0))
    body = b"".join(struct.pack("<B3f", 10, *point) for point in points)
    body += struct.pack("<B3i", 3, 0, 1, 2)
    for end in (b"\n", b"\r", b"\r\n"):
        mesh = read(tmp_path, head.replace(b"\n", end) + body)
        assert mesh.vertices.tolist() == [list(point) for point in points]

"""OBJ, and the MTL files that it names."""

from __future__ import annotations

import pickle
import warnings
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from raystream.core.errors import FileFormatError, RaystreamWarning
from raystream.scene.io.mtl import read_mtl
from raystream.scene.io.obj import read_obj
from raystream.scene.mesh import Mesh
from raystream.scene.scene import Scene

SQUARE = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n"


def read(tmp_path: Path, text: str | bytes) -> Scene:
    path = tmp_path / "a.obj"
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    return read_obj(path)


def only_mesh(scene: Scene) -> Mesh:
    (mesh,) = scene.meshes
    return mesh


def corners(scene: Scene) -> list[list[list[float]]]:
    return np.concatenate([m.vertices[m.faces] for m in scene.meshes]).tolist()


def test_polygons_become_fans_in_file_order(tmp_path: Path) -> None:
    scene = read(tmp_path, SQUARE + "v .5 2 0\nf 1 2 3 5 4\nf 1 2 4\nf 2 3 4 1\n")
    assert only_mesh(scene).faces.tolist() == [
        [0, 1, 2],
        [0, 2, 4],
        [0, 4, 3],
        [0, 1, 3],
        [1, 2, 3],
        [1, 3, 0],
    ]


def test_a_cut_in_the_last_corner(tmp_path: Path) -> None:
    """OBJ has no end: where the rest is an OBJ file, too, a cut cannot be told."""
    for form in ("{0}/{0}/{0}", "{0}//{0}", "{0}/{0}", "{0}"):
        rows = SQUARE.replace("v", "vt") + SQUARE.replace("v", "vn") + SQUARE
        text = rows + "f " + " ".join(form.format(n) for n in (1, 2, 3))
        for end in ("", " ", " # a/b", "\n", "\r"):
            assert read(tmp_path, text + end).triangle_count == 1
        for cut in range(len(text) - len(form.format(3)) + 1, len(text)):
            with pytest.raises(FileFormatError, match="is truncated: its last line ends with"):
                read(tmp_path, text[:cut])


def test_relative_indices_count_from_their_own_line(tmp_path: Path) -> None:
    scene = read(tmp_path, SQUARE + "f -4 -3 -2\nv 9 9 9\nf -5 -4 -1\nf 1 -1 2\n")
    assert only_mesh(scene).faces.tolist() == [[0, 1, 2], [0, 1, 4], [0, 4, 1]]


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
def test_white_space_comments_and_continued_lines(tmp_path: Path, end: str) -> None:
    text = (
        "# comment\n\tv\t0 0 0 # origin\nv  1   0\t0\nv 0 1 0   \n#f 1 1 1\n  f 1 \\\n 2 3 # end\n"
    )
    scene = read(tmp_path, b"\xef\xbb\xbf" + text.replace("\n", end).encode())
    assert corners(scene) == [[[0, 0, 0], [1, 0, 0], [0, 1, 0]]]


def test_corners_repeat_positions_where_attributes_differ(tmp_path: Path) -> None:
    text = (
        SQUARE
        + "vt 0 0\nvt 1 0\nvt 1 1\nvn 0 0 1\nvn 1 0 0\nf 1/1/1 2/2/1 3/3/1\nf 1/2/2 3/3/1 4/1/1\n"
    )
    mesh = only_mesh(read(tmp_path, text))
    assert len(mesh.vertices) == 5  # vertex 1 twice
    assert mesh.vertices[mesh.faces].tolist() == [
        [[0, 0, 0], [1, 0, 0], [1, 1, 0]],
        [[0, 0, 0], [1, 1, 0], [0, 1, 0]],
    ]
    assert mesh.texcoords is not None
    assert mesh.normals is not None
    assert mesh.texcoords[mesh.faces].tolist() == [
        [[0, 0], [1, 0], [1, 1]],
        [[1, 0], [1, 1], [0, 0]],
    ]
    assert mesh.normals[mesh.faces][1].tolist() == [[1, 0, 0], [0, 0, 1], [0, 0, 1]]


@pytest.mark.parametrize(
    ("face", "has_texcoords", "has_normals"),
    [
        ("1 2 3", False, False),
        ("1/ 2/ 3/", False, False),
        ("1/1 2/1 3/1", True, False),
        ("1//1 2//1 3//1", False, True),
        ("1/1/1 2/1/1 3/1/1", True, True),
    ],
)
def test_kinds_of_corners(
    tmp_path: Path, face: str, has_texcoords: bool, has_normals: bool
) -> None:
    mesh = only_mesh(read(tmp_path, SQUARE + f"vt .5 .25\nvn 0 0 2\nf {face}\n"))
    assert (mesh.texcoords is not None) == has_texcoords
    assert (mesh.normals is not None) == has_normals
    if mesh.normals is not None:
        assert mesh.normals[mesh.faces[0]].tolist() == [[0, 0, 2]] * 3
    if mesh.texcoords is not None:
        assert mesh.texcoords[mesh.faces[0]].tolist() == [[0.5, 0.25]] * 3


def test_faces_without_normals_get_their_own(tmp_path: Path) -> None:
    text = SQUARE + "v 0 0 1\nvn 0 0 -1\nf 1//1 2//1 3//1\nf 1 5 4\n"
    mesh = only_mesh(read(tmp_path, text))
    assert mesh.normals is not None
    assert mesh.normals[mesh.faces].tolist() == [[[0, 0, -1]] * 3, [[-1, 0, 0]] * 3]


def test_vertex_colors_are_decoded(tmp_path: Path) -> None:
    mesh = only_mesh(read(tmp_path, "v 0 0 0 1 0 0.5\nv 1 0 0\nv 0 1 0 0 0 0\nf 1 2 3\n"))
    assert mesh.colors is not None
    np.testing.assert_allclose(mesh.colors[0], [1, 0, 0.21404], atol=1e-5)
    assert mesh.colors[1].tolist() == [1, 1, 1]


def test_objects_are_meshes_and_keep_the_order(tmp_path: Path) -> None:
    text = SQUARE + "f 1 2 3\no left\nf 2 3 4\nf 1 3 4\no empty\no right\nf 4 3 2\n"
    scene = read(tmp_path, text)
    assert [(m.name, m.triangle_count) for m in scene.meshes] == [
        ("part", 1),
        ("left", 2),
        ("right", 1),
    ]
    assert corners(scene)[3] == [[0, 1, 0], [1, 1, 0], [1, 0, 0]]


def test_materials_by_triangle(tmp_path: Path) -> None:
    Image.new("RGB", (2, 2)).save(tmp_path / "Wood.png")
    (tmp_path / "my colors.mtl").write_text(
        "newmtl dark red#1\n Kd .5 0 0 # half\n map_Kd -s 1 1 1 -bm 2 wood.png\n"
        "newmtl mirror\nillum 3\nKs .9 .8 .7\nKe 1 2 3\nNs 50\nNi 1.5\nTr 0.25\n"
    )
    text = "mtllib my colors.mtl\n" + SQUARE
    text += (
        "f 1 2 3\nusemtl mirror\nf 1 2 4\nusemtl dark red#1\nf 1 2 3 4\nusemtl mirror\nf 2 3 4\n"
    )
    scene = read(tmp_path, text)
    used = [scene.materials[i].name for i in only_mesh(scene).material_ids]
    assert used == ["", "mirror", "dark red#1", "dark red#1", "mirror"]
    assert len(scene.materials) == 3
    red = scene.materials[2]
    assert red.diffuse == (0.5, 0, 0)
    assert red.textures["diffuse"].path == tmp_path / "Wood.png"
    assert red.textures["diffuse"].pixels().shape == (2, 2, 3)
    mirror = scene.materials[1]
    assert mirror.reflection == mirror.specular == (0.9, 0.8, 0.7)
    assert (mirror.emission, mirror.shininess, mirror.ior) == ((1, 2, 3), 50, 1.5)
    assert mirror.opacity == 0.75
    assert mirror.emits


def test_opacity(tmp_path: Path) -> None:
    Image.new("L", (2, 2), 51).save(tmp_path / "leaf.png")
    path = tmp_path / "a.mtl"
    path.write_text(
        "newmtl leaf\nd .5\nmap_d -clamp on -imfchan m leaf.png\n"
        "newmtl glass\nillum 7\nd .1\nmap_d leaf.png\nnewmtl plain\nd 1\nTr 0.5\n"
    )
    found = read_mtl(path)
    leaf, glass = found["leaf"], found["glass"]
    assert (leaf.opacity, leaf.alpha_cutoff, leaf.is_opaque) == (0.5, None, False)
    assert leaf.textures["opacity"].pixels().tolist() == [[[51]] * 2] * 2
    assert leaf.textures["opacity"].wrap == "clamp"
    assert (glass.opacity, glass.is_opaque) == (1.0, False)
    assert found["plain"].is_opaque


def test_refraction_and_options(tmp_path: Path) -> None:
    (tmp_path / "a b.png").touch()
    path = tmp_path / "a.mtl"
    path.write_text(
        "newmtl glass\nillum 7\nTf .9\nd .1\nKs 1 1 1\nbump -imfchan r -mm 0 1 -clamp on a b.png\n"
        "newmtl odd\nKd red green blue\nNs nan\nd\nKs spectral x.rfl\nillum\nKe -1 0 0\nNi 0\n"
    )
    found = read_mtl(path)
    assert found["glass"].transmission == (0.9, 0.9, 0.9)
    assert found["glass"].opacity == 1.0
    bump = found["glass"].textures["bump"]
    assert (bump.name, bump.wrap) == ("a b.png", "clamp")
    assert found["glass"].bump_scale == 1.0
    odd = found["odd"]
    assert (odd.diffuse, odd.shininess, odd.opacity, odd.ior) == ((0.8, 0.8, 0.8), 0, 1, 1)


def test_roughness_and_metal_replace_the_highlight(tmp_path: Path) -> None:
    """As newer programs write them."""
    rows = np.array([[10, 20], [30, 40]], np.uint8)
    Image.fromarray(rows).save(tmp_path / "r.png")
    Image.new("RGB", (1, 1), (7, 8, 9)).save(tmp_path / "m.png")
    path = tmp_path / "a.mtl"
    path.write_text(
        "newmtl car\nillum 3\nKd 1 0 0\nKs .5 .5 .5\nNi 2\nPr .25\nPm .75\nPc .5\nPcr .125\nPs 2\n"
        "newmtl maps\nmap_Pr r.png\nmap_Pm m.png\nmap_Ks r.png\n"
        "newmtl metal\nPr .5\nmap_Pm m.png\n"
        "newmtl glass\nillum 7\nPr 0\nmap_Pr r.png\n"
    )
    found = read_mtl(path)
    car = found["car"]
    assert (car.roughness, car.metallic) == (0.25, 0.75)
    assert (car.clearcoat, car.clearcoat_roughness) == (0.5, 0.125)
    assert (car.specular, car.reflection, car.sheen_color) == ((0, 0, 0), (0, 0, 0), (1, 1, 1))
    assert car.normal_reflectance == pytest.approx((1 / 9,) * 3)
    maps = pickle.loads(pickle.dumps(found["maps"]))  # scenes travel to other processes
    assert (maps.roughness, maps.metallic, list(maps.textures)) == (1, 1, ["metallic_roughness"])
    assert maps.textures["metallic_roughness"].pixels().tolist() == [
        [[255, 10, 7], [255, 20, 7]],
        [[255, 30, 7], [255, 40, 7]],
    ]
    assert found["metal"].roughness == 0.5
    assert found["metal"].textures["metallic_roughness"].pixels().tolist() == [[[255, 255, 7]]]
    (tmp_path / "m.png").write_bytes(b"no image")
    damaged = read_mtl(path)["maps"].textures["metallic_roughness"]
    with pytest.warns(RaystreamWarning, match=r"texture left out: .*m\.png"):
        assert damaged.pixels()[0, 0].tolist() == [255, 10, 0]
    (tmp_path / "r.png").write_bytes(b"no image")
    with pytest.warns(RaystreamWarning) as caught:
        assert read_mtl(path)["maps"].textures["metallic_roughness"].pixels().tolist() == [
            [[255, 255, 0]]
        ]
    assert len(caught) == 2
    Image.new("RGB", (2, 1), (7, 8, 9)).save(tmp_path / "m.png")
    with pytest.warns(RaystreamWarning, match=r"texture left out: .*r\.png"):
        damaged = read_mtl(path)["maps"].textures["metallic_roughness"].pixels()
    assert damaged.tolist() == [[[255, 255, 7], [255, 255, 7]]]
    glass = found["glass"]
    assert (glass.roughness, glass.transmission, dict(glass.textures)) == (None, (1, 1, 1), {})


@pytest.mark.parametrize(
    ("statement", "role", "scale"),
    [
        ("map_Bump -bm 0.25 a b.png", "bump", 0.25),
        ("bump -clamp on -bm -2 a b.png", "bump", -2.0),
        ("bump -bm high a b.png", "bump", 1.0),
        ("bump -bm 1e99 a b.png", "bump", 1e30),
        ("norm -bm .5 a b.png", "normal", 0.5),
        ("map_Kn a b.png", "normal", 1.0),
        ("bump -bm", "bump", 1.0),
    ],
)
def test_multipliers_of_relief(tmp_path: Path, statement: str, role: str, scale: float) -> None:
    (tmp_path / "a b.png").touch()
    (tmp_path / "a.mtl").write_text(f"newmtl x\n{statement}\n")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RaystreamWarning)  # of the statement without a file
        material = read_mtl(tmp_path / "a.mtl")["x"]
    assert getattr(material, f"{role}_scale") == scale
    assert (role in material.textures) == ("png" in statement)


def test_missing_library_and_textures_warn_once(tmp_path: Path) -> None:
    with pytest.warns(RaystreamWarning, match=r"a\.obj: material libraries not found") as caught:
        scene = read(tmp_path, "mtllib no.mtl\nusemtl x\n" + SQUARE + "f 1 2 3\n")
    assert len(caught) == 1
    assert scene.materials[0].name == "x"
    (tmp_path / "a.mtl").write_text("newmtl x\nmap_Kd no.png\nmap_Ks no.png\nbump b.png\n")
    with pytest.warns(
        RaystreamWarning, match=r"a\.mtl: textures not found.*'no.png', 'b.png'"
    ) as caught:
        scene = read(tmp_path, "mtllib a.mtl\nusemtl x\n" + SQUARE + "f 1 2 3\n")
    assert len(caught) == 1
    assert not scene.materials[0].textures


def test_bad_indices_are_dropped_and_counted(tmp_path: Path) -> None:
    text = SQUARE + "f 1 2 3\nf 1 2 9\nf 0 1 2\nf -9 1 2\nf 4 3 2\nf 99999999999999999999 1 2\n"
    with pytest.warns(RaystreamWarning, match=r"a\.obj: dropped: 4 triangles") as caught:
        scene = read(tmp_path, text)
    assert len(caught) == 1
    assert only_mesh(scene).faces.tolist() == [[0, 1, 2], [3, 2, 1]]
    with pytest.raises(FileFormatError, match="all 1 triangles"):
        read(tmp_path, SQUARE + "f 7 8 9\n")
    with pytest.warns(RaystreamWarning, match="3 corners refer to texture"):
        scene = read(tmp_path, SQUARE + "f 1/7 2/7 3/7\n")
    assert only_mesh(scene).texcoords is None


def test_faces_with_two_corners_are_left_out(tmp_path: Path) -> None:
    with pytest.warns(RaystreamWarning, match="skipped 2 faces"):
        scene = read(tmp_path, SQUARE + "f 1 2\nf 1 2 3\nf 1\n")
    assert scene.triangle_count == 1


@pytest.mark.parametrize(
    ("line", "shown"),
    [
        ("v 1 2 x", '"v 1 2 x"'),
        ("v 1 2", '"v 1 2"'),
        ("f 1 2 q", '"f 1 2 q"'),
        ("f 1 2 3f", '"f 1 2 3f"'),
        ("fo 1 2 3o", '"fo 1 2 3o"'),
        ("f 1 2 3.5", '"f 1 2 3.5"'),
        ("f 1/1/1/1 2 3", "f 1/1/1/1"),
        ("f /1 2 3", "f /1 2 3"),
        ("vn 1 2", '"vn 1 2"'),
        ("v 1 2 3-4", "v 1 2 3-4"),
        ("f 1 2 3-4", "f 1 2 3-4"),
    ],
)
def test_lines_that_make_no_sense_are_shown(tmp_path: Path, line: str, shown: str) -> None:
    with pytest.raises(FileFormatError, match=r"a\.obj: ") as caught:
        read(tmp_path, SQUARE + "f 1 2 3\n" + line + "\nf 1 2 4\n")
    assert shown in str(caught.value)


def test_what_is_not_a_triangle_is_ignored(tmp_path: Path) -> None:
    text = SQUARE + "s 1\nl 1 2 3\np 1\ng a b\nvp 1 2\ncurv 0 1\n\nsomething else\nf 1 2 3\n"
    assert read(tmp_path, text).triangle_count == 1


def test_infinite_vertices_are_kept(tmp_path: Path) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        scene = read(tmp_path, SQUARE + "v nan inf 1e999\nf 1 2 3\nf 1 2 5\n")
    assert scene.triangle_count == 2
    assert scene.skipped_count == 1


def test_words_of_other_programs(tmp_path: Path) -> None:
    assert read(tmp_path, SQUARE + "fo 1 2 3\nf 1 3 4\n").triangle_count == 2
    text = SQUARE + "v -1.#IND 1.#QNAN 1.#INF00\nf 1 2 \\ \n 3\nf 1 2 5\n"
    for content in (text.encode(), text.replace("\n", "\r", 2).encode(), text.encode("utf-16")):
        scene = read(tmp_path, content)
        assert (scene.triangle_count, scene.skipped_count) == (2, 1)


def test_names_in_latin_1(tmp_path: Path) -> None:
    Image.new("RGB", (2, 2)).save(tmp_path / "R\u00f6d.png")
    (tmp_path / "a.mtl").write_bytes(
        "newmtl R\u00f6d\nKd 1 0 0\nmap_Kd R\u00f6d.png\nnewmtl R\u00e4d\nKd 0 1 0\n".encode(
            "latin-1"
        )
    )
    text = SQUARE + "mtllib a.mtl\nusemtl R\u00f6d\nf 1 2 3\nusemtl R\u00e4d\nf 1 3 4\n"
    for encoding in ("latin-1", "utf-8"):
        scene = read(tmp_path, text.encode(encoding))
        assert [m.diffuse for m in scene.materials] == [(1, 0, 0), (0, 1, 0)]
        assert [m.name for m in scene.materials] == ["R\u00f6d", "R\u00e4d"]
        assert scene.materials[0].textures["diffuse"].path == tmp_path / "R\u00f6d.png"


def test_libraries_may_follow_and_names_be_quoted(tmp_path: Path) -> None:
    (tmp_path / "my colors.mtl").write_text("newmtl a\nKd 1 0 0\n")
    scene = read(tmp_path, SQUARE + 'usemtl a\nf 1 2 3\nmtllib "my colors.mtl"\n')
    assert scene.materials[0].diffuse == (1, 0, 0)


@pytest.mark.parametrize("content", [b"<html>404</html>", b"hello\nworld\n", bytes(range(256))])
def test_other_files_are_refused(tmp_path: Path, content: bytes) -> None:
    with pytest.raises(FileFormatError, match="not an OBJ file"):
        read(tmp_path, content)

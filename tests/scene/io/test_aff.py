"""BART's AFF, and NFF."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from raystream.core.errors import FileFormatError, RaystreamWarning
from raystream.scene.io import aff_builder
from raystream.scene.io.aff import read_aff
from raystream.scene.io.aff_animation import Keyframes
from raystream.scene.io.aff_shapes import cone, sphere
from raystream.scene.lights import EnvironmentLight, PointLight
from raystream.scene.mesh import Mesh
from raystream.scene.scene import Scene
from raystream.scene.splines import position_at
from scene.io import tiny

TRIANGLE = "p 3 0 0 0 1 0 0 0 1 0\n"


def read(tmp_path: Path, text: str, *, time: float = 0.0) -> Scene:
    path = tmp_path / "a.aff"
    path.write_text(text)
    return read_aff(path, time=time)


def first_corners(scene: Scene) -> list[list[float]]:
    return [np.round(mesh.vertices[0], 12).tolist() for mesh in scene.meshes]


def test_everything_at_once(tmp_path: Path) -> None:
    (tmp_path / "TextureFiles").mkdir()
    (tmp_path / "TextureFiles" / "T.ppm").write_bytes(b"P6 1 1 255\n\xff\0\0")
    scene = read(tmp_path, tiny.AFF.decode())
    assert [mesh.triangle_count for mesh in scene.meshes] == [2, 1, 960, 32]
    assert scene.background == (0.1, 0.2, 0.3)
    assert scene.camera.eye == (0, 0, 5)
    assert scene.camera.fov == 30
    lamp, ambient = scene.lights
    assert lamp == PointLight((1, 2, 3), (0.5, 0.5, 0.5), "none")
    assert isinstance(ambient, EnvironmentLight)
    assert ambient.radiance == pytest.approx((0.5, 0.5, 0.5))  # am x 0.2 / 0.4
    plain, textured = scene.materials
    assert plain.diffuse == (0.4, 0.4, 0.4)
    assert plain.specular == plain.reflection == (0.1, 0.1, 0.1)
    assert (plain.shininess, plain.transmission, plain.ior) == (20, (0.5, 0.5, 0.5), 1.5)
    assert textured.textures["diffuse"].pixels().tolist() == [[[255, 0, 0]]]
    mesh = scene.meshes[1]
    assert mesh.normals is not None
    assert mesh.texcoords is not None
    # Scaled by 2, turned by 90 degrees about z, moved by 1 along x.
    np.testing.assert_allclose(
        mesh.vertices[mesh.faces[0]], [[1, 0, 0], [1, 2, 0], [-1, 0, 0]], atol=1e-12
    )
    assert mesh.texcoords[mesh.faces[0]].tolist() == [[0, 0], [1, 0], [0, 1]]


def test_animation_moves_and_hides(tmp_path: Path) -> None:
    text = tiny.AFF.decode().replace("t.ppm", "none.ppm")
    with pytest.warns(RaystreamWarning, match=r"a\.aff: textures not found: 'none.ppm'"):
        scene = read(tmp_path, text, time=0.5)
    assert scene.meshes[1].vertices[0] == pytest.approx([6, 0, 0])
    assert len(read(tmp_path, text, time=6.0).meshes) == 3  # no longer visible


def test_missing_textures_do_not_count_as_materials(tmp_path: Path) -> None:
    with pytest.warns(RaystreamWarning, match="textures not found"):
        scene = read(tmp_path, "tt none.ppm\n0 0 0 0 0\n1 0 0 1 0\n0 1 0 0 1\n")
    assert not scene.materials[0].textures


def test_what_only_ambient_light_shows_glows(tmp_path: Path) -> None:
    """As the garden behind the kitchen's windows; chrome, which mirrors, does not glow."""
    (tmp_path / "t.ppm").write_bytes(b"P6 1 1 255\n\xff\0\0")
    picture = "tt t.ppm\n0 0 0 0 0\n1 0 0 1 0\n0 1 0 0 1\n"
    black, chrome = "fm 0.4 0.2 0 0 0 0 0 0 0 0 0 1\n", "fm 0.4 0.4 0.4 0 0 0 1 1 1 9 0 1\n"
    scene = read(tmp_path, "am 2.5 1 1\n" + black + picture + TRIANGLE + chrome + TRIANGLE)
    textured, plain, mirror = scene.materials
    assert textured.emission == plain.emission == pytest.approx((1.0, 0.2, 0.0))
    assert list(textured.textures) == ["emission"]
    assert not plain.textures
    assert mirror.emission == (0.0, 0.0, 0.0)
    assert not read(tmp_path, black + TRIANGLE).materials[0].emits  # without ambient light


def test_transforms_nest(tmp_path: Path) -> None:
    text = (
        "xs 1 1 1 0 0 1 90 0 0 0 { xs 1 1 1 1 0 0 0 5 0 0 {"
        + TRIANGLE
        + "} "
        + TRIANGLE
        + "}"
        + TRIANGLE
        + "x unknown {"
        + TRIANGLE
        + "}"
    )
    assert first_corners(read(tmp_path, text)) == [[0, 5, 0], [0, 0, 0], [0, 0, 0], [0, 0, 0]]


def test_includes_share_files_and_materials(tmp_path: Path) -> None:
    (tmp_path / "Part.aff").write_text(TRIANGLE)
    (tmp_path / "paint.aff").write_text("fm 0 0 0 .1 .2 .3 0 0 0 0 0 0\n")
    text = (
        "xs 1 1 1 0 0 1 0 7 0 0 { i 0 part.aff }\n{}i 0 paint.aff\ni 0 part.aff\n"
        "i 1 part.aff\nd 1\ni 1 part.aff\n".replace("{}", "")
    )
    scene = read(tmp_path, text)
    assert first_corners(scene) == [[7, 0, 0], [0, 0, 0], [0, 0, 0]]
    diffuse = [scene.materials[mesh.material_ids[0]].diffuse for mesh in scene.meshes]
    assert diffuse == [(0.8, 0.8, 0.8), (0.1, 0.2, 0.3), (0.1, 0.2, 0.3)]
    assert [mesh.name for mesh in scene.meshes] == ["Part", "Part_2", "Part_3"]


def test_runs_of_polygons_are_one_mesh(tmp_path: Path) -> None:
    patch = "pp 3 0 0 0 0 0 1 1 0 0 0 0 1 0 1 0 0 0 1\n"
    square = "p 4 5 0 0 6 0 0 6 1 0 5 1 0\n"
    scene = read(tmp_path, TRIANGLE + square + TRIANGLE + patch * 2 + "d 0\n" + patch)
    assert [mesh.triangle_count for mesh in scene.meshes] == [4, 2, 1]
    first, second, _ = scene.meshes
    assert first.vertices[first.faces[2]].tolist() == [[5, 0, 0], [6, 1, 0], [5, 1, 0]]
    assert first.vertices[first.faces[3]].tolist() == [[0, 0, 0], [1, 0, 0], [0, 1, 0]]
    assert second.normals is not None
    assert second.normals.tolist() == [[0, 0, 1]] * 6


def test_nff_materials_and_lights(tmp_path: Path) -> None:
    text = "l 1 2 3\nl 4 5 6\nf 1 .5 0 .5 .25 10 0 1\npp 3 0 0 0 0 0 1 1 0 0 0 0 1 0 1 0 0 0 1\n"
    scene = read(tmp_path, text)
    assert scene.materials[0].diffuse == (0.5, 0.25, 0)
    assert scene.materials[0].specular == (0.25, 0.25, 0.25)
    assert scene.meshes[0].normals is not None
    light = scene.lights[1]
    assert isinstance(light, PointLight)
    assert light.intensity == pytest.approx((0.5**0.5,) * 3)


def test_animated_lights_and_triangles(tmp_path: Path) -> None:
    rows = " ".join(f"{t} {t}.0 0 0 0 0 1 1 0 0 0 0 1 0 1 0 0 0 1" for t in (0, 4))
    text = f"la lamp 1 1 1 0.5 0.5 0.5\nk lamp {{ transl 1 0 0 0 9 0 0 0 }}\ntpa 2 {rows}\n"
    scene = read(tmp_path, text, time=2.0)
    assert scene.meshes[0].vertices[0].tolist() == [2, 0, 0]
    light = scene.lights[0]
    assert isinstance(light, PointLight)
    assert light.position == (1, 1, 10)


def test_keyframed_camera_wins(tmp_path: Path) -> None:
    keys = "k camera { transl 1 0 1 2 3 0 0 0 rot 1 0 0 1 0 90 0 0 0 }\n"
    scene = read(tmp_path, "v from 9 9 9 at 0 0 0 up 0 0 1 angle 50\n" + keys + TRIANGLE)
    assert scene.camera.eye == (1, 2, 3)
    assert scene.camera.look_at == pytest.approx((0, 2, 3))  # -z turned by 90 degrees about y
    assert scene.camera.up == pytest.approx((0, 1, 0))
    assert scene.camera.fov == 50


MOVING = """
v from 9 9 9 at 9 9 8 up 0 1 0 angle 50
k camera { transl 2 0 1 2 3 0 0 0 4 5 2 3 0 0 0 rot 2 0 0 1 0 0 0 0 0 4 0 1 0 90 0 0 0 }
"""


def test_keyframed_cameras_have_a_track(tmp_path: Path) -> None:
    scene = read(tmp_path, MOVING + TRIANGLE, time=1.0)
    assert scene.camera.eye == (2, 2, 3)
    assert scene.camera_track is not None
    assert scene.camera_track.times == (0, 4)
    for time in (0.0, 1.0, 3.0, 9.0):
        alone = read(tmp_path, MOVING + TRIANGLE, time=time).camera
        moved = scene.camera_at(time)
        assert moved.eye == alone.eye
        assert moved.look_at == pytest.approx(alone.look_at)
        assert moved.up == pytest.approx(alone.up)
        assert moved.fov == 50


def test_cameras_that_turn_only_stay_where_the_view_is(tmp_path: Path) -> None:
    text = "v from 9 9 9 at 0 9 9 up 0 1 0 angle 50\nk camera { rot 1 0 0 1 0 90 0 0 0 }\n"
    scene = read(tmp_path, text + TRIANGLE)
    assert scene.camera_at(5.0).eye == (9, 9, 9)
    still = read(tmp_path, "v from 9 9 9 at 0 9 9 up 0 1 0 angle 50\n" + TRIANGLE)
    assert still.camera_track is None
    assert still.camera_at(5.0) == still.camera


@pytest.mark.parametrize(
    "keys",
    [
        "transl 2 4 1 2 3 0 0 0 0 5 2 3 0 0 0 rot 1 0 0 1 0 0 0 0 0",  # back in time
        "transl 2 0 1 2 3 0 0 0 4 nan 2 3 0 0 0 rot 1 0 0 1 0 0 0 0 0",
    ],
)
def test_camera_keys_that_make_no_sense(tmp_path: Path, keys: str) -> None:
    with pytest.raises(FileFormatError, match="invalid keys of the camera"):
        read(tmp_path, f"k camera {{ {keys} }}\n" + TRIANGLE)


def transl(*rows: tuple[float, ...]) -> np.ndarray:
    return np.array([[t, x, 0.0, 0.0, *rest, *(0.0,) * (3 - len(rest))] for t, x, *rest in rows])


def test_splines_go_through_their_keys() -> None:
    keys = transl((-1, 3), (0, 1), (2, 5), (3, -2), (4, 0))
    for row in keys[1:-1]:
        assert position_at(keys, row[0])[0] == pytest.approx(row[1])
    assert position_at(keys, -9.0)[0] == 1  # the first and the last key are not shown
    assert position_at(keys, 99.0)[0] == -2


def test_splines_keep_an_even_speed_over_uneven_times() -> None:
    keys = transl((-3, -3), (0, 0), (1, 1), (5, 5), (6, 6))
    for time in (0.25, 1.0, 2.0, 4.9):
        assert position_at(keys, time)[0] == pytest.approx(time)


def test_tension_continuity_and_bias() -> None:
    """At u = 1/4 the Hermite form weighs 54, 10 values and 9, -3 tangents, all over 64."""
    values = (0.0, 0.0, 1.0, 1.0)

    def at_quarter(*shape: float) -> float:
        keys = transl(*((t, x, *shape) for t, x in enumerate(values)))
        return float(position_at(keys, 1.25)[0])

    assert at_quarter() == pytest.approx((10 + 9 * 0.5 - 3 * 0.5) / 64)
    assert at_quarter(1.0) == pytest.approx(10 / 64)
    assert at_quarter(0, 1.0) == pytest.approx(10 / 64)
    assert at_quarter(0, 0, 1.0) == pytest.approx((10 - 3) / 64)


def test_rotations_take_the_shorter_way() -> None:
    rows = np.array([[t, 0, 0, 1, a, 0, 0, 0] for t, a in ((0, 0), (1, 0), (2, 90), (3, 90))])
    corner = Keyframes(rotation=rows.astype(float)).matrix(1.5) @ [1, 0, 0, 1]
    assert corner == pytest.approx([0.5**0.5, 0.5**0.5, 0, 1])
    rows[:, 4] = [0, 0, 350, 350]
    turned = Keyframes(rotation=rows.astype(float)).matrix(1.5) @ [1, 0, 0, 1]
    assert math.degrees(math.atan2(turned[1], turned[0])) == pytest.approx(-5)
    even = np.array([[t, 0, 1, 0, 30.0 * t, 0, 0, 0] for t in (0, 1, 3, 4)])
    point = Keyframes(rotation=even).matrix(1.5) @ [0, 0, 1, 1]
    assert math.degrees(math.atan2(point[0], point[2])) == pytest.approx(45)


def volume(mesh: Mesh) -> float:
    a, b, c = mesh.vertices[mesh.faces].transpose(1, 0, 2)
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6)


def test_spheres_are_closed_and_face_outward() -> None:
    ball = sphere(np.array([1.0, 2.0, 3.0]), 2.0)
    assert 0.97 < volume(ball) / (4 / 3 * math.pi * 8) < 1.0
    assert np.linalg.norm(ball.vertices - [1, 2, 3], axis=1) == pytest.approx(2.0)
    assert volume(sphere(np.zeros(3), -1.0)) == pytest.approx(-volume(sphere(np.zeros(3), 1.0)))
    triangles = Scene([ball]).triangles
    assert triangles.degenerate_count == 0


@pytest.mark.parametrize("radii", [(1.0, 1.0), (1.0, 0.0), (0.0, 0.5), (0.5, 2.0)])
def test_cones_face_outward(radii: tuple[float, float]) -> None:
    base, apex = np.array([1.0, 0.0, 0.0]), np.array([1.0, 2.0, 1.0])
    mesh = cone(base, radii[0], apex, radii[1])
    corners = mesh.vertices[mesh.faces]
    fronts = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    axis = (apex - base) / np.linalg.norm(apex - base)
    centers = corners.mean(axis=1) - base
    outward = centers - np.outer(centers @ axis, axis)
    assert (np.einsum("ij,ij->i", fronts, outward) > 0).all()
    assert mesh.normals is not None
    assert (np.einsum("ij,ij->i", mesh.normals[mesh.faces[:, 0]], fronts) > 0).all()


def test_bad_indices_are_counted_over_all_files(tmp_path: Path) -> None:
    (tmp_path / "b.aff").write_text("m vertices 3 0 0 0 1 0 0 0 1 0 triangles 2 0 1 2 0 1 3\n")
    with pytest.warns(RaystreamWarning, match=r"a\.aff: dropped: 2 triangles") as caught:
        scene = read(tmp_path, "i 0 b.aff m vertices 3 0 0 0 1 0 0 0 1 0 triangles 2 -1 1 2 0 1 2")
    assert len(caught) == 1
    assert scene.triangle_count == 2


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("i 0 a.aff", "includes itself"),
        ("i 0 a.aff i 0 a.aff", "includes itself|add up to"),
        ("i 0 none.aff", 'includes "none.aff", which is not next to it'),
        ("i 0 ../../etc/passwd", "not next to it"),
        ("xs 1 1 1 0 0 1 0 0 0 0 {", "never closed"),
        ("}", "never opened"),
        ("wibble 1 2 3", 'unknown statement "wibble"'),
        ("p 99999999999999 0 0 0", "truncated"),
        ("p three 0 0 0", "expected a number of items"),
        ("p 3 0 0 0 1 0 0 0 one 0", 'expected a number, found "one"'),
        ("m vertices 1 0 0 0 colors 1", "expected normals, texturecoords"),
        ("m normals 1 0 0 0", 'expected "vertices"'),
        ("m vertices 3 0 0 0 1 0 0 0 1 0 triangles 1 0 1 2.5", 'found "2.5"'),
        ("k a { wobble 3 }", "unknown keyframe channel"),
        ("k a { transl 0 }", "keyframe channel is empty"),
        ("tpa 0", "has no keys"),
        ("fm 1 1", "truncated"),
        ("v from 0 0 0 at 0 0 0 up 0 1 0\n" + TRIANGLE, "invalid view"),
        ("v from 0 0 0 at 1 0 0 up 0 1 0 angle 999\n" + TRIANGLE, "invalid view"),
    ],
)
def test_unusable_files(tmp_path: Path, text: str, reason: str) -> None:
    with pytest.raises(FileFormatError, match=reason):
        read(tmp_path, text)


def test_includes_that_multiply_are_stopped(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(aff_builder, "MAX_STATEMENTS", 10_000)
    for level in range(9):
        (tmp_path / f"{level}.aff").write_text(f"i 0 {level + 1}.aff\n" * 10)
    (tmp_path / "9.aff").write_text("# nothing\n")
    with pytest.raises(FileFormatError, match="add up to more than 10,000 statements"):
        read(tmp_path, "i 0 0.aff")


def test_includes_are_found_next_to_their_includer(tmp_path: Path) -> None:
    for folder, size in (("left", 1), ("right", 2)):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "main.aff").write_text("i 0 part.aff\ni 0 shared.aff\n")
        (tmp_path / folder / "part.aff").write_text(f"p 3 0 0 0 {size} 0 0 0 1 0\n")
        (tmp_path / folder / "shared.aff").write_text("wibble\n")  # the outer one wins
    (tmp_path / "shared.aff").write_text("p 3 0 0 0 9 0 0 0 1 0\n")
    scene = read(tmp_path, "i 0 left/main.aff\ni 0 right/main.aff\n")
    assert [mesh.vertices[1, 0] for mesh in scene.meshes] == [1, 9, 2, 9]

import io
import math

import numpy as np
import pytest

import raystream as rs
from raystream.scene.texture import FORMATS

TRIANGLE = [[0, 0, 0], [1, 0, 0], [0, 1, 0]]


@pytest.mark.parametrize(
    ("vertices", "faces", "attributes", "error", "words"),
    [
        ([[0, 0]], [[0, 0, 0]], {}, ValueError, "vertices: expected shape"),
        ([["a", "b", "c"]], [[0, 0, 0]], {}, TypeError, "vertices"),
        ([[1j, 0, 0]], [[0, 0, 0]], {}, TypeError, "vertices"),
        (TRIANGLE, [[0, 1]], {}, ValueError, "faces: expected shape"),
        (TRIANGLE, [[0, 1, 2.0]], {}, TypeError, "faces: expected integers"),
        (TRIANGLE, [[0, 1, 3]], {}, ValueError, r"faces: vertex index 3 is outside 0\.\.2"),
        (TRIANGLE, [[0, 1, -1]], {}, ValueError, "faces: vertex index -1"),
        (TRIANGLE, [[0, 1, 2**40]], {}, ValueError, "faces: vertex index"),
        (TRIANGLE, [[0, 1, 2]], {"normals": [[0, 0, 1]]}, ValueError, "normals: expected shape"),
        (TRIANGLE, [[0, 1, 2]], {"colors": np.zeros((3, 5))}, ValueError, "colors"),
        (TRIANGLE, [[0, 1, 2]], {"texcoords": "no"}, TypeError, "texcoords"),
        (TRIANGLE, [[0, 1, 2]], {"material_ids": [0, 0]}, ValueError, "material_ids"),
        (TRIANGLE, [[0, 1, 2]], {"material_ids": -1}, ValueError, "material_ids"),
        (TRIANGLE, [[0, 1, 2]], {"material_ids": 0.5}, TypeError, "material_ids"),
        (TRIANGLE, [[0, 1, 2]], {"material_ids": 7}, ValueError, "uses material 7"),
    ],
)
def test_bad_meshes_are_named(vertices, faces, attributes, error, words):
    with pytest.raises(error, match=words):
        rs.Scene.from_arrays(vertices, faces, **attributes)


def test_dtypes_of_meshes():
    assert rs.Mesh(np.zeros((3, 3), np.float32), [[0, 1, 2]]).vertices.dtype == np.float32
    assert rs.Mesh(np.zeros((3, 3), np.int16), [[0, 1, 2]]).vertices.dtype == np.float64
    assert rs.Mesh(TRIANGLE, np.array([[0, 1, 2]], np.uint64)).faces.dtype == np.int32
    empty = rs.Mesh([], [])
    assert empty.triangle_count == 0
    assert "0 triangles" in repr(empty)


def test_skipped_triangles_are_counted_and_still_numbered():
    vertices = np.array([*TRIANGLE, [np.nan, 0, 0]], float)
    scene = rs.Scene.from_arrays(vertices, [[0, 1, 3], [0, 0, 1], [0, 1, 2]])
    assert scene.triangle_count == 3
    assert scene.skipped_count == 2
    assert rs.Tracer(scene).first_hit([0.2, 0.2, 1], [0, 0, -1]).prim_id == 2
    np.testing.assert_array_equal(scene.bounds, [[0, 0, 0], [1, 1, 0]])


def test_area_lights_follow_from_materials():
    lamp = rs.Material(emission=(1, 2, 3))
    screen = rs.Material(
        emission=(1, 1, 1), textures={"emission": rs.Texture(np.zeros((1, 1, 3), np.uint8))}
    )
    mesh = rs.Mesh(TRIANGLE, [[0, 1, 2]] * 4, material_ids=[1, 0, 2, 1])
    scene = rs.Scene([mesh, mesh], materials=[rs.Material(), lamp, screen])
    lights = scene.area_lights
    assert [(light.mesh_id, light.prim_ids.tolist(), light.radiance) for light in lights] == [
        (0, [0, 3], (1, 2, 3)),
        (1, [4, 7], (1, 2, 3)),
    ]


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: rs.Material(diffuse=(1, 2)), "diffuse"),
        (lambda: rs.Material(emission=(-1, 0, 0)), "emission"),
        (lambda: rs.Material(ior=math.nan), "ior"),
        (lambda: rs.PointLight((0, 0, math.inf)), "position"),
        (lambda: rs.PointLight((0, 0, 0), falloff="cubic"), "falloff"),
        (lambda: rs.SpotLight((0, 0, 0), (0, 0, 0)), "direction"),
        (lambda: rs.SpotLight((0, 0, 0), (0, 0, 1), inner_angle=50), "inner_angle"),
        (lambda: rs.SpotLight((0, 0, 0), (0, 0, 1), outer_angle=91), "outer_angle"),
        (lambda: rs.DirectionalLight((0, 0, 0)), "direction"),
        (lambda: rs.EnvironmentLight((0, 0)), "radiance"),
        (lambda: rs.Texture(np.zeros((1, 1, 3), np.uint8), wrap="border"), "wrap"),
    ],
)
def test_bad_looks_are_named(make, words):
    with pytest.raises(ValueError, match=words):
        make()


def test_textures_are_decoded_when_asked_for(tmp_path):
    from PIL import Image

    Image.new("RGB", (4, 2), (10, 20, 30)).save(tmp_path / "x.png")
    Image.new("P", (4, 2)).save(tmp_path / "palette.png")
    Image.new("L", (4, 2), 7).save(tmp_path / "grey.png")
    assert rs.Texture(tmp_path / "x.png").pixels().tolist() == [[[10, 20, 30]] * 4] * 2
    assert rs.Texture(tmp_path / "palette.png").pixels().shape == (2, 4, 3)
    assert rs.Texture(tmp_path / "grey.png").pixels().shape == (2, 4, 1)
    assert rs.Texture((tmp_path / "x.png").read_bytes()).pixels().shape == (2, 4, 3)
    for content in (b"", b"\x89PNG\r\n\x1a\n", (tmp_path / "x.png").read_bytes()[:40]):
        (tmp_path / "bad.png").write_bytes(content)
        with pytest.raises(rs.FileFormatError, match=r"bad\.png: cannot read this image"):
            rs.Texture(tmp_path / "bad.png").pixels()


def test_textures_are_bitmaps_and_no_programs(tmp_path, monkeypatch):
    """Pillow would run PostScript in Ghostscript, whatever the name of the file."""
    from PIL import EpsImagePlugin

    def run(*arguments, **named):
        pytest.fail("the program was run")

    monkeypatch.setattr(EpsImagePlugin, "Ghostscript", run)
    program = b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 9 9\n%%EndComments\nshowpage\n"
    (tmp_path / "wood.png").write_bytes(program)
    for source in (tmp_path / "wood.png", program):
        with pytest.raises(rs.FileFormatError, match="cannot read this image"):
            rs.Texture(source).pixels()


@pytest.mark.parametrize("name", FORMATS)
def test_textures_of_all_formats_are_read(name):
    from PIL import Image

    content = io.BytesIO()
    Image.new("RGB", (4, 2), (10, 20, 30)).save(content, name)
    pixels = rs.Texture(content.getvalue()).pixels()
    assert pixels.shape == (2, 4, 3)
    assert np.abs(pixels.astype(int) - [10, 20, 30]).max() < 12


def test_scenes_and_results_travel_to_other_processes():
    """Pickled, as multiprocessing and Dask do."""
    import copy
    import pickle

    scene = rs.load("spheres")
    rays = scene.camera.rays(8, 6)
    tracer = rs.Tracer(scene)
    hits = tracer.first_hit(*rays)
    for duplicate in (pickle.loads(pickle.dumps((scene, hits))), copy.deepcopy((scene, hits))):
        again = rs.Tracer(duplicate[0]).first_hit(*rays)
        np.testing.assert_array_equal(again.t, hits.t)
        np.testing.assert_array_equal(duplicate[1].positions, hits.positions)
        assert [m.diffuse for m in duplicate[0].materials] == [m.diffuse for m in scene.materials]
    other = pickle.loads(pickle.dumps(tracer))
    np.testing.assert_array_equal(other.first_hit(*rays).prim_id, hits.prim_id)


def test_meshes_keep_their_own_copies():
    vertices = np.array(TRIANGLE, float)
    scene = rs.Scene.from_arrays(vertices, [[0, 1, 2]])
    vertices += 5
    assert rs.Tracer(scene).any_hit([0.2, 0.2, 1], [0, 0, -1])
    with pytest.raises(ValueError, match="read-only"):
        scene.meshes[0].vertices[0] = 1


def test_up_is_a_direction():
    assert rs.Scene(up=(0, 5, 0)).up.tolist() == [0, 1, 0]
    with pytest.raises(ValueError, match="up"):
        rs.Scene(up=(0, 0, 0))
    cameras = {rs.Camera.framing((0, 0, 0), (1, 2, 3), up=(0, k, 0)).eye for k in (1.0, 0.25, 64.0)}
    assert len(cameras) == 1


def test_a_scene_does_not_change():
    scene = rs.Scene.from_arrays(TRIANGLE, [[0, 1, 2]])
    for name in ("meshes", "lights", "camera", "animation", "background"):
        with pytest.raises(AttributeError, match=rf"scene\.replace\({name}=\.\.\.\)"):
            setattr(scene, name, None)
    with pytest.raises(AttributeError, match=r"scenes are immutable$"):
        scene.bounds = np.zeros((2, 3))
    with pytest.raises(ValueError, match="read-only"):
        scene.up[0] = 1.0
    scene.cameras["front"] = rs.Camera((0, 0, 9), (0, 0, 0))
    assert not scene.cameras


def test_replace_shares_what_does_not_change():
    mesh = rs.Mesh(TRIANGLE, [[0, 1, 2]], material_ids=1)
    materials = [rs.Material(), rs.Material(name="red")]
    camera = rs.Camera((0, 0, 9), (0, 0, 0))
    scene = rs.Scene(
        [mesh], materials=materials, camera=camera, up=(1, 2, 3), background=(1, 0, 0), name="one"
    )
    light = rs.PointLight((0, 0, 5), (1, 1, 1))
    lit = scene.replace(lights=[light])
    assert (scene.lights, lit.lights) == ((), (light,))
    assert lit.meshes == (mesh,)
    assert lit.materials is scene.materials
    assert lit.camera is camera
    assert lit.up is scene.up
    assert (lit.background, lit.name) == ((1, 0, 0), "one")
    # Made when first asked for, by either of them.
    assert scene.triangles is lit.triangles
    assert scene.replace(meshes=[mesh]).triangles is scene.triangles
    assert scene.replace(meshes=[mesh, mesh]).triangle_count == 2
    assert scene.replace(up=(0, 0, 2)).up.tolist() == [0, 0, 1]
    with pytest.raises(ValueError, match="uses material 1"):
        scene.replace(materials=[])
    with pytest.raises(TypeError, match="sky"):
        scene.replace(sky=light)


def test_a_tracer_takes_a_replaced_scene_without_building():
    tracer = rs.Tracer(rs.load("cornell"))
    structure = tracer.structure
    tracer.update(tracer.scene.replace(background=(0, 1, 0)))
    assert tracer.structure is structure
    assert tracer.scene.background == (0, 1, 0)

"""Confinement: files that an uploaded model names are looked up only among the uploaded ones."""

from __future__ import annotations

import json

import pytest

from extras import need

need("starlette", "uvicorn", "websockets")

import raystream as rs
from raystream.core.errors import FileFormatError, RaystreamWarning
from raystream.viewer.server.upload_folder import RejectedError, TooLargeError, UploadFolder

ID = "0123456789abcdef"
TRIANGLE = "v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nf 1/1 2/1 3/1\n"

#: Ways to name a file outside, which lies two folders up, and in the root folder's place.
OUTSIDE = [
    "../{}",
    "../../{}",
    "..\\..\\{}",
    "./../../{}",
    "x/../../../{}",
    "../0123456789abcdeg/{}",
    "{absolute}",
    "file://{absolute}",
    "%2e%2e/%2e%2e/{}",
    "~/{}",
]


@pytest.fixture
def folder(temporary):
    """An upload folder, and files outside of it that no client may see."""
    folder = UploadFolder(1 << 20)
    yield folder
    folder.remove()
    for secret in temporary.glob("secret*"):
        secret.unlink()


def put(folder, name, content, upload=ID):
    with folder.receive(upload, name, None) as incoming:
        incoming.write(content.encode() if isinstance(content, str) else content)
        incoming.finish()
    return folder.find(upload, name)


def place_secret(temporary, name, content):
    """Put a file where `OUTSIDE` points to, beside the folder and in it."""
    folders = [temporary, *temporary.glob("raystream-view-*")]
    for folder in folders:
        (folder / name).write_bytes(content)
    return temporary / name


def names_of(secret):
    return [name.format(secret.name, absolute=secret) for name in OUTSIDE]


def test_material_libraries_outside_are_not_read(folder, temporary):
    put(folder, "b.mtl", "newmtl none\n")
    secret = place_secret(temporary, "secret.mtl", b"newmtl red\nKd 1 0 0\n")
    lines = [f"mtllib {name}\n" for name in names_of(secret)]
    path = put(folder, "a.obj", f"{''.join(lines)}usemtl red\n{TRIANGLE}")
    with pytest.warns(RaystreamWarning):
        scene = rs.load(path)
    assert all(material.diffuse != (1.0, 0.0, 0.0) for material in scene.materials)


def test_textures_outside_are_not_read(folder, temporary):
    put(folder, "b.mtl", "newmtl none\n")
    secret = place_secret(temporary, "secret.png", b"")
    for number, name in enumerate(names_of(secret)):
        put(folder, f"a{number}.mtl", f"newmtl m\nmap_Kd {name}\n")
        path = put(folder, f"a{number}.obj", f"mtllib a{number}.mtl\nusemtl m\n{TRIANGLE}")
        with pytest.warns(RaystreamWarning):
            scene = rs.load(path)
        assert all(not material.textures for material in scene.materials), name


def test_buffers_outside_are_not_read(folder, temporary):
    put(folder, "b.mtl", "newmtl none\n")
    secret = place_secret(temporary, "secret.bin", bytes(36))
    for number, name in enumerate(names_of(secret)):
        document = {
            "asset": {"version": "2.0"},
            "buffers": [{"byteLength": 36, "uri": name}],
            "bufferViews": [{"buffer": 0, "byteLength": 36}],
            "accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"}],
            "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
            "nodes": [{"mesh": 0}],
            "scenes": [{"nodes": [0]}],
        }
        path = put(folder, f"a{number}.gltf", json.dumps(document))
        with pytest.raises(FileFormatError, match="was not found next to it"):
            rs.load(path)


def test_included_files_outside_are_not_read(folder, temporary):
    put(folder, "b.mtl", "newmtl none\n")
    secret = place_secret(temporary, "secret.aff", b"p 3\n0 0 0\n1 0 0\n0 1 0\n")
    for number, name in enumerate(names_of(secret)):
        path = put(folder, f"a{number}.aff", f"include {name}\n")
        with pytest.raises(FileFormatError):
            rs.load(path)


def test_aff_textures_one_folder_up_are_not_read(folder, temporary):
    """BART keeps them there; one folder up from an upload are the other uploads of its sender."""
    put(folder, "b.mtl", "newmtl none\n")
    outside = temporary / "TextureFiles"
    outside.mkdir()
    (outside / "secret.ppm").write_bytes(b"P6 1 1 255\nabc")
    try:
        path = put(folder, "a.aff", "tt secret.ppm\n0 0 0 0 0\n1 0 0 1 0\n0 1 0 0 1\n")
        with pytest.warns(RaystreamWarning, match="textures not found"):
            scene = rs.load(path)
        assert all(not material.textures for material in scene.materials)
    finally:
        (outside / "secret.ppm").unlink()
        outside.rmdir()
    put(folder, "secret.ppm", b"P6 1 1 255\nabc")  # one that came with it is found
    assert any(material.textures for material in rs.load(path).materials)


def test_files_that_came_together_are_found(folder):
    put(folder, "a.mtl", "newmtl red\nKd 1 0 0\n")
    path = put(folder, "a.obj", f"mtllib ../materials/a.mtl\nusemtl red\n{TRIANGLE}")
    assert (1.0, 0.0, 0.0) in {material.diffuse for material in rs.load(path).materials}


def test_upload_called_as_a_scene_is_a_file(folder):
    path = put(folder, "cornell.obj", TRIANGLE)
    assert rs.load(path).triangle_count == 1


def test_links_are_not_followed_when_written(folder, temporary):
    put(folder, "b.mtl", "newmtl none\n")
    secret = place_secret(temporary, "secret.obj", b"secret")
    (root,) = temporary.glob("raystream-view-*")
    (root / ID / "a.obj").symlink_to(secret)
    with pytest.raises(FileExistsError):
        put(folder, "a.obj", TRIANGLE)
    assert secret.read_bytes() == b"secret"


def test_nothing_comes_after_the_end(folder):
    incoming = folder.receive(ID, "a.obj", None)
    with incoming:
        incoming.write(b"v")
        folder.remove()
        with pytest.raises(RejectedError, match="has ended"):
            incoming.write(b"v")
    with pytest.raises(RejectedError, match="has ended"):
        folder.receive(ID, "b.obj", None)


def test_claims_are_not_believed(folder):
    with folder.receive(ID, "a.bin", 10) as incoming, pytest.raises(TooLargeError):
        incoming.write(bytes((1 << 20) + 1))
    with pytest.raises(TooLargeError, match="at most 1,048,576 bytes"):
        folder.receive(ID, "b.bin", (1 << 20) + 1)

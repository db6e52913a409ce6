"""The server with the real engine: images, an uploaded model, and shutdown."""

from __future__ import annotations

import json
import struct

import pytest

from extras import need

need("starlette", "uvicorn", "websockets")

import raystream as rs
from raystream.viewer.render_service import RenderService
from raystream.viewer.serve import ViewServer, bind
from viewer.browser import PATIENCE
from viewer_home import Guest, no_view_threads_left, wait_until

ID = "0123456789abcdef"
MODEL = b"mtllib red.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl red\nf 1 2 3\n"


@pytest.fixture
def no_threads_left():
    with no_view_threads_left():
        yield


@pytest.fixture
def guest(temporary, no_threads_left):
    """A page of a viewer of the Cornell box."""
    service = RenderService(rs.load("cornell"), "cornell", settings={"mode": "vis"})
    with ViewServer(service, bind("127.0.0.1", 0)) as server:
        guest = Guest(server.port)
        yield guest
        guest.leave()
        wait_until(lambda: server.connection_count == 0)
        assert list(temporary.iterdir()) == []


def read_until(client, kind):
    """The next message of a type; a frame is its header, and shown at once."""
    while True:
        message = client.recv(PATIENCE)
        if isinstance(message, bytes):
            (length,) = struct.unpack_from("<I", message)
            content = message[4 + length :]
            message = json.loads(message[4 : 4 + length]) | {"content": content}
            client.send(json.dumps({"type": "shown", "frame": message["number"]}))
        else:
            message = json.loads(message)
        if message["type"] == kind:
            return message


def test_pictures_come_and_a_model_can_be_sent(guest):
    client = guest.connect()
    assert client.hello["limits"]["upload_bytes"] == 256 << 20
    client.send(json.dumps({"type": "size", "width": 32, "height": 24}))
    assert read_until(client, "scene")["name"] == "cornell"
    frame = read_until(client, "frame")
    assert frame["content"].startswith(b"\xff\xd8\xff")  # JPEG
    while (frame["width"], frame["height"]) != (32, 24):  # the first may be coarse
        frame = read_until(client, "frame")

    assert guest.put(client, f"/uploads/{ID}/red.mtl", b"newmtl red\nKd 1 0 0\n").status == 204
    assert guest.put(client, f"/uploads/{ID}/model.obj", MODEL).status == 204
    client.send(json.dumps({"type": "open", "upload": ID, "name": "model.obj"}))
    scene = read_until(client, "scene")
    assert (scene["name"], scene["triangles"], scene["own"]) == ("model.obj", 1, True)
    assert read_until(client, "frame")

    other = guest.connect()  # who sees what all clients see
    assert read_until(other, "scene")["name"] == "cornell"


def test_model_that_cannot_be_read_is_said_and_the_picture_goes_on(guest):
    client = guest.connect()
    client.send(json.dumps({"type": "size", "width": 32, "height": 24}))
    guest.put(client, f"/uploads/{ID}/model.obj", b"f 1 2\nv x\n\0")
    client.send(json.dumps({"type": "open", "upload": ID, "name": "model.obj"}))
    error = read_until(client, "error")
    assert error["about"] == "open"
    assert error["message"].startswith("model.obj: ")
    assert read_until(client, "frame")

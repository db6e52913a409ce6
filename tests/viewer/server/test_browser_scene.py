"""The server sends a page its scene, to be traced there."""

from __future__ import annotations

import base64
import json
import threading
import time
from concurrent.futures import ThreadPoolExecutor

import pytest

from extras import need

need("starlette", "uvicorn", "websockets")

import raystream as rs
from raystream.viewer import browser_scene
from raystream.viewer.client import Client
from raystream.viewer.render_service import RenderService
from raystream.viewer.serve import ViewServer, bind
from viewer.browser import PATIENCE
from viewer.server.test_with_engine import ID, MODEL, read_until
from viewer_home import Guest, no_view_threads_left, read_answer, wait_until
from web.test_pack import unpacked


@pytest.fixture
def visit(temporary):
    """Open a page of a viewer of a scene, and wait until its structure is built."""
    with no_view_threads_left():
        opened = []

        def open_page(scene, **settings):
            settings.setdefault("mode", "vis")
            service = RenderService(scene, "scene", settings=settings)
            server = ViewServer(service, bind("127.0.0.1", 0))
            guest = Guest(server.port, PATIENCE)  # kernels may have to be compiled
            opened.append((guest, server))
            client = guest.connect()
            client.send(json.dumps({"type": "size", "width": 32, "height": 24}))
            client.structure = read_until(client, "structure")
            return guest, client

        yield open_page
        for guest, server in opened:
            guest.leave()
            server.close()


def load(guest, client, **headers):
    return guest.get("/scene", X_Upload_Key=client.hello["upload_key"], **headers)


def content_of(answer):
    assert answer.status == 200
    assert answer.headers["content-type"] == "application/octet-stream"
    assert int(answer.headers["content-length"]) == len(answer.body)
    return unpacked(base64.b64encode(answer.body).decode())


def test_the_scene_is_that_of_the_connection(visit):
    scene = rs.load("cornell")
    guest, client = visit(scene, structure="kdtree", traversal="restart", max_bounces=3)
    modes = ["raycast", "shadow", "whitted", "ao", "path"]
    assert client.structure["browser"] == {"modes": modes, "reason": None}
    manifest, arrays = content_of(load(guest, client))
    assert manifest["traversals"] == {"kdtree": "restart"}
    assert list(manifest["structures"]) == ["kdtree"]
    bounces = {name: one["max_bounces"] for name, one in manifest["modes"].items()}
    assert bounces == {"raycast": None, "shadow": None, "whitted": 3, "ao": None, "path": 3}
    assert manifest["modes"]["path"]["constants"]["LAST_BOUNCE"] == 3
    assert len(arrays["faces"]) == 3 * scene.triangle_count
    guest.put(client, f"/uploads/{ID}/red.mtl", b"newmtl red\nKd 1 0 0\n")
    guest.put(client, f"/uploads/{ID}/model.obj", MODEL)
    client.send(json.dumps({"type": "open", "upload": ID, "name": "model.obj"}))
    read_until(client, "structure")
    _, arrays = content_of(load(guest, client))
    assert len(arrays["faces"]) == 3
    other = guest.connect()
    read_until(other, "structure")
    _, arrays = content_of(load(guest, other))
    assert len(arrays["faces"]) == 3 * scene.triangle_count


@pytest.mark.parametrize("key", ["", "wrong"])
def test_only_a_page_of_the_viewer_gets_it(visit, key):
    guest, client = visit(rs.load("cornell"))
    assert guest.get("/scene", X_Upload_Key=key).status == 403
    assert load(guest, client, Host="other.example.org").status == 403
    assert load(guest, client, Origin="http://other.example.org").status == 403
    assert load(guest, client).status == 200


def test_of_requests_that_wait_the_last_one_is_answered(visit, monkeypatch):
    guest, client = visit(rs.load("cornell"))
    begun, may_end = [], threading.Event()

    def pack(self):
        begun.append(self)
        may_end.wait(10)
        return b"packed"

    monkeypatch.setattr(Client, "packed_scene", pack)
    with ThreadPoolExecutor(3) as pool:
        answers = []
        for _ in range(3):
            answers.append(pool.submit(load, guest, client))
            wait_until(lambda: begun)
            time.sleep(0.2)  # until the server has it
        may_end.set()
        assert [one.result().status for one in answers] == [200, 409, 200]
    assert len(begun) == 2


def test_a_page_that_does_not_read_holds_one_scene_and_stops_nobody_else(visit, monkeypatch):
    guest, client = visit(rs.load("cornell"))
    other = guest.connect()
    read_until(other, "structure")
    begun, content = [], bytes(32 << 20)  # more than buffers of sockets hold

    def pack(self):
        begun.append(self)
        return content

    monkeypatch.setattr(Client, "packed_scene", pack)
    key = client.hello["upload_key"]
    head = f"GET /scene HTTP/1.1\r\nHost: {guest.name}\r\nX-Upload-Key: {key}\r\n"
    asked = f"{head}Connection: close\r\n\r\n".encode()
    slow, gone, last = (guest.open_socket() for _ in range(3))
    slow.sendall(asked)
    wait_until(lambda: len(begun) == 1)
    gone.sendall(asked)
    time.sleep(0.1)  # until the server has it
    last.sendall(asked)
    assert len(load(guest, other).body) == len(content)
    assert len(begun) == 2  # the scenes of two pages
    assert len(read_answer(slow).body) == len(content)
    assert read_answer(gone).status == 409
    assert len(read_answer(last).body) == len(content)
    assert len(begun) == 3


def test_nothing_is_packed_for_a_page_that_has_gone(visit, monkeypatch):
    guest, client = visit(rs.load("cornell"))
    begun, may_end = [], threading.Event()

    def pack(self):
        begun.append(self)
        may_end.wait(10)
        return b"packed"

    monkeypatch.setattr(Client, "packed_scene", pack)
    key = client.hello["upload_key"]
    asked = f"GET /scene HTTP/1.1\r\nHost: {guest.name}\r\nX-Upload-Key: {key}\r\n\r\n".encode()
    with ThreadPoolExecutor(1) as pool:
        answer = pool.submit(load, guest, client)
        wait_until(lambda: begun)
        gone = guest.open_socket()
        gone.sendall(asked)
        time.sleep(0.2)  # until the server has it
        gone.close()
        time.sleep(0.2)
        may_end.set()
        assert answer.result().status == 200
    assert load(guest, client).status == 200
    assert len(begun) == 2


@pytest.mark.parametrize(
    ("error", "reason"),
    [
        (ValueError("lights: too many"), "The scene could not be packed: lights: too many"),
        (MemoryError(), "The scene could not be packed: out of memory"),
    ],
)
def test_an_error_of_any_kind_is_one_line(visit, monkeypatch, error, reason):
    def fail(*_, **__):
        raise error

    monkeypatch.setattr("raystream.web.scene_data.page_scene", fail)
    guest, client = visit(rs.load("cornell"))
    answer = load(guest, client)
    assert (answer.status, answer.body.decode()) == (500, f"{reason}\n")


def test_what_shaders_do_not_support_is_named(visit):
    guest, client = visit(rs.Scene.spheres([[0.0, 0.0, 0.0]], 1.0))
    reason = "The shaders of pages do not support spheres, height fields and shapes."
    assert client.structure["browser"] == {"modes": [], "reason": reason}
    answer = load(guest, client)
    assert (answer.status, answer.body.decode().strip()) == (409, reason)


def test_large_scenes_are_refused_with_numbers(visit, monkeypatch):
    scene = rs.load("cornell")
    monkeypatch.setattr(browser_scene, "MAX_BYTES", 2000)
    guest, client = visit(scene)
    assert client.structure["browser"]["reason"] is None
    answer = load(guest, client)
    assert answer.status == 409
    assert "at most 2,000 are sent to a browser" in answer.body.decode()
    monkeypatch.setattr(browser_scene, "MAX_BYTES", 28 * scene.triangle_count - 1)
    _, client = visit(scene)
    reason = "The scene has 36 triangles, more than are sent to a browser."
    assert client.structure["browser"]["reason"] == reason

"""Uploads: bounded in size, confined to their folder, and deleted with their connection."""

from __future__ import annotations

import contextlib
import json
import shutil
import stat
import time
from pathlib import PurePosixPath, PureWindowsPath

import pytest
from hypothesis import given
from hypothesis import strategies as st

from extras import need

need("starlette", "uvicorn", "websockets")

from raystream.viewer.server import upload_folder, uploads
from raystream.viewer.server.file_names import is_upload_id, safe_name
from viewer_home import LIMIT, read_answer, wait_until

ID = "0123456789abcdef"
OBJ = b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"

#: Names that try to be somewhere or something else.
BAD_NAMES = [
    "..",
    ".",
    "../model.obj",
    "../../../../etc/passwd",
    "/etc/passwd",
    "..\\model.obj",
    "C:model.obj",
    "C:\\model.obj",
    "\\\\host\\share\\model.obj",
    "model.obj\0.png",
    "model.obj\n",
    "mod\u202eel.obj",
    ".obj",
    ".hidden.obj",
    "model.obj.",
    "model.obj ",
    "con.obj",
    "NUL.obj",
    "com1.tar.obj",
    "aux .obj",
    "model.obj:stream",
    "model?.obj",
    "*.obj",
    "a" * 197 + ".obj",
    "\u00e4" * 99 + ".obj",
    "\ud800.obj",
    "model",
    "model.gz",
    "model.npz",
    "model.py",
    "model.exr.zip",
    "model.obj.gz.gz",
    "cornell",
    "bunny",
    "forest:1000000",
    "",
]


def quoted(name):
    return "".join(f"%{byte:02x}" for byte in name.encode("utf-8", "surrogatepass"))


def read_until(client, kind):
    """The next message of a type."""
    while True:
        message = client.recv(10)
        if isinstance(message, str) and json.loads(message)["type"] == kind:
            return json.loads(message)


def open_model(client, name, upload=ID):
    client.send(json.dumps({"type": "open", "upload": upload, "name": name}))


def test_model_is_opened_with_the_name_that_it_had(home, temporary):
    client = home.connect()
    answer = home.put(client, f"/uploads/{ID}/{quoted('Grüße (2).OBJ')}", OBJ)
    assert (answer.status, answer.body) == (204, b"")
    open_model(client, "Grüße (2).OBJ")
    assert read_until(client, "opened")["content"] == OBJ.decode()
    ((path, name),) = home.service.clients[0].opened
    assert name == "Grüße (2).OBJ"
    assert path.parent.parent.parent == temporary
    if hasattr(stat, "S_IRWXU"):
        assert stat.S_IMODE(path.parent.parent.stat().st_mode) == 0o700
        assert stat.S_IMODE(path.stat().st_mode) == 0o600


def test_reasons_do_not_tell_where_files_lie(home):
    client = home.connect()
    home.put(client, f"/uploads/{ID}/bad.obj", OBJ)
    open_model(client, "bad.obj")
    assert read_until(client, "error")["message"] == "bad.obj: is damaged"


def test_files_go_with_their_connection(home, temporary):
    client, other = home.connect(), home.connect()
    home.put(client, f"/uploads/{ID}/a.obj", OBJ)
    home.put(other, f"/uploads/{ID}/a.obj", OBJ)
    assert len(list(temporary.iterdir())) == 2
    client.close()
    wait_until(lambda: len(list(temporary.iterdir())) == 1)


def test_ten_gigabytes_are_refused_before_they_are_sent(home):
    client = home.connect()
    head = (
        f"PUT /uploads/{ID}/a.obj HTTP/1.1\r\nHost: {home.name}\r\nOrigin: {home.origin}\r\n"
        f"X-Upload-Key: {client.hello['upload_key']}\r\nContent-Length: {10 << 30}\r\n\r\n"
    )
    with home.open_socket() as raw:
        raw.sendall(head.encode())
        answer = read_answer(raw)
    assert answer.status == 413
    assert b"at most" in answer.body
    assert answer.headers["connection"] == "close"


@pytest.mark.parametrize("length", ["-1", "1e3", "0x10", "1 2", "9" * 30, "", "٣"])
def test_strange_lengths_are_refused(home, length):
    client = home.connect()
    answer = home.put(
        client, f"/uploads/{ID}/a.obj", b"", Content_Length=length.encode().decode("latin-1")
    )
    assert answer.status in (400, 413)


def test_more_than_the_limit_is_not_read(home, temporary):
    client = home.connect()
    head = (
        f"PUT /uploads/{ID}/a.obj HTTP/1.1\r\nHost: {home.name}\r\nOrigin: {home.origin}\r\n"
        f"X-Upload-Key: {client.hello['upload_key']}\r\nTransfer-Encoding: chunked\r\n\r\n"
    )
    chunk = b"10000\r\n" + bytes(1 << 16) + b"\r\n"
    sent = 0
    with home.open_socket() as raw:
        raw.sendall(head.encode())
        with contextlib.suppress(OSError):  # it is cut
            while sent < 64 * LIMIT:
                raw.sendall(chunk)
                sent += len(chunk)
    assert sent < 16 * LIMIT
    wait_until(lambda: list(temporary.rglob("a.obj")) == [])
    assert home.put(client, f"/uploads/{ID}/a.obj", OBJ).status == 204  # unsent bytes are free


def test_files_of_an_upload_share_the_limit(home):
    client = home.connect()
    half = bytes(LIMIT // 2)
    statuses = [home.put(client, f"/uploads/{ID}/{name}.bin", half).status for name in "abc"]
    assert statuses == [204, 204, 413]


def test_number_of_files_is_bounded(home, monkeypatch):
    monkeypatch.setattr(upload_folder, "MAX_FILES", 3)
    client = home.connect()
    statuses = [home.put(client, f"/uploads/{ID}/{name}.bin").status for name in "abcd"]
    assert statuses == [204, 204, 204, 409]


def test_old_uploads_make_room_but_the_one_that_is_shown_stays(home, temporary):
    client = home.connect()
    for number in range(6):
        assert home.put(client, f"/uploads/{ID}{number}/a.obj", OBJ).status == 204
        if number == 1:
            open_model(client, "a.obj", f"{ID}1")
            read_until(client, "opened")
    (folder,) = temporary.iterdir()
    assert sorted(one.name[-1] for one in folder.iterdir()) == ["1", "4", "5"]


def test_file_is_not_replaced(home, temporary):
    client = home.connect()
    assert home.put(client, f"/uploads/{ID}/a.obj", OBJ).status == 204
    assert home.put(client, f"/uploads/{ID}/a.obj", b"other").status == 409
    assert next(temporary.rglob("a.obj")).read_bytes() == OBJ


def test_full_disk_is_said(home, monkeypatch):
    client = home.connect()
    usage = shutil.disk_usage("/")._replace(free=upload_folder.DISK_RESERVE)
    monkeypatch.setattr(shutil, "disk_usage", lambda path: usage)
    assert home.put(client, f"/uploads/{ID}/a.obj", OBJ).status == 507


@pytest.mark.parametrize("name", BAD_NAMES)
def test_bad_names_are_refused(home, temporary, name):
    client = home.connect()
    assert home.put(client, f"/uploads/{ID}/{quoted(name)}", OBJ).status in (400, 404, 405)
    assert list(temporary.rglob("*")) == []
    open_model(client, name)
    assert read_until(client, "error")["about"] == "open"
    assert home.service.clients[0].opened == []


@pytest.mark.parametrize("upload", ["short", ID.upper(), "..", f"..%2f{ID}", f"{ID}.", "a" * 33])
def test_bad_upload_names_are_refused(home, temporary, upload):
    client = home.connect()
    assert home.put(client, f"/uploads/{upload}/a.obj", OBJ).status in (400, 404)
    assert list(temporary.iterdir()) == []
    open_model(client, "a.obj", upload)
    assert read_until(client, "error")["about"] == "open"


@pytest.mark.parametrize("message", [{}, {"upload": ID}, {"upload": 7, "name": ["a.obj"]}])
def test_open_without_its_fields_is_answered(home, message):
    client = home.connect()
    client.send(json.dumps({"type": "open", **message}))
    assert read_until(client, "error")["about"] == "open"


def test_only_whole_own_models_are_opened(home):
    client, other = home.connect(), home.connect()
    home.put(client, f"/uploads/{ID}/a.obj", OBJ)
    home.put(client, f"/uploads/{ID}/a.mtl", b"newmtl a\n")
    open_model(other, "a.obj")
    assert "has not been uploaded" in read_until(other, "error")["message"]
    open_model(client, "a.mtl")
    assert "is not a model" in read_until(client, "error")["message"]
    with begin_upload(home, client, "b.obj") as raw:
        raw.sendall(b"v 0")
        wait_until(lambda: uploading(home))
        open_model(client, "b.obj")
        assert "has not been uploaded" in read_until(client, "error")["message"]
    assert [joined.opened for joined in home.service.clients] == [[], []]


def test_upload_key_must_be_that_of_a_live_connection(home, temporary):
    client = home.connect()
    key = client.hello["upload_key"]
    path = f"/uploads/{ID}/a.obj"
    for wrong in ("", "x", key[:-1], f"{key}x", key.swapcase(), None):
        assert home.put(client, path, OBJ, X_Upload_Key=wrong).status == 403
    client.close()
    wait_until(lambda: home.server.connection_count == 0)
    assert home.put(client, path, OBJ).status == 403
    assert list(temporary.iterdir()) == []


# Uploads that do not end.


def begin_upload(home, client, name, length=1000):
    raw = home.open_socket()
    raw.sendall(
        f"PUT /uploads/{ID}/{name} HTTP/1.1\r\nHost: {home.name}\r\nOrigin: {home.origin}\r\n"
        f"X-Upload-Key: {client.hello['upload_key']}\r\nContent-Length: {length}\r\n\r\n".encode()
    )
    return raw


def uploading(home):
    return sum(
        connection.uploads.incoming_count for connection in home.server._connections._connections
    )


def test_upload_that_stops_is_given_up(home, temporary, monkeypatch):
    monkeypatch.setattr(uploads, "IDLE_TIMEOUT", 0.2)
    client = home.connect()
    with begin_upload(home, client, "a.obj") as raw:
        raw.sendall(b"v 0")
        assert read_answer(raw).status == 408
    assert uploading(home) == 0
    assert list(temporary.rglob("a.obj")) == []


def test_upload_that_trickles_is_given_up(home, monkeypatch):
    monkeypatch.setattr(uploads, "IDLE_TIMEOUT", 0.3)
    client = home.connect()
    with begin_upload(home, client, "a.obj", 100_000) as raw:
        for _ in range(100):
            try:
                raw.sendall(b"v")
            except OSError:
                break
            time.sleep(0.02)
        else:
            pytest.fail("it did not stop")
    wait_until(lambda: uploading(home) == 0)


def test_upload_that_is_cut_leaves_nothing(home, temporary):
    client = home.connect()
    with begin_upload(home, client, "a.obj") as raw:
        raw.sendall(b"v 0")
        wait_until(lambda: list(temporary.rglob("a.obj")))
    wait_until(lambda: list(temporary.rglob("a.obj")) == [] and not uploading(home))
    assert home.put(client, f"/uploads/{ID}/a.obj", OBJ).status == 204


def test_upload_ends_when_its_connection_does(home, temporary):
    client = home.connect()
    with begin_upload(home, client, "a.obj") as raw:
        raw.sendall(b"v 0")
        wait_until(lambda: list(temporary.rglob("a.obj")))
        client.close()
        wait_until(lambda: list(temporary.iterdir()) == [])
        assert home.service.present == []
        raw.sendall(b"v 0")
        assert read_answer(raw).status == 409
    assert list(temporary.iterdir()) == []


def test_uploads_at_once_are_bounded_for_each_connection(home, monkeypatch):
    monkeypatch.setattr(upload_folder, "MAX_INCOMING", 1)
    client, other = home.connect(), home.connect()
    with begin_upload(home, client, "a.obj"):
        wait_until(lambda: uploading(home) == 1)
        assert home.put(client, f"/uploads/{ID}/b.obj", OBJ).status == 503
        assert home.put(other, f"/uploads/{ID}/b.obj", OBJ).status == 204
    wait_until(lambda: uploading(home) == 0)
    assert home.put(client, f"/uploads/{ID}/b.obj", OBJ).status == 204


def test_upload_that_was_given_up_for_others_does_not_come_back(home):
    client = home.connect()
    with begin_upload(home, client, "a.obj", 4) as raw:
        raw.sendall(b"v 0")
        wait_until(lambda: uploading(home) == 1)
        for number in range(3):
            home.put(client, f"/uploads/{ID}{number}/a.obj", OBJ)
        raw.sendall(b"\n")
        assert read_answer(raw).status == 409
    open_model(client, "a.obj")
    assert "has not been uploaded" in read_until(client, "error")["message"]


# Names, as such.


@pytest.mark.parametrize("name", BAD_NAMES)
def test_bad_names_are_no_names(name):
    with pytest.raises(ValueError, match="name: "):
        safe_name(name)


@pytest.mark.parametrize(
    "name",
    [
        "bunny.ply",
        "a b (1).OBJ.gz",
        "Ä.gltf",
        "x..y.stl",
        "日本.glb",
        "t.PNG",
        "console.obj",
        "-.bin",
    ],
)
def test_good_names_stay(name):
    assert safe_name(name) == name


def test_name_is_composed():
    assert safe_name("A\u0308.obj") == "\u00c4.obj"


@given(st.text(max_size=30) | st.text("./\\:C obj\0%2eé", max_size=12).map("{}.obj".format))
def test_any_text_is_refused_or_one_component(text):
    try:
        name = safe_name(text)
    except ValueError:
        return
    assert PurePosixPath(name).parts == (name,)
    assert PureWindowsPath(name).parts == (name,)
    assert not PureWindowsPath(name).is_reserved()
    assert len(name.encode()) <= 200


@given(st.text(max_size=40) | st.text("az09Z", min_size=14, max_size=34))
def test_upload_names_are_plain(text):
    assert is_upload_id(text) == (
        16 <= len(text) <= 32 and set(text) <= set("abcdefghijklmnopqrstuvwxyz0123456789")
    )

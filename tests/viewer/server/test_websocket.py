"""Websocket: allowed messages, and clients that misbehave in sending, reading or closing."""

from __future__ import annotations

import contextlib
import json
import socket
import struct
import threading
import time

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from extras import need

need("starlette", "uvicorn", "websockets")

from websockets.exceptions import ConnectionClosed

from raystream.viewer.messages import Frame
from raystream.viewer.server import send_queue, transport
from raystream.viewer.server.connections import MAX_CONNECTIONS
from raystream.viewer.server.protocol import (
    MAX_MESSAGE_BYTES,
    InvalidMessageError,
    NotJsonError,
    pack,
    parse_message,
)
from viewer_home import wait_until

CAMERA = json.dumps({"type": "camera", "number": 1})


def read_until(client, kind):
    """The next message of a type; a frame is its header."""
    while True:
        message = client.recv(10)
        if isinstance(message, bytes):
            message = message[4 : 4 + struct.unpack_from("<I", message)[0]]
        message = json.loads(message)
        if message["type"] == kind:
            return message


def closing_code(client):
    """Read to the end of a connection, and say how it ended."""
    try:
        while True:
            client.recv(10)
    except ConnectionClosed as end:
        return end.rcvd and end.rcvd.code


def test_hello_tells_what_uploads_need(home):
    hello, other = home.connect().hello, home.connect().hello
    assert hello["limits"] == {"samples": 64, "upload_bytes": 1 << 20}
    assert len(hello["upload_key"]) >= 32
    assert hello["upload_key"] != other["upload_key"]


def test_messages_keep_their_order_and_frames_their_form(home):
    client = home.connect()
    assert json.loads(client.recv(10)) == {"type": "scene", "name": "fake"}
    frame = client.recv(10)
    (length,) = struct.unpack_from("<I", frame)
    assert json.loads(frame[4 : 4 + length]) == {"type": "frame", "number": 0}
    assert frame[4 + length :] == b"picture"
    for number in range(200):
        client.send(json.dumps({"type": "camera", "number": number}))
    echoes = [read_until(client, "echo")["message"]["number"] for _ in range(200)]
    assert echoes == list(range(200))


# Invalid messages.


@pytest.mark.parametrize(
    "text",
    [
        *("", " ", "{", "nonsense", "{'type': 'camera'}", '{"type": "camera",}', "{} {}", "\0"),
        *('{"type": NaN}', '{"x": Infinity}', '{"x": -Infinity}', '{"x": 01}', '"\ud7ff'),
        *("[" * 60_000, '{"a":' * 12_000),
    ],
)
def test_what_is_not_json_ends_the_connection(home, text):
    client = home.connect()
    client.send(text)
    assert closing_code(client) == 1007
    assert home.service.clients[0].taken == []


@pytest.mark.parametrize(
    "text",
    [
        *("[]", "[1, 2]", "7", "null", "true", '"camera"', "{}", '{"type": 7}', '{"type": null}'),
        *(
            '{"type": ["camera"]}',
            '{"type": "camera", "x": 1e999}',
            '{"type": "camera", "x": -1e999}',
        ),
        '{"type": "camera", "number": ' + "9" * 400 + "}",
        '{"type": "camera", "number": 10000000000000000}',
        '{"type": "camera", "x": ' + "[" * 9 + "]" * 9 + "}",
        '{"type": "camera", "x": ' + '{"a":' * 500 + "1" + "}" * 501,
        '{"type": "nothing of the kind"}',
        '{"type": ""}',
        '{"type": "\\ud800"}',
    ],
)
def test_json_that_is_no_message_is_answered(home, text):
    client = home.connect()
    client.send(text)
    assert read_until(client, "error")["message"]
    client.send(CAMERA)
    assert read_until(client, "echo")


def test_binary_ends_the_connection(home):
    client = home.connect()
    client.send(CAMERA.encode(), text=False)
    assert closing_code(client) == 1003


def test_text_that_is_not_utf8_ends_the_connection(home):
    client = home.connect()
    client.send(b'{"type": "\xff"}', text=True)
    assert closing_code(client) == 1007


@pytest.mark.parametrize("in_parts", [False, True])
def test_long_messages_end_the_connection(home, in_parts):
    client = home.connect()
    client.send(json.dumps({"type": "camera", "x": "a" * (MAX_MESSAGE_BYTES - 40)}))
    assert read_until(client, "echo")
    message = " " * (MAX_MESSAGE_BYTES + 1)
    with contextlib.suppress(ConnectionClosed):  # it may end while this is sent
        client.send(iter([message[:30_000], message[30_000:]]) if in_parts else message)
    assert closing_code(client) == 1009


def test_many_bad_messages_in_a_row_end_the_connection(home):
    client = home.connect()
    for _ in range(50):
        client.send('{"type": "nonsense"}')
    client.send(CAMERA)  # a good one between: the count starts again
    for _ in range(50):
        client.send("[]")
    assert read_until(client, "echo")
    client.send('{"type": "nonsense"}')
    assert closing_code(client) == 1008


def test_frames_that_are_no_websocket_frames_end_the_connection(home):
    client = home.connect()
    client.socket.sendall(b"\xff\xff\xff\xff\xff\xff\xff\xff\xff\xff")
    assert closing_code(client) == 1002


def test_client_that_sends_fast_is_listened_to_slowly(home):
    patient, hasty = home.connect(), home.connect()
    frame = CAMERA.encode()
    masked = bytes([0x81, 0x80 | len(frame)]) + bytes(4) + frame
    reader = threading.Thread(target=lambda: closing_code(hasty))
    reader.start()
    hasty.socket.sendall(masked * 5000)
    started = time.monotonic()
    patient.send(CAMERA)
    read_until(patient, "echo")
    assert time.monotonic() - started < 5.0
    assert len(home.service.clients[1].taken) < 5000
    hasty.socket.shutdown(socket.SHUT_RDWR)
    reader.join()


json_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8),
    lambda inner: (
        st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=4), inner, max_size=3)
    ),
    max_leaves=8,
)


@given(
    st.text(max_size=60) | json_values.map(json.dumps) | st.text('{}[]":,0e-9Nantype', max_size=30)
)
def test_any_text_is_a_message_or_refused(text):
    try:
        message = parse_message(text)
    except (NotJsonError, InvalidMessageError):
        return
    assert isinstance(message["type"], str)
    json.dumps(message, allow_nan=False)


@given(json_values)
def test_whatever_is_sent_is_strict_json(value):
    json.loads(pack({"type": "any", "value": value}), parse_constant=pytest.fail)


def test_numbers_of_numpy_are_sent():
    message = {"t": np.float32(np.inf), "prim_id": np.int32(7), "normal": np.arange(3.0)}
    assert json.loads(pack(message)) == {"t": None, "prim_id": 7, "normal": [0.0, 1.0, 2.0]}
    assert pack(Frame({"t": np.nan}, b"x")) == b"\x0a\x00\x00\x00" + b'{"t":null}' + b"x"


# Many, and clients that come and go.


def test_fifty_clients_at_once(home):
    clients, refused = [], []

    def come():
        client = home.connect()
        (clients if client.hello["type"] == "hello" else refused).append(client)

    comers = [threading.Thread(target=come) for _ in range(50)]
    for comer in comers:
        comer.start()
    for comer in comers:
        comer.join(30)
    assert (len(clients), len(refused)) == (MAX_CONNECTIONS, 50 - MAX_CONNECTIONS)
    for client in refused:
        assert client.hello["type"] == "closing"
        assert "too many" in client.hello["reason"]
        assert closing_code(client) == 1013
    for client in clients:
        client.send(CAMERA)
    for client in clients:
        assert read_until(client, "echo")
    assert len(home.service.present) == MAX_CONNECTIONS
    clients[0].close()
    wait_until(lambda: len(home.service.present) == MAX_CONNECTIONS - 1)
    assert home.connect().hello["type"] == "hello"  # its place is free


def test_clients_that_vanish_in_the_middle_of_frames_are_let_go(home):
    for _ in range(8):
        client = home.connect()
        client.send(json.dumps({"type": "stream", "bytes": 300_000}))
        read_until(client, "frame")
        client.socket.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        client.socket.shutdown(socket.SHUT_RDWR)
        client.socket.close()
    wait_until(lambda: not home.service.present)
    wait_until(lambda: home.server.connection_count == 0)
    for joined in home.service.clients:
        joined.thread.join(5)
        assert not joined.thread.is_alive()


def test_client_that_stops_in_the_middle_of_a_message_is_let_go(home):
    client = home.connect()
    client.socket.sendall(b"\x81\xfe\xff\xff\0\0\0\0{")  # promises 65,535 bytes
    client.socket.shutdown(socket.SHUT_WR)
    wait_until(lambda: not home.service.present)


def begin_websocket(home, raw):
    raw.sendall(
        f"GET /live HTTP/1.1\r\nHost: {home.name}\r\nOrigin: {home.origin}\r\n"
        "Connection: Upgrade\r\nUpgrade: websocket\r\nSec-WebSocket-Version: 13\r\n"
        "Sec-WebSocket-Key: c3RyZWFtcyBvZiByYXlzIQ==\r\n\r\n".encode()
    )


@pytest.fixture
def deaf(home):
    """A websocket that reads nothing after its beginning, and has little room for it."""
    with socket.socket() as raw:
        raw.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        raw.settimeout(10)
        raw.connect(("127.0.0.1", home.port))
        begin_websocket(home, raw)
        wait_until(lambda: home.service.present)
        yield raw


def is_rid_of_all(home):
    connections = home.server._server.server_state.connections
    return not home.service.present and home.server.connection_count == 0 and not connections


@pytest.mark.parametrize("limit", ["of time", "of what waits"])
def test_client_that_reads_nothing_is_dropped(home, deaf, monkeypatch, limit):
    if limit == "of time":
        monkeypatch.setattr(transport, "READ_TIMEOUT", 0.3)
    else:
        monkeypatch.setattr(send_queue, "MAX_WAITING_BYTES", 4 << 20)
    message = json.dumps({"type": "stream", "bytes": 200_000}).encode()
    deaf.sendall(bytes([0x81, 0x80 | len(message)]) + bytes(4) + message)
    wait_until(lambda: home.service.clients[0].taken)
    wait_until(lambda: is_rid_of_all(home))


def test_pings_are_not_answered_without_end(home, deaf, monkeypatch):
    """Unread answers are dropped: a client that does not read is not read from either."""
    monkeypatch.setattr(transport, "READ_TIMEOUT", 0.3)
    pings = (bytes([0x89, 0x80 | 125]) + bytes(4 + 125)) * 500
    sent = 0
    with contextlib.suppress(OSError):
        while sent < 256 << 20:
            sent += deaf.send(pings)
    assert sent < 64 << 20
    wait_until(lambda: is_rid_of_all(home))


def test_client_that_answers_no_pings_is_let_go(make_home):
    home = make_home()
    config = home.server._server.config
    assert 0.0 < config.ws_ping_interval + config.ws_ping_timeout <= 60.0
    config.ws_ping_interval = config.ws_ping_timeout = 0.1
    with home.open_socket() as raw:
        begin_websocket(home, raw)
        wait_until(lambda: home.service.clients)
        wait_until(lambda: is_rid_of_all(home))


def test_end_of_the_server_is_said(make_home):
    home = make_home()
    clients = [home.connect() for _ in range(3)]
    clients[0].send(json.dumps({"type": "stream", "bytes": 100_000}))
    read_until(clients[0], "frame")
    started = time.monotonic()
    home.server.close()
    assert time.monotonic() - started < 3.0
    for client in clients:
        assert read_until(client, "closing")["reason"] == "the viewer was stopped"
        assert closing_code(client) == 1001
    assert home.service.present == []
    with pytest.raises(OSError, match="refused"):
        home.open_socket()

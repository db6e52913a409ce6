"""Transport: connections that send nothing, are too slow, or are too many."""

from __future__ import annotations

import socket
import time

import pytest

from extras import need

need("starlette", "uvicorn", "websockets")

from raystream.viewer.server import transport
from viewer_home import PAGE, read_answer, wait_until


def connection_count(home):
    return len(home.server._server.server_state.connections)


def test_connection_without_a_request_ends(home, monkeypatch):
    monkeypatch.setattr(transport, "HEAD_TIMEOUT", 0.2)
    with home.open_socket() as raw:
        assert raw.recv(10) == b""
    wait_until(lambda: connection_count(home) == 0)


def test_head_that_trickles_ends(home, monkeypatch):
    monkeypatch.setattr(transport, "HEAD_TIMEOUT", 0.3)
    with home.open_socket() as raw:
        raw.sendall(f"GET / HTTP/1.1\r\nHost: {home.name}\r\n".encode())
        for _ in range(100):
            try:
                raw.sendall(b"X: y\r\n")
            except OSError:
                break
            time.sleep(0.02)
        else:
            raise AssertionError("it did not stop")
    wait_until(lambda: connection_count(home) == 0)


def test_second_head_that_trickles_ends(home, monkeypatch):
    monkeypatch.setattr(transport, "HEAD_TIMEOUT", 0.3)
    with home.open_socket() as raw:
        raw.sendall(f"GET / HTTP/1.1\r\nHost: {home.name}\r\n\r\n".encode())
        content = b""
        while not content.endswith(PAGE["index.html"].content):
            content += raw.recv(65536)
        raw.sendall(b"GET / HTTP/1.1\r\n")
        assert raw.recv(10) == b""


def test_long_heads_are_refused(home):
    assert home.get("/" + "a" * 1_000_000).status in (400, 0)
    assert home.get(X_Long="a" * 1_000_000).status in (400, 0)
    assert home.get().status == 200


def test_nonsense_is_refused(home):
    for nonsense in (
        b"\0" * 100,
        b"\x16\x03\x01\x02\0",
        b"GET\r\n\r\n",
        b"\r\n" * 50 + b"x\r\n\r\n",
    ):
        with home.open_socket() as raw:
            raw.sendall(nonsense)
            raw.shutdown(1)
            assert read_answer(raw).status in (400, 0)
    assert home.get().status == 200


@pytest.mark.parametrize("limit", ["MAX_SOCKETS", "MAX_SOCKETS_PER_ADDRESS"])
def test_connections_are_bounded(home, monkeypatch, limit):
    monkeypatch.setattr(transport, limit, 5)
    kept = [home.open_socket() for _ in range(5)]
    wait_until(lambda: connection_count(home) == 5)
    assert home.get().status == 0
    for raw in kept:
        raw.close()
    wait_until(lambda: connection_count(home) == 0)
    assert home.get().status == 200


def test_file_that_is_not_read_is_given_up(home, monkeypatch):
    monkeypatch.setattr(transport, "READ_TIMEOUT", 0.2)
    with socket.socket() as raw:
        raw.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        raw.connect(("127.0.0.1", home.port))
        raw.sendall(f"GET /page/large.js HTTP/1.1\r\nHost: {home.name}\r\n\r\n".encode())
        wait_until(lambda: connection_count(home) == 1)
        wait_until(lambda: connection_count(home) == 0)

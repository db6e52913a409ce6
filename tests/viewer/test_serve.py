"""Serving: addresses and ports, and a server's lifetime."""

from __future__ import annotations

import ipaddress
import socket
import threading
import urllib.request

import pytest

from extras import need

need("starlette", "uvicorn", "websockets")

from fake_service import FakeService
from raystream.core.errors import RaystreamError
from raystream.viewer import serve
from raystream.viewer.serve import ViewServer, bind
from raystream.viewer.server import app
from viewer_home import PAGE


@pytest.fixture(autouse=True)
def page(monkeypatch):
    monkeypatch.setattr(app, "read_page_files", lambda: PAGE)


def test_port_is_the_preferred_one_if_it_is_free(monkeypatch):
    with bind("127.0.0.1", 0) as free:
        monkeypatch.setattr(serve, "PREFERRED_PORT", free.getsockname()[1])
        with bind() as other:  # it is taken: any that is free
            assert other.getsockname()[1] != serve.PREFERRED_PORT
    with bind() as preferred:
        assert preferred.getsockname() == ("127.0.0.1", serve.PREFERRED_PORT)


def test_taken_port_is_said():
    with bind("127.0.0.1", 0) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(RaystreamError, match=f"^--port: {port} is in use on 127.0.0.1"):
            bind("127.0.0.1", port)


@pytest.mark.parametrize("host", ["nowhere.invalid", "203.0.113.7", "1.2.3.4.5", "", "a" * 300])
def test_address_of_nobody_is_said(host):
    with pytest.raises(RaystreamError, match=r"^--host: .*is not an address of this machine"):
        bind(host, 0)


def test_it_ends_cleanly_and_frees_its_port():
    threads = threading.active_count()
    service = FakeService()
    with ViewServer(service, bind("localhost", 0)) as server:
        with urllib.request.urlopen(server.url, timeout=10) as answer:
            assert answer.read() == PAGE["index.html"].content
        assert server.is_running
        assert server.is_loopback
    server.close()
    assert not server.is_running
    assert service.is_closed
    assert threading.active_count() == threads
    with bind("127.0.0.1", server.port):
        pass


def test_several_at_once():
    first, second = (ViewServer(FakeService(), bind("127.0.0.1", 0)) for _ in range(2))
    assert first.url != second.url
    first.close()
    with urllib.request.urlopen(second.url, timeout=10) as answer:
        assert answer.status == 200
    second.close()


@pytest.mark.parametrize("own", ["192.0.2.7", None])
def test_address_has_the_token_once_others_can_reach_it(monkeypatch, own):
    monkeypatch.setattr(serve, "lan_address", lambda: own)
    with ViewServer(FakeService(), bind("0.0.0.0", 0)) as server:
        assert not server.is_loopback
        host, query = server.url.removeprefix("http://").split("/")
        assert host == f"{own or socket.gethostname().lower()}:{server.port}"
        assert query.startswith("?token=")
        assert server._access.accepts_host(host)
        assert server.local_url == f"http://localhost:{server.port}/{query}"


def test_own_address_is_one_or_none():
    own = serve.lan_address()
    assert own is None or not ipaddress.ip_address(own).is_unspecified


def test_without_a_network_there_is_no_own_address(monkeypatch):
    def refuse(*arguments):
        raise OSError(101, "Network is unreachable")

    monkeypatch.setattr(serve.socket, "socket", lambda *kind: FakeSocket(refuse))
    assert serve.lan_address() is None


class FakeSocket:
    def __init__(self, connect):
        self.connect = connect

    def __enter__(self):
        return self

    def __exit__(self, *error):
        pass


@pytest.mark.skipif(not socket.has_ipv6, reason="there is no IPv6 here")
def test_address_of_version_6_is_in_brackets():
    try:
        listener = bind("::1", 0)
    except RaystreamError:
        pytest.skip("there is no IPv6 here")
    with ViewServer(FakeService(), listener) as server:
        assert server.url == f"http://[::1]:{server.port}/"
        with urllib.request.urlopen(server.url, timeout=10) as answer:
            assert answer.status == 200


def test_failing_start_closes_what_it_was_given():
    service, listener = FakeService(), bind("127.0.0.1", 0)
    with pytest.raises(RaystreamError, match="--token"):
        ViewServer(service, listener, token="short")
    assert service.is_closed
    assert listener.fileno() == -1

"""Guard: requests with a wrong host name, a wrong origin or no token are refused."""

from __future__ import annotations

import logging

import pytest

from extras import need

need("starlette", "uvicorn", "websockets")

from raystream.core.errors import RaystreamError
from raystream.viewer.server.access import Access, make_token

WRONG_HOSTS = [
    "evil.example",
    "evil.example:{port}",
    "127.0.0.1.evil.example:{port}",
    "localhost.evil.example:{port}",
    "evil.example@127.0.0.1:{port}",
    "127.0.0.1:{port}@evil.example",
    "127.0.0.1:{port}, evil.example",
    "127.0.0.1:port",
    "10.0.0.1:{port}",
    "0.0.0.0:{port}",
    "[::1",
    "[fe80::1]:{port}",
    "localhost:{port}/",
    "",
]

WRONG_ORIGINS = [
    "http://evil.example",
    "http://evil.example:{port}",
    "http://127.0.0.1",
    "http://127.0.0.1:1",
    "http://localhost:{port}",  # another origin than the one that was asked for
    "http://127.0.0.1:{port}.evil.example",
    "http://127.0.0.1:{port}/",
    "https://evil.example/127.0.0.1:{port}",
    "ftp://127.0.0.1:{port}",
    "file://",
    "null",
    "",
]


def test_page_and_its_files_are_served(home):
    assert home.get().body == b"<!doctype html><title>page</title>"
    answer = home.get("/page/view.js")
    assert (answer.status, answer.body) == (200, b"start()")
    assert answer.headers["content-type"].startswith("text/javascript")


@pytest.mark.parametrize(
    "path",
    [
        "/page/",
        "/page",
        "/page/absent.js",
        "/page/__init__.py",
        "/page/../serve.py",
        "/page/..%2fserve.py",
        "/page/%2e%2e/serve.py",
        "/page/..\\serve.py",
        "/page/%00index.html",
        "/page//etc/passwd",
        "//etc/passwd",
        "/../../etc/passwd",
        "/index.html",
        "/docs",
        "/openapi.json",
        "/live",
        "/uploads",
        "/uploads/aaaaaaaaaaaaaaaa/a.obj",
        "/.git/config",
        "/server-status",
    ],
)
def test_nothing_else_is_served(home, path):
    answer = home.get(path)
    assert answer.status in (404, 405)
    assert b"import" not in answer.body
    assert b"root:" not in answer.body
    assert "location" not in answer.headers


@pytest.mark.parametrize(
    "method", ["POST", "PUT", "DELETE", "PATCH", "OPTIONS", "TRACE", "NONSENSE"]
)
def test_other_methods_are_refused(home, method):
    assert home.request(method, "/", Origin=home.origin).status == 405


@pytest.mark.parametrize("host", WRONG_HOSTS)
def test_wrong_host_is_refused(home, host):
    host = host.format(port=home.port)
    for path in ("/", "/page/view.js", "/absent"):
        answer = home.get(path, Host=host, Origin=f"http://{host}")
        assert answer.status in (400, 403)
        assert b"page" not in answer.body
    assert home.upgrade(Host=host, Origin=f"http://{host}").status in (400, 403)
    assert home.service.clients == []


def test_host_must_be_there_once(home):
    assert home.ask("GET / HTTP/1.1").status == 400
    assert home.ask("GET / HTTP/1.0").status == 403
    assert home.ask(f"GET / HTTP/1.1\nHost: {home.name}\nHost: evil.example").status == 400
    # An address in the first line does not replace it.
    assert home.ask("GET http://127.0.0.1/ HTTP/1.1\nHost: evil.example").status == 403


@pytest.mark.parametrize("host", ["127.0.0.1", "localhost", "LOCALHOST", "localhost.", "[::1]"])
def test_names_of_this_machine_are_right(home, host):
    assert home.get(Host=f"{host}:{home.port}", Connection="close").status == 200
    assert home.get(Host=f"{host}:1234", Connection="close").status == 200  # through a tunnel


@pytest.mark.parametrize("origin", [*WRONG_ORIGINS, None])
def test_wrong_origin_opens_no_websocket(home, origin):
    answer = home.upgrade(Origin=origin and origin.format(port=home.port))
    assert answer.status == 403
    assert "content-security-policy" in answer.headers
    assert home.service.clients == []


def test_refusal_of_a_websocket_is_no_fault_of_the_server(home, caplog):
    assert home.upgrade(Origin="http://evil.example").status == 403
    home.get()  # the task of the rejection has ended
    assert [record for record in caplog.records if record.levelno >= logging.WARNING] == []


def test_two_origins_open_no_websocket(home):
    assert home.upgrade(Origin=f"{home.origin}\nOrigin: {home.origin}").status in (400, 403)
    assert home.service.clients == []


@pytest.mark.parametrize("origin", WRONG_ORIGINS)
def test_wrong_origin_gets_no_page_and_sends_no_file(home, origin):
    origin = origin.format(port=home.port)
    assert home.get(Origin=origin).status == 403
    client = home.connect()
    assert home.put(client, "/uploads/aaaaaaaaaaaaaaaa/a.obj", Origin=origin).status == 403
    assert home.put(client, "/uploads/aaaaaaaaaaaaaaaa/a.obj", Origin=None).status == 403


def test_origin_through_a_tunnel_is_right(home):
    with home.open_socket() as raw:
        head = (
            "GET /live HTTP/1.1\r\nHost: localhost:9999\r\nOrigin: https://localhost:9999\r\n"
            "Connection: Upgrade\r\nUpgrade: websocket\r\nSec-WebSocket-Version: 13\r\n"
            "Sec-WebSocket-Key: c3RyZWFtcyBvZiByYXlzIQ==\r\n\r\n"
        )
        raw.sendall(head.encode())
        assert raw.recv(4096).startswith(b"HTTP/1.1 101")


def test_every_answer_has_security_headers(home):
    answers = [
        home.get(),
        home.get("/absent"),
        home.request("POST", "/", Origin=home.origin),
        home.get(Host="evil.example"),
    ]
    assert [answer.status for answer in answers] == [200, 404, 405, 403]
    for answer in answers:
        policy = answer.headers["content-security-policy"]
        assert "default-src 'none'" in policy
        assert "script-src 'self';" in policy
        assert "unsafe" not in policy
        assert "frame-ancestors 'self' http://localhost:*" in policy
        assert answer.headers["x-content-type-options"] == "nosniff"
        assert answer.headers["referrer-policy"] == "no-referrer"
        assert answer.headers["cross-origin-resource-policy"] == "same-origin"
        assert "server" not in answer.headers


# A token.


@pytest.fixture
def guarded(make_home):
    return make_home("0.0.0.0")


def token_of(home):
    return home.server.url.partition("?token=")[2]


def log_in(home):
    answer = home.get(f"/?token={token_of(home)}")
    assert answer.status == 200
    assert answer.headers["refresh"] == "0; url=/"
    return answer.headers["set-cookie"]


def test_without_token_nothing_is_served(guarded):
    cookie = f"raystream_{guarded.port}"
    wrong = {
        "/": {},
        "/page/view.js": {},
        "/absent": {},
        "/?token=": {},
        "/?token=wrong": {},
        f"/?TOKEN={token_of(guarded)}": {},
        f"/?token={token_of(guarded)[:-1]}": {},
        f"/?token=%ff%00&{'&'.join('abcdefghij')}": {},
        "/?a": {"Cookie": f"{cookie}="},
        "/?b": {"Cookie": f"{cookie}={token_of(guarded)}"},
        "/?c": {"Cookie": "nonsense; =; ;;"},
        "/?d": {"Authorization": f"Bearer {token_of(guarded)}"},
    }
    for path, headers in wrong.items():
        answer = guarded.get(path, **headers)
        assert answer.status == 401, path
        assert b"page" not in answer.body
        assert "set-cookie" not in answer.headers
    assert guarded.upgrade().status == 401
    assert guarded.service.clients == []


def test_token_becomes_a_strict_cookie_that_opens_all(guarded):
    cookie = log_in(guarded)
    assert "httponly" in cookie.lower()
    assert "samesite=strict" in cookie.lower()
    assert token_of(guarded) not in cookie
    pair = cookie.partition(";")[0]
    assert guarded.get(Cookie=f"other=1; {pair}").body.endswith(b"<title>page</title>")
    client = guarded.connect(headers={"Cookie": pair})
    assert client.hello["type"] == "hello"
    path = "/uploads/aaaaaaaaaaaaaaaa/a.obj"
    assert guarded.put(client, path).status == 401
    assert guarded.put(client, path, Cookie=pair).status == 204


def test_token_does_not_excuse_a_wrong_host_or_origin(guarded):
    pair = log_in(guarded).partition(";")[0]
    assert guarded.get(Cookie=pair, Host=f"evil.example:{guarded.port}").status == 403
    path = f"/?token={token_of(guarded)}"
    assert guarded.get(path, Host="evil.example").status == 403
    assert guarded.upgrade(Origin="http://evil.example", Cookie=pair).status == 403


def test_frames_of_others_are_refused_off_loopback(guarded):
    assert "frame-ancestors 'none'" in guarded.get().headers["content-security-policy"]


def test_chosen_token_is_asked_for_on_loopback_too(make_home):
    home = make_home(token="a-token-of-my-own")
    assert home.get().status == 401
    assert home.get("/?token=a-token-of-my-own").status == 200


def test_token_is_in_no_log(guarded, caplog, capfd):
    caplog.set_level(logging.DEBUG)
    log_in(guarded)
    guarded.get(f"/absent?token={token_of(guarded)}")
    out, err = capfd.readouterr()
    assert token_of(guarded) not in caplog.text + out + err


@pytest.mark.parametrize(
    "token", ["", "short", "a" * 15, "a" * 257, "with space in the middle", "ä" * 20]
)
def test_weak_or_strange_tokens_are_refused(token):
    with pytest.raises(RaystreamError, match="--token: expected 16 to 256"):
        make_token(token)


def test_tokens_differ():
    assert len({make_token() for _ in range(10)}) == 10
    assert len(make_token()) >= 43  # 256 bits


@pytest.mark.parametrize(
    ("address", "has_token", "right", "wrong"),
    [
        ("127.0.0.1", False, ["127.0.0.1", "localhost:80"], ["10.0.0.1", "viewer.example"]),
        ("::1", False, ["[::1]:8008", "localhost"], ["[fe80::1]"]),
        ("10.1.2.3", True, ["10.1.2.3:8008"], ["localhost", "10.1.2.4", "evil.example"]),
        ("0.0.0.0", True, ["10.1.2.3", "[fe80::1]:1", "localhost"], ["evil.example", "1.2.3.4.5"]),
        ("::", True, ["10.1.2.3", "[::1]"], ["evil.example"]),
    ],
)
def test_access_of_addresses(address, has_token, right, wrong):
    access = Access(address, 8008)
    assert (access.token is not None) == has_token
    assert [host for host in right if not access.accepts_host(host)] == []
    assert [host for host in wrong if access.accepts_host(host)] == []


def test_name_that_the_user_gave_is_right():
    assert Access("10.1.2.3", 8008, host="Viewer.Example").accepts_host("viewer.example:8008")

"""``raystream view``: its address, refused arguments, and shutdown."""

from __future__ import annotations

import importlib.util
import os
import signal
import subprocess
import sys
import urllib.request

import pytest

from extras import need

need("starlette", "uvicorn", "websockets")

from fake_service import FakeService
from raystream.viewer import render_service
from raystream.viewer.serve import ViewServer, bind
from raystream.viewer.server import app
from viewer_home import PAGE, Guest, wait_until


class RenderService(FakeService):
    """Records its arguments."""

    def __init__(self, tracer, name, *, settings):
        super().__init__()
        self.tracer, self.name, self.settings = tracer, name, settings


@pytest.fixture
def served(monkeypatch):
    """Addresses, statuses and services of runs that began to serve; each then gets a Ctrl-C."""
    seen = []

    def wait(server):
        with urllib.request.urlopen(server.local_url, timeout=10) as answer:
            seen.append((server.url, answer.status, server._service))
        raise KeyboardInterrupt

    monkeypatch.setattr(ViewServer, "wait", wait)
    monkeypatch.setattr(app, "read_page_files", lambda: PAGE)
    monkeypatch.setattr(render_service, "RenderService", RenderService)
    return seen


@pytest.fixture
def opened(monkeypatch):
    """Addresses that a browser was told to open."""
    addresses = []
    monkeypatch.setattr("webbrowser.open", addresses.append)
    return addresses


def test_address_is_printed_and_ctrl_c_ends_it(run, square, served, opened):
    shown = run("view", square, "--port", 0)
    ((url, status, made),) = served
    assert (shown.code, shown.out, status) == (130, f"{url}\n", 200)
    assert url.startswith("http://127.0.0.1:")
    assert "interrupted" in shown.err
    assert opened == []  # there is no screen here
    assert made.is_closed


def test_options_are_what_the_page_begins_with(run, square, served):
    shown = run(
        *("view", square, "--port", 0, "--structure", "kdtree", "--traversal", "restart"),
        *("--mode", "vis", "--eye", 0.5, 0.5, 3, "--look-at", 0.5, 0.5, 0, "--fov", 40),
    )
    assert shown.code == 130
    made = served[0][2]
    assert (made.name, made.settings) == (str(square), {"mode": "vis"})
    assert made.tracer.structure.name == "kdtree"
    assert made.tracer.structure.options.traversal == "restart"
    assert made.tracer.scene.camera.eye == (0.5, 0.5, 3.0)


def test_others_need_the_token(run, square, served, opened):
    shown = run(
        *("view", square, "--host", "0.0.0.0", "--port", 0, "--open"),
        *("--token", "a-token-of-my-own"),
    )
    assert shown.out.endswith("/?token=a-token-of-my-own\n")
    assert "not encrypted" in shown.err
    wait_until(lambda: opened)
    assert opened[0].startswith("http://localhost:")


def test_port_that_is_taken_is_said(run, square):
    with bind("127.0.0.1", 0) as taken:
        port = taken.getsockname()[1]
        complaint = run("view", square, "--port", port).complaint
    assert complaint == (f"--port: {port} is in use on 127.0.0.1; omit it to use any free port")


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (["absent.obj"], "there is no such file"),
        (["square.obj", "--host", "203.0.113.7"], "--host: 203.0.113.7 is not an address"),
        (["square.obj", "--port", "70000"], "--port"),
        (["square.obj", "--token", "short"], "--token: expected 16 to 256"),
        (["square.obj", "--upload-limit", "0"], "--upload-limit"),
        (["square.obj", "--mode", "raytrace"], "expected raycast or"),
        (["square.obj", "--structure", "octree"], "expected bvh or"),
        (["square.obj", "--traversal", "restart"], "traversal"),
        (["square.obj", "--fov", "400"], "--fov: expected degrees"),
        (["square.obj", "--camera", "7"], "--camera: "),
        (["square.obj", "--adapter", "x"], "--adapter: only with --device graphics"),
    ],
)
def test_bad_input_is_one_line(run, square, served, arguments, reason):
    assert reason in run("view", *arguments).complaint
    assert served == []


def test_missing_package_is_named(run, square, monkeypatch):
    find = importlib.util.find_spec
    monkeypatch.setattr(
        importlib.util, "find_spec", lambda name: None if name == "websockets" else find(name)
    )
    complaint = run("view", square).complaint
    assert complaint == "the viewer needs websockets: pip install 'raystream[view]'"


@pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
@pytest.mark.parametrize(
    "number", [signal.SIGTERM, pytest.param(signal.SIGINT, marks=pytest.mark.exhaustive)]
)
def test_signals_end_it_cleanly(square, environment, tmp_path, number):
    """With a connected client, and files uploaded."""
    temporary = tmp_path / "temporary"
    temporary.mkdir()
    code = (
        "import signal; signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        "from raystream.viewer.server import app; app.read_page_files = dict\n"
        "from raystream.cli import main; main()"
    )
    with subprocess.Popen(
        [sys.executable, "-c", code, "view", str(square), "--port", "0", "--structure", "brute"],
        env={**environment, "TMPDIR": str(temporary)},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        try:
            guest = Guest(int(process.stdout.readline().rpartition(":")[2].strip("/\n")))
            client = guest.connect()
            assert guest.put(client, "/uploads/0123456789abcdef/a.obj").status == 204
            assert len(list(temporary.iterdir())) == 1
            process.send_signal(number)
            _, err = process.communicate(timeout=30)
        finally:
            process.kill()
    guest.leave()
    assert process.returncode == (130 if number == signal.SIGINT else 143)
    assert "Traceback" not in err
    assert list(temporary.iterdir()) == []

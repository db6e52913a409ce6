"""view: the viewer in a notebook."""

from __future__ import annotations

import gc
import re
import subprocess
import sys
import urllib.request

import pytest

from extras import need

need("starlette", "uvicorn", "websockets")

import raystream as rs
from conftest import child_environment
from raystream.viewer.server import app
from viewer_home import PAGE, no_view_threads_left


@pytest.fixture(autouse=True)
def page(monkeypatch):
    monkeypatch.setattr(app, "read_page_files", lambda: PAGE)
    with no_view_threads_left():
        yield


@pytest.fixture
def scene():
    triangle = [[0, 0, 0], [1, 0, 0], [0, 1, 0]]
    return rs.Scene.from_arrays(triangle, [[0, 1, 2]], name="<one> & only")


def answers(url):
    try:
        with urllib.request.urlopen(url, timeout=10) as answer:
            return answer.read() == PAGE["index.html"].content
    except OSError:
        return False


def test_view_shows_itself_in_a_frame(scene):
    with rs.view(scene, height=300, mode="vis") as shown:
        html = shown._repr_html_()
        assert re.search(r'<iframe src="http://127\.0\.0\.1:\d+/"', html)
        assert 'height="300"' in html
        assert "<one>" not in html
        assert shown.url in repr(shown)
        assert answers(shown.url)
    assert not answers(shown.url)
    assert "closed" in repr(shown)
    assert "<iframe" not in shown._repr_html_()
    shown.close()


def test_several_are_open_at_once_and_stay_when_forgotten(scene):
    first, second = rs.view(scene), rs.view(rs.Tracer(scene))
    url = first.url
    assert url != second.url
    second.close()
    del first
    gc.collect()
    assert answers(url)
    from raystream.viewer.notebook import _OPEN

    for shown in list(_OPEN):
        shown.close()
    assert not answers(url)


def test_bad_arguments_are_refused_and_leave_nothing(scene):
    with pytest.raises(ValueError, match="height: expected 100 to 4000 pixels, got 7"):
        rs.view(scene, height=7)
    with pytest.raises(ValueError, match="mode: "):
        rs.view(scene, mode="raytrace")
    with pytest.raises(ValueError, match="colour"):
        rs.view(scene, colour="red")
    with pytest.raises(TypeError, match="scene: expected a Scene or a Tracer, got int"):
        rs.view(7)
    with pytest.raises(rs.FileFormatError, match="there is no such file"):
        rs.view("absent.obj")


def test_it_ends_with_the_process():
    code = (
        "import raystream as rs\n"
        "from raystream.viewer.server import app; app.read_page_files = dict\n"
        "shown = rs.view(rs.Scene.from_arrays([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]]))\n"
        "print(shown.url)"
    )
    result = subprocess.run(
        [sys.executable, "-c", code],
        env=child_environment(),
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert (result.returncode, result.stderr) == (0, "")
    assert not answers(result.stdout.strip())
